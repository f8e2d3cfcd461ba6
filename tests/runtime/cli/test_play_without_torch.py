"""What `gavatar-play` loads: no torch, no OpenCV where it is not there, and hardly anything for --help."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_frames import frames_of

from gavatar_runtime import native_library
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.choice import build_rasterizer, player_rasterizers

NO_TORCH = """
import os
import sys

WALLED = {"torch", "gavatar", "gavatar_plugins", "onnx", "hydra", "scipy", *os.environ.get("WALLED", "").split()}

class Wall:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in WALLED:
            raise ImportError(f"the player must not import {name}")

sys.meta_path.insert(0, Wall())
from gavatar_runtime.cli.play import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
assert "torch" not in sys.modules
print("played without torch")
"""


@pytest.mark.parametrize("rasterizer", ["auto", *player_rasterizers().names()])
def test_playing_loads_no_torch(dynamic, tmp_path, rasterizer):
    try:
        build_rasterizer(rasterizer)
    except UserError as error:
        pytest.skip(str(error))
    arguments = [dynamic, "--size", "16", "--frames", "0:2", "--rasterizer", rasterizer, "--out", tmp_path / "o.mp4"]
    done = subprocess.run(
        [sys.executable, "-c", NO_TORCH, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "played without torch" in done.stdout
    assert len(frames_of(tmp_path / "o.mp4")) == 2


def test_playing_without_opencv_and_ffmpeg_writes_frames_and_sheets(dynamic, tmp_path):
    """As the base install plays. What is written is what an environment with OpenCV writes."""
    bundle = tmp_path / "anna.gavatar"
    bundle.write_bytes(Path(dynamic).read_bytes())

    def play_there(*arguments, walled="cv2"):
        common = [bundle, "--size", "16", "--frames", "0:2", "--set", "rasterizer.resolution=0.5"]
        if native_library.available()[0] is False:
            common = common[:-2]
        return subprocess.run(
            [sys.executable, "-c", NO_TORCH, *map(str, common), *map(str, arguments)],
            capture_output=True, text=True, timeout=120, env={**os.environ, "PATH": "", "WALLED": walled},
        )  # fmt: skip

    done = play_there()
    assert done.returncode == 0, done.stderr
    assert f"note: {tmp_path}/anna_turn/ is a folder of numbered .png frames: an .mp4 video takes OpenCV" in done.stderr
    frames = sorted((tmp_path / "anna_turn").iterdir())
    assert [path.name for path in frames] == ["000000.png", "000001.png"]
    assert play_there("--out", tmp_path / "sheet.png").returncode == 0
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    np.testing.assert_array_equal(sheet, np.concatenate([cv2.imread(str(path)) for path in frames], 1))
    assert play_there("--out", tmp_path / "other.png", walled="").returncode == 0
    assert (tmp_path / "other.png").read_bytes() == (tmp_path / "sheet.png").read_bytes()
    done = play_there("--out", tmp_path / "a.mp4")
    assert "AssertionError: 2" in done.stderr
    assert "error: " in done.stderr
    assert "pip install 'gavatar[video]'" in done.stderr
    assert not (tmp_path / "a.mp4").exists()


def test_help_and_a_mistyped_option_load_neither_numpy_nor_a_network(tmp_path):
    code = "import sys; from gavatar_runtime.cli.play import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
    code += "assert not {'numpy', 'cv2', 'onnxruntime'} & set(sys.modules)"
    for arguments in (["--help"], ["a.gavatar", "--sise", "3"]):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
