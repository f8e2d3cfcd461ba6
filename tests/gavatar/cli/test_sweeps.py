"""Many trainings of one command: captures and settings that are swept, launchers, and what comes back of their jobs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from tiny_capture import SMALL, write_tiny_capture

from gavatar.cli import jobs
from gavatar.cli import train as command
from gavatar.cli.evaluate import main as evaluate_command
from gavatar.cli.job_record import JobRecord
from gavatar.cli.sweep import asks_for_many, distinct_names, sweep_arguments
from gavatar.config import register_configs
from gavatar.evaluation import comparison_page
from gavatar.evaluation.comparison_page import job_faults
from gavatar_runtime.errors import UserError

QUICK = [o for o in SMALL if not o.startswith(("encoder", "stage"))] + [
    "encoder=none", "stage1.steps=2", "stage1.batch=2", "stage1.levels=[{until:1.0,gaussians:2850,image:0.125}]",
]  # fmt: skip


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> Path:
    """A folder with captures/a, captures/b (which lacks an image), another/a, and a folder that is no capture."""
    root = tmp_path_factory.mktemp("sweeps")
    for name in ("captures/a", "captures/b", "another/a"):
        write_tiny_capture(root / name)
    (root / "captures/b/images/cam0/000003.jpg").unlink()
    (root / "captures/notes").mkdir()
    (root / "captures/readme.txt").write_text("")
    register_configs()
    return root


@pytest.fixture
def place(captures, tmp_path, monkeypatch) -> Path:
    """A working directory with links to the captures, and no runs."""
    for name in ("captures", "another"):
        (tmp_path / name).symlink_to(captures / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def train(*arguments: str) -> int:
    """Exit code of the command in this process."""
    with pytest.raises(SystemExit) as done:
        command.main([*arguments, *QUICK])
    return done.value.code


def swept(arguments: list[str]) -> str:
    """The override of the capture after expansion."""
    return next(a for a in sweep_arguments(arguments)[0] if a.startswith("capture="))


def test_a_list_of_captures_is_taken_as_it_is(place):
    assert swept(["--multirun", "capture=captures/a,captures/b"]) == "capture='captures/a','captures/b'"
    assert swept(["capture=choice(captures/a,captures/b)", "-m"]) == "capture='captures/a','captures/b'"


@pytest.mark.parametrize("given", ["captures/*", "'captures/*'", "glob(captures/*)", "glob([captures/a,captures/b*])"])
def test_a_pattern_stands_for_the_captures_that_it_matches(place, given, capsys):
    assert swept(["-m", f"capture={given}"]) == "capture='captures/a','captures/b'"
    said = capsys.readouterr().err
    assert ("captures/notes" in said) == given.replace("'", "").endswith(("/*", "/*)"))


def test_patterns_may_exclude_and_stand_in_lists(place):
    assert swept(["-m", "capture=glob(captures/*,exclude=*/b)"]) == "capture='captures/a'"
    assert swept(["-m", "capture=another/a,captures/b*"]) == "capture='another/a','captures/b'"


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("nothing/*", r"capture=nothing/\* matches no capture"),
        ("captures/n*", r"matches no capture"),
        ("captures/a,captures/a", "captures/a is the same capture as captures/a"),
        ("captures/*,captures/../captures/b", r"is the same capture as captures/b"),
        ("glob(captures/*,exclude=captures/*)", "no capture is left"),
    ],
)
def test_captures_that_cannot_be_swept_are_one_sentence(place, given, sentence):
    with pytest.raises(UserError, match=sentence):
        sweep_arguments(["-m", f"capture={given}"])


def test_a_pattern_without_multirun_says_what_to_add(place, capsys):
    assert train("capture=captures/*") == 2
    assert "add --multirun" in capsys.readouterr().err


def test_a_folder_whose_name_looks_like_a_pattern_is_a_folder(place):
    (place / "a*").symlink_to(place / "captures" / "a")
    (place / "b").symlink_to(place / "captures" / "b")
    assert swept(["-m", "capture='a*',b"]) == "capture='a*',b"


def test_captures_of_one_name_get_the_names_of_the_folders_above(tmp_path):
    def names(*paths):
        return list(distinct_names([str(tmp_path / p) for p in paths]).values())

    assert names("x/anna", "x/bob") == ["anna", "bob"]
    assert names("x/anna", "y/anna", "bob") == ["x_anna", "y_anna", "bob"]
    assert names("1/x/anna", "2/x/anna", "2/y/anna") == ["1_x_anna", "2_x_anna", "y_anna"]


@pytest.mark.parametrize(
    ("arguments", "many"),
    [(["-m"], True), (["--multirun"], True), (["hydra.mode=MULTIRUN"], True), (["hydra.mode=RUN"], False), ([], False)],
)
def test_what_asks_for_many_runs(arguments, many):
    assert asks_for_many(["capture=x", *arguments]) == many


def check_runs(place: Path, code: int, output: str, errors: str) -> None:
    """One of two jobs failed for the image that its capture lacks, the other trained."""
    assert code == 2, errors
    assert output.strip().endswith("1 of 2 runs trained")
    assert errors.count("error: ") == 1
    assert "error: runs/b: " in errors
    assert "000003" in errors
    assert "Traceback" not in errors
    assert json.loads((place / "runs/a/metrics.json").read_text())["finished"]
    assert not (place / "runs/b").exists()
    records = {name: json.loads((place / f"runs/jobs/{name}.json").read_text()) for name in "ab"}
    assert [(records[name]["state"], records[name]["code"]) for name in "ab"] == [("ended", 0), ("ended", 2)]
    assert "000003" in records["b"]["message"]
    assert "exit code 2" in (place / "runs/jobs/b.log").read_text()
    assert not list(place.glob("**/.gavatar*"))


def test_each_capture_has_a_run_of_its_own_and_the_worst_job_gives_the_exit_code(place, capsys):
    code = train("capture=captures/*", "--multirun")
    check_runs(place, code, *capsys.readouterr())
    assert train("capture=captures/a") == 0  # the run that this command alone would make, so it is continued


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_jobs_in_other_processes_train_alike_and_bring_their_errors_back(place, launcher):
    pytest.importorskip(f"hydra_plugins.hydra_{launcher.partition('_')[0]}_launcher")
    arguments = ["capture=captures/*", "--multirun", f"hydra/launcher={launcher}", *QUICK]
    done = subprocess.run(
        [sys.executable, "-m", "gavatar.cli.train", *arguments],
        capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    check_runs(place, done.returncode, done.stdout, done.stderr)


def test_captures_and_settings_swept_together_nest(place):
    assert train("capture=captures/a,another/a", "seed=0,1", "--multirun", "out=both") == 0
    found = sorted(path.parent.relative_to(place).as_posix() for path in place.glob("both/**/metrics.json"))
    assert found == [f"both/{name}/seed={seed}" for name in ("another_a", "captures_a") for seed in (0, 1)]
    with pytest.raises(SystemExit) as done:
        evaluate_command(["--all", "both", "--splits", "train", "--no-fit", "--no-perceptual"])
    assert done.value.code == 0
    rows = json.loads((place / "both/comparison.json").read_text())
    assert [row["run"] for row in rows] == [path.removeprefix("both/") for path in found]


def test_a_crash_of_a_job_is_shown_whole_and_worse_than_a_mistake(place, monkeypatch, capsys):
    def crash(config, directory):
        if "a" in directory.name:
            raise ZeroDivisionError("on purpose")
        raise UserError("a mistake")

    monkeypatch.setattr(jobs, "train", crash)
    assert train("capture=captures/*", "--multirun") == 1
    errors = capsys.readouterr().err
    assert "error: runs/b: a mistake" in errors
    assert "ZeroDivisionError: on purpose" in errors
    assert train("capture=captures/a") == 1


@pytest.mark.parametrize(
    ("override", "sentence"),
    [("hydra/launcher=jolib", "Could not find 'hydra/launcher/jolib'"), ("hydra.sweep.dri=x", "hydra.sweep.dri")],
)
def test_a_wrong_setting_of_hydra_is_one_sentence(place, override, sentence, capsys):
    assert train("capture=captures/a,captures/b", "--multirun", override) == 2
    errors = capsys.readouterr().err
    assert sentence in errors
    assert errors.count("\n") == 1
    assert not list(place.glob("**/.gavatar*"))


def test_jobs_that_end_without_a_word_are_an_error(place, monkeypatch, capsys):
    monkeypatch.setattr(jobs.Job, "__call__", lambda self, config: None)
    assert train("capture=captures/*", "--multirun") == 1
    assert "2 of 2 jobs ended without a result" in capsys.readouterr().err


def test_all_runs_of_a_folder_become_one_table_and_those_that_cannot_are_named(place, capsys, monkeypatch):
    assert train("capture=captures/a", "out=runs/fine") == 0
    assert train("capture=captures/a", "out=runs/fine/within", "seed=1") == 0
    (place / "runs/started").mkdir()
    (place / "runs/started/config.yaml").write_text((place / "runs/fine/config.yaml").read_text())
    capsys.readouterr()
    with pytest.raises(SystemExit) as done:
        evaluate_command(["--all", "runs", "--splits", "train", "test", "--no-fit", "--no-perceptual"])
    assert done.value.code == 2
    output, errors = capsys.readouterr()
    assert "error: runs/started: runs/started has no finished stage yet" in errors
    lines = [line.split() for line in output.splitlines()]
    assert [line[:2] for line in lines[2:6]] == [[n, s] for n in ("fine", "fine/within") for s in ("train", "test")]
    assert "perceptual" not in lines[0]
    table = (place / "runs/comparison.csv").read_text().splitlines()
    assert table[0].startswith("run,stage,gaussians,split,poses,views,psnr,ssim")
    assert len(table) == 5
    assert (place / "runs/fine/evaluation.json").exists()
    page = (place / "runs/comparison.html").read_text()
    assert page.count("<img ") == 4
    assert "has no finished stage yet" in page
    assert "://" not in page  # it needs nothing from elsewhere
    assert page.count("data:image/jpeg;base64,") == 4
    monkeypatch.setattr(comparison_page, "MOST_INSIDE", 3)
    with pytest.raises(SystemExit):
        evaluate_command(["--all", "runs", "--splits", "train", "test", "--no-fit", "--no-perceptual"])
    page = (place / "runs/comparison.html").read_text()
    files = re.findall(r'src="([^"]*)"', page)
    assert [(place / "runs" / unquote(file)).read_bytes()[:2] for file in files] == [b"\xff\xd8"] * 4
    assert "keep the page beside them" in page


def test_what_was_evaluated_before_is_read_and_what_changed_is_measured_again(place, capsys):
    def evaluated(*more: str) -> list[str]:
        with pytest.raises(SystemExit) as done:
            evaluate_command(["--all", "runs", "--splits", "test", "--no-fit", "--no-perceptual", *more])
        assert done.value.code == 0
        return [line for line in capsys.readouterr().err.splitlines() if line.startswith("evaluating")]

    assert train("capture=captures/a", "out=runs/one") == 0
    assert len(evaluated()) == 1
    first = (place / "runs/comparison.html").read_text()
    assert evaluated() == []
    assert (place / "runs/comparison.html").read_text() == first
    assert len(evaluated("--again")) == 1
    with pytest.raises(SystemExit):
        evaluate_command(["--all", "runs", "--splits", "train", "--no-fit", "--no-perceptual"])
    assert "evaluating" in capsys.readouterr().err  # asked for something else
    assert train("capture=captures/a", "out=runs/one", "overwrite=true", "seed=5") == 0
    assert len(evaluated()) == 1


def test_a_killed_job_is_left_as_running_and_told_on_the_page(tmp_path):
    record = JobRecord(tmp_path, tmp_path / "anna" / "seed=1")

    def killed() -> None:
        with record:
            print("drawn\ragain\rlast\nnext")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        killed()
    log = (tmp_path / "jobs/anna/seed=1.log").read_text().splitlines()
    assert log[1:3] == ["last", "next"]
    ((run, why),) = job_faults(tmp_path)
    assert run == "anna/seed=1"
    assert "no end was written" in why
    record.end(0, "")
    with record:
        pass
    assert job_faults(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--all", "."], "no run is in ."),
        (["--all", "nowhere"], "nowhere is not a directory"),
        (["--all", ".", "--capture", "captures/a"], "--capture is of one run"),
    ],
)
def test_mistakes_with_many_runs_are_one_sentence(place, arguments, sentence, capsys):
    with pytest.raises(SystemExit) as done:
        evaluate_command(arguments)
    assert done.value.code == 2
    assert sentence in capsys.readouterr().err
