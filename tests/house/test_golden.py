"""tools/golden.py: what two revisions compute is told apart, and told equal."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

GOLDEN = ROOT / "tools" / "golden.py"


def golden(*words) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, str(GOLDEN), *map(str, words)], capture_output=True, text=True)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("golden") / "before.json"
    done = golden("record", path, "--only", "convert/wave", "convert/capture")
    assert done.returncode == 0, done.stderr
    return path


def test_a_second_recording_is_equal(recorded, tmp_path):
    again = tmp_path / "after.json"
    assert golden("record", again, "--only", "convert/wave", "convert/capture").returncode == 0
    assert json.loads(again.read_text()) == json.loads(recorded.read_text())
    assert golden("compare", recorded, again).returncode == 0


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda found: found.update(poses="0"), "differing convert/wave poses"),
        (lambda found: found.pop("poses"), "missing   convert/wave poses"),
        (lambda found: found.update(more=1), "new       convert/wave more"),
        (lambda found: found.update(joints=found.pop("poses")), "its value now stands under joints"),
    ],
)
def test_a_difference_is_named(recorded, tmp_path, edit, said):
    content = json.loads(recorded.read_text())
    edit(content["results"]["convert/wave"])
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(content))
    done = golden("compare", recorded, changed)
    assert done.returncode == 1
    assert said in done.stdout
    assert golden("compare", recorded, changed, "--only", "convert/capture").returncode == 0


def test_comparing_nothing_is_no_success(recorded):
    assert golden("compare", recorded, recorded, "--only", "play/*").returncode == 1
