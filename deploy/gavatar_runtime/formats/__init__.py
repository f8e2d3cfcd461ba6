"""Files, read and written safely."""

from . import torch_file  # noqa: F401  (adds tensors to what the reader of pickles knows)
