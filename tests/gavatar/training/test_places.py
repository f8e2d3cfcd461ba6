"""A run is recognised and found from wherever its paths are counted: after cd, through links, on renamed folders."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from omegaconf import OmegaConf
from tiny_capture import SMALL, write_tiny_capture

from gavatar.capture.fingerprint import fingerprint
from gavatar.capture.opening import open_capture
from gavatar.config import check, compose_config
from gavatar.training.places import WrittenRun, absolute, from_here
from gavatar.training.run import open_run, train
from gavatar_runtime.errors import UserError

QUICK = [o for o in SMALL if not o.startswith(("encoder", "stage"))] + [
    "encoder=none", "stage1.steps=2", "stage1.batch=2", "stage1.levels=[{until:1.0,gaussians:2850,image:0.125}]",
]  # fmt: skip


def run(capture: str | Path, out: str | Path = "runs/me", *overrides: str) -> None:
    train(compose_config([f"capture={capture}", f"out={out}", *QUICK, *overrides]), Path(out))


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A project folder with two captures and a run of the first, trained by relative paths."""
    project = tmp_path_factory.mktemp("projects") / "project"
    write_tiny_capture(project / "captures" / "anna")
    write_tiny_capture(project / "captures" / "bob", frames=(0, 8, 16))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        run("captures/anna")
    return project


@pytest.fixture
def project(finished, tmp_path, monkeypatch) -> Path:
    """A project of the test's own, worked in as if it had always been there: the same files at another place."""
    shutil.copytree(finished, tmp_path / "project", symlinks=True)
    monkeypatch.chdir(tmp_path / "project")
    run("captures/anna")  # continues, and writes down where things are now
    return tmp_path / "project"


def capture_of(directory: str | Path) -> Path:
    return Path(OmegaConf.load(Path(directory) / "config.yaml").capture)


def test_the_same_command_again_continues_the_run(project, recwarn):
    run("captures/anna")
    assert not [w for w in recwarn if "goes on from its checkpoint" in str(w.message)]  # nothing was left to do
    run("./captures/../captures/anna/")
    run(project / "captures" / "anna")
    assert capture_of("runs/me") == project / "captures" / "anna"


def test_the_run_is_continued_from_another_folder(project, monkeypatch):
    monkeypatch.chdir(project / "captures")
    run("anna", "../runs/me")
    monkeypatch.chdir(project.parent)
    run("project/captures/anna", "project/runs/me")


def test_the_run_is_continued_through_links(project):
    Path("link").symlink_to(project / "captures" / "anna")
    Path("elsewhere").symlink_to(project)
    run("link")
    run("elsewhere/captures/anna", "elsewhere/runs/me")


def test_the_run_is_continued_and_opened_after_a_folder_above_was_renamed(project, monkeypatch):
    moved = project.with_name("renamed")
    project.rename(moved)
    monkeypatch.chdir(moved)
    assert open_run("runs/me").capture.path == moved / "captures" / "anna"
    run("captures/anna")
    assert capture_of("runs/me") == moved / "captures" / "anna"


def test_the_run_of_a_copied_project_is_its_own(project, monkeypatch):
    shutil.copytree(project, project.with_name("copy"))
    monkeypatch.chdir(project.with_name("copy"))
    run("captures/anna")
    assert capture_of("runs/me") == Path.cwd() / "captures" / "anna"


def test_another_capture_is_refused_by_both_names(project):
    with pytest.raises(UserError, match=r"runs/me holds a run with another capture \(.*anna, now .*bob\)"):
        run("captures/bob")
    Path("link").symlink_to("captures/bob")
    with pytest.raises(UserError, match=r"another capture \(.*anna, now .*bob\)"):
        run("link")


def test_another_capture_at_the_old_place_is_refused(project):
    shutil.move("captures/anna", "captures/first")
    Path("captures/anna").symlink_to("bob")
    with pytest.raises(UserError, match=r"captures/bob does not hold what runs/me was trained on"):
        run("captures/anna")
    Path("captures/anna").unlink()
    shutil.copytree("captures/bob", "captures/anna")
    with pytest.raises(UserError, match=r"captures/anna does not hold what .*overwrite=true"):
        run("captures/anna")
    run("captures/anna", "runs/me", "overwrite=true")
    run("captures/anna")


def test_the_same_capture_at_another_place_continues_the_run(project):
    shutil.move("captures/anna", "first")
    run("first")
    shutil.copytree("first", "second")
    run("second")
    assert capture_of("runs/me") == project / "second"


def test_a_fingerprint_is_of_what_training_reads(project):
    def of(split="train"):
        return fingerprint(open_capture("captures/anna"), split)

    first = of()
    assert len(first) == 16
    assert of("test") != first
    (Path("captures/anna") / "body_truth.npz").unlink()  # which training never reads
    assert of() == first
    mask = Path("captures/anna/masks/cam0/000000.png")
    mask.write_bytes(mask.read_bytes() + b" ")
    changed = of()
    assert changed != first
    with np.load("captures/anna/body.npz") as file:
        arrays = dict(file)
    arrays["trans"] = arrays["trans"] + 1e-3
    np.savez("captures/anna/body.npz", **arrays)
    moved = of()
    assert moved != changed
    room = Path("captures/anna/backgrounds/cam0.png")  # its colours are taken out of the rims
    room.parent.mkdir()
    for grey in (100, 101):
        cv2.imwrite(str(room), np.full((8, 8, 3), grey, np.uint8))
        assert of() != moved
        moved = of()


def test_a_run_that_was_moved_without_its_capture_still_finds_it(project):
    shutil.move("runs/me", "me")
    assert open_run("me").capture.path == project / "captures" / "anna"
    run("captures/anna", "me")


def test_a_capture_that_is_gone_is_one_sentence(project):
    shutil.move("captures/anna", "elsewhere")
    with pytest.raises(UserError, match=r"capture .*captures/anna is not a directory"):
        open_run("runs/me")
    assert open_run("runs/me", capture="elsewhere").capture.path == Path("elsewhere")


def test_paths_of_components_are_kept_alike(project, monkeypatch):
    """Of the body and of a loss, whose files need not exist for this."""
    Path("models").mkdir()
    overrides = ["body=smplx", "body.path=models", "body.uv=uv.obj", "+losses.lpips={weight:0.1,backbone:nets}"]
    config = absolute(check(compose_config(["capture=captures/anna", *overrides])))
    assert (config.body["path"], config.body["uv"]) == (str(project / "models"), str(project / "uv.obj"))
    assert config.losses["lpips"]["backbone"] == str(project / "nets")
    seen = from_here(config, Path("runs/me"))
    assert seen == {
        "capture": "../../captures/anna", "body.path": "../../models", "body.uv": "../../uv.obj",
        "losses.lpips.backbone": "../../nets",
    }  # fmt: skip
    moved = project.with_name("renamed")
    project.rename(moved)
    monkeypatch.chdir(moved)
    now = absolute(check(compose_config(["capture=captures/anna", *overrides])))
    written = WrittenRun(moved / "runs" / "me", config, seen)
    assert written.recognised(now, "unknown") == now
    again = written.found()
    assert again.body["path"] == str(moved / "models")
    assert again.body["uv"] == config.body["uv"]  # lies at neither place: named as it was written


def test_empty_paths_and_numbers_of_losses_stay(project):
    config = check(compose_config(["capture=captures/anna", "body=smplx"]))
    placed = absolute(config)
    assert placed.body == config.body
    assert placed.losses == config.losses
    assert list(from_here(placed, Path("runs/me"))) == ["capture"]


def test_a_run_written_before_places_were_kept_is_continued(project):
    path = Path("runs/me/config.yaml")
    written = OmegaConf.load(path)
    del written["from_here"], written["capture_content"]
    OmegaConf.save(written, path)
    run("captures/anna")
    assert "from_here" in path.read_text()


def test_an_open_run_has_no_stale_capture_when_the_stored_places_are_damaged(project):
    path = Path("runs/me/config.yaml")
    path.write_text(path.read_text().replace("capture: ../../captures/anna", "capture: [7]"))
    assert open_run("runs/me").capture.path == project / "captures" / "anna"
