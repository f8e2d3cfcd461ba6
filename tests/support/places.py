"""Where things are: the checkout, its test helpers, its demo capture, and the shared data beside it."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUPPORT = ROOT / "tests" / "support"
DEMO = ROOT / "gavatar" / "data" / "studio_demo"
BODY_FILE = ROOT / "gavatar" / "data" / "body" / "gavatar_body_smplh.npz"
SHARED = ROOT.parent / "shared"
