"""Decodes that serve several frames."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.errors import UserError


def test_reuse_fades_between_decodes_and_ends_at_each(tiered_bundle):
    rng = np.random.default_rng(0)
    poses = np.repeat(rng.normal(0, 0.3, (2, 1, 52, 3)), 4, 0).reshape(8, 52, 3).astype(np.float32)
    avatar, plain = Avatar(tiered_bundle, tier="coarse", reuse=4), Avatar(tiered_bundle, tier="coarse")
    faded = [avatar.gaussians(p).colors.copy() for p in poses]
    first, second = (plain.gaussians(poses[i]).colors.copy() for i in (0, 4))
    np.testing.assert_array_equal(faded[0], first)
    np.testing.assert_allclose(faded[5], (first + second) / 2, atol=1e-6)
    np.testing.assert_allclose(faded[7], second, atol=1e-6)
    with pytest.raises(UserError, match="reuse=0"):
        Avatar(tiered_bundle, reuse=0)
