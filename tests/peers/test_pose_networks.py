"""The converted pose networks against LiteRT's run of MediaPipe's originals (mediapipe 0.10.21, unpacked)."""

import os
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

interpreter = pytest.importorskip("ai_edge_litert.interpreter", reason="needs ai-edge-litert")
MODULES = Path(os.environ.get("MEDIAPIPE_MODULES", "mediapipe/modules"))


@pytest.mark.parametrize(
    ("original", "converted"),
    [
        ("pose_detection/pose_detection.tflite", "pose_detection.onnx"),
        ("pose_landmark/pose_landmark_full.tflite", "pose_landmark_full.onnx"),
    ],
)
def test_converted_networks_answer_as_their_originals(original, converted):
    if not (MODULES / original).is_file():
        pytest.skip(f"set MEDIAPIPE_MODULES to the folder mediapipe/modules of the wheel ({original} is not there)")
    reference = interpreter.Interpreter(str(MODULES / original))
    reference.allocate_tensors()
    entry = reference.get_input_details()[0]
    session = onnxruntime.InferenceSession(str(Path(str(files("gavatar.data"))) / "pose" / converted))
    rng = np.random.default_rng(0)
    for cell in (1, 8, 32):  # from noise to large flat patches
        _, h, w, _ = entry["shape"]
        image = np.kron(rng.uniform(size=(1, h // cell, w // cell, 3)), np.ones((1, cell, cell, 1))).astype(np.float32)
        reference.set_tensor(entry["index"], image)
        reference.invoke()
        found = session.run(None, {"image": image})
        for output, ours in zip(reference.get_output_details(), found, strict=True):
            theirs = reference.get_tensor(output["index"])
            assert ours.shape == theirs.shape
            # sums of some thousand float32 products in another order, through sixty layers
            scale = max(1.0, float(np.abs(theirs).max()))
            np.testing.assert_allclose(ours, theirs, atol=1e-3 * scale)
