"""gavatar's deployment half: plays an exported avatar with numpy and onnxruntime alone (no torch, ever)."""

__version__ = "0.1.0"
