"""The converted networks of bodies, hands and faces against LiteRT's run of the originals in MediaPipe's wheel."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from fetched_wheels import fetched_wheel

interpreter = pytest.importorskip("ai_edge_litert.interpreter", reason="needs ai-edge-litert")


@pytest.fixture(scope="module")
def modules(tmp_path_factory) -> Path:
    """mediapipe/modules of the wheel; installed it would ask for numpy < 2 and another OpenCV."""
    folder = fetched_wheel(tmp_path_factory, "mediapipe==0.10.21", "mediapipe/modules/")
    return folder / "mediapipe" / "modules"


@pytest.mark.parametrize(
    ("original", "converted"),
    [
        ("pose_detection/pose_detection.tflite", "pose/pose_detection.onnx"),
        ("pose_landmark/pose_landmark_full.tflite", "pose/pose_landmark_full.onnx"),
        ("hand_landmark/hand_landmark_full.tflite", "hands/hand_landmark_full.onnx"),
        ("holistic_landmark/hand_recrop.tflite", "hands/hand_recrop.onnx"),
    ],
)
def test_converted_networks_answer_as_their_originals(modules, original, converted):
    reference = interpreter.Interpreter(str(modules / original))
    reference.allocate_tensors()
    entry = reference.get_input_details()[0]
    session = onnxruntime.InferenceSession(str(Path(str(files("gavatar.data"))) / converted))
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
            # sums of some thousand float32 products in another order, through sixty layers: measured 4e-6 of the
            # largest value for the detector, 2e-5 of one unit for hands, their crop and faces (pixels, metres, shares),
            # and 5e-4 for the logits of the outline, twice that for other processors
            scale = max(1.0, float(np.abs(theirs).max()))
            np.testing.assert_allclose(ours, theirs, atol=1e-3 * scale)
