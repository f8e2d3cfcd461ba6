"""Networks that ONNX Runtime or the player cannot use: one sentence when the bundle is opened, and nothing printed."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.errors import UserError

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
import onnx
from make_bundle import MAP_RESOLUTION, decoder, make_bundle, model
from onnx import helper, numpy_helper
from tiered_members import COARSE_COUNT, COUNT, all_members, write_tiered


def refused(tmp_path, capfd, changed: dict[str, bytes], fault: str, tier: str = "full") -> None:
    path = write_tiered(tmp_path / "a.gavatar", changed)
    with pytest.raises(UserError, match=fault) as raised:
        Avatar(path, tier=tier, threads=1)
    (member,) = changed
    assert re.search(rf"a\.gavatar: .*{re.escape(member)}", str(raised.value)), raised.value
    assert "\n" not in str(raised.value)
    assert str(raised.value).endswith("export it again")
    assert capfd.readouterr() == ("", "")


def edited(member: str, edit) -> bytes:
    """A network of the whole bundle after `edit` of its graph, unchecked."""
    made = onnx.load_from_string(all_members()[member])
    edit(made.graph)
    return made.SerializeToString()


def with_constant(name: str, value):
    def edit(graph) -> None:
        (constant,) = (c for c in graph.initializer if c.name == name)
        constant.CopyFrom(numpy_helper.from_array(value, name))

    return edit


@pytest.mark.parametrize("data", [b"", b"nonsense", bytes(range(256)) * 4, all_members()["decoder.onnx"][:200]])
def test_what_is_no_network(tmp_path, capfd, data):
    refused(tmp_path, capfd, {"decoder.onnx": data}, r"cannot load decoder\.onnx")


def test_an_operator_that_does_not_exist(tmp_path, capfd):
    def edit(graph):
        graph.node[0].op_type = "Nonsense"

    refused(tmp_path, capfd, {"decoder.onnx": edited("decoder.onnx", edit)}, r"cannot load decoder\.onnx")


@pytest.mark.parametrize(
    ("axis", "length", "fault"),
    [(2, 8, r"declares 'positional_map' as tensor\(float\) of shape \(1, 3, 8, 16\)"), (1, 4, r"\(1, 4, 16, 16\)")],
)
def test_an_input_of_another_shape(tmp_path, capfd, axis, length, fault):
    def edit(graph):
        graph.input[0].type.tensor_type.shape.dim[axis].dim_value = length

    wanted = rf"{fault}, not tensor\(float\) of \(1, 3, {MAP_RESOLUTION}, {MAP_RESOLUTION}\)"
    refused(tmp_path, capfd, {"encoder.onnx": edited("encoder.onnx", edit)}, wanted)


def test_features_of_another_size_than_the_decoder_takes(tmp_path, capfd):
    def edit(graph):
        graph.input[0].type.tensor_type.shape.dim[1].dim_value = 5

    refused(
        tmp_path,
        capfd,
        {"decoder.onnx": edited("decoder.onnx", edit)},
        r"cannot (load|run) decoder\.onnx: .*dimensions",
    )


def test_a_graph_that_fails_when_it_runs(tmp_path, capfd):
    shape = (1, 3, MAP_RESOLUTION, MAP_RESOLUTION)
    nodes = [  # a row that the table does not have, which no check of the graph can see
        helper.make_node("Gather", ["table", "row"], ["picked"]),
        helper.make_node("Mul", ["positional_map", "picked"], ["pose_features"]),
    ]
    constants = {"table": np.ones((3,), np.float32), "row": np.int64(7)}
    failing = model(nodes, {"positional_map": shape}, {"pose_features": shape}, constants)
    refused(tmp_path, capfd, {"encoder.onnx": failing}, r"cannot (run|load) encoder\.onnx: .*(Gather|indices)")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("member", "constant", "named", "tier"),
    [
        ("encoder.onnx", "gain", "pose_features", "full"),
        ("decoder.onnx", "gain", "offsets", "full"),
        ("decoder.onnx", "s", "scales", "full"),
        ("decoder_coarse.onnx", "c", "colors", "coarse"),
    ],
)
def test_results_that_are_not_finite(tmp_path, capfd, value, member, constant, named, tier):
    shapes = {"gain": (), "s": (COUNT,), "c": (COARSE_COUNT, 3)}
    data = edited(member, with_constant(constant, np.full(shapes[constant], value, np.float32)))
    refused(tmp_path, capfd, {member: data}, f"gives NaN or infinite '{named}'", tier)


def test_another_number_of_coarse_points(tmp_path, capfd):
    data = decoder(np.full((COARSE_COUNT + 1, 3), 0.5), dynamic=True)
    fault = rf"decoder_coarse\.onnx returns shapes \({COARSE_COUNT + 1}, 3\)"
    refused(tmp_path, capfd, {"decoder_coarse.onnx": data}, fault, "coarse")


def test_what_does_not_move_is_decoded_once_when_it_is_opened(tmp_path, monkeypatch):
    from gavatar_runtime.decoding.network import Network

    calls = []
    run = Network.__call__
    monkeypatch.setattr(Network, "__call__", lambda self, *a, **k: calls.append(1) or run(self, *a, **k))
    avatar = Avatar(make_bundle(tmp_path / "still.gavatar"), threads=1)
    assert calls == [1]
    avatar.gaussians(np.zeros((52, 3), np.float32))
    assert calls == [1]
