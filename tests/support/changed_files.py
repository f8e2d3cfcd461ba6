"""Files of captures with some of their fields changed, taken out (None) or broken."""

from __future__ import annotations

import numpy as np
import torch


def npz(path, **changes):
    with np.load(path) as file:
        arrays = {k: v for k, v in (dict(file) | changes).items() if v is not None}
    np.savez(path, **arrays)


def npy(path, change):
    content = np.load(path, allow_pickle=True).item()
    change(content)
    np.save(path, content, allow_pickle=True)


def pth(path, **changes):
    content = torch.load(path, weights_only=True) | changes
    torch.save({k: v for k, v in content.items() if v is not None}, path)
