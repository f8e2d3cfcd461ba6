"""Decodes that serve more than one frame, and buffers that are filled again."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.buffers import InTurn
from gavatar_runtime.avatar.reuse import Faded, Once


class Counting:
    """A tier of two Gaussians whose every attribute is the first number of the pose; it fills the same arrays again."""

    def __init__(self):
        self.calls, self.stage_seconds = 0, {}
        self._out = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32), np.zeros(2, np.float32)

    def __call__(self, pose):
        self.calls += 1
        for array in self._out:
            array[...] = pose[0, 0]
        self.stage_seconds = {"encode": 1.0, "decode": 2.0}
        return self._out


def pose(value: float) -> np.ndarray:
    return np.full((1, 3), value, np.float32)


def test_what_does_not_move_is_decoded_once():
    tier = Counting()
    once = Once(tier)
    first = once(pose(3))
    assert once.stage_seconds == {"encode": 1.0, "decode": 2.0}
    assert once(pose(4)) is first
    assert once.stage_seconds == {"encode": 0.0, "decode": 0.0}
    assert tier.calls == 1


def test_decodes_in_between_are_faded():
    tier = Counting()
    faded = Faded(tier, 4, 2)
    seen = [[float(array.flat[0]) for array in faded(pose(v))] for v in (8, 0, 0, 0, 16, 0, 0, 0, 0, 0)]
    assert tier.calls == 3
    # the first stands still until the second is decoded, and is then left within the four frames of a turn
    expected = [8, 8, 8, 8, 10, 12, 14, 16, 12, 8]
    np.testing.assert_array_equal(seen, np.repeat(np.array(expected, float)[:, None], 3, 1))


def test_only_frames_that_decode_take_the_seconds_of_decoding():
    faded = Faded(Counting(), 2, 2)
    faded(pose(1))
    assert (faded.stage_seconds["encode"], faded.stage_seconds["decode"] > 2) == (1.0, True)
    faded(pose(1))
    assert (faded.stage_seconds["encode"], faded.stage_seconds["decode"] < 2) == (0.0, True)


def test_a_decode_that_fails_at_first_is_made_up_for_by_the_next_call():
    class Failing(Counting):
        def __call__(self, pose):
            if self.calls == 0:
                self.calls += 1
                raise RuntimeError("no memory")
            return super().__call__(pose)

    faded = Faded(Failing(), 3, 2)
    with pytest.raises(RuntimeError, match="no memory"):
        faded(pose(5))
    assert faded(pose(5))[2].tolist() == [5, 5]


def test_a_buffer_comes_again_with_the_third_call_after_it():
    made = []
    buffers = InTurn(lambda: made.append(None) or np.empty(1))
    given = [buffers.next() for _ in range(9)]
    assert len(made) == 3
    assert len({id(buffer) for buffer in given[:3]}) == 3
    assert all(given[i] is given[i + 3] for i in range(6))
