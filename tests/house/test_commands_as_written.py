"""The commands of README and docs, run as they are written: relative paths, in their order, trainings twice in a row.

Left out are those whose files do not come with the package, and what takes long: the lab's. Sizes are cut by what is
added at their ends.
"""

from __future__ import annotations

import importlib
import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from pages import COMMANDS, PAGES, commands
from places import ROOT
from tiny_capture import write_tiny_capture

ADDED = {
    "gavatar-train": [
        "progress=false", "threads=1", "avatar.features=8", "avatar.feature_size=64", "stage1.steps=2",
        "stage1.batch=2", "stage1.levels=[{until:1.0,gaussians:2850,image:0.125}]", "stage2.steps=0",
    ],
    "gavatar-eval": ["--splits", "train", "--no-fit", "--no-perceptual"],
    "gavatar-export": ["--poses", "2"],
    "gavatar-play": ["--frames", "0:2", "--size", "64", "--quiet"],
}  # fmt: skip
OUTPUTS = ("-o", "--out", "--json", "--figure", "-J")  # the word after them is written, not read
ROOMS = [page for page in PAGES if page.parent.name != "lab" and ROOT / "gavatar" not in page.parents]
# words that stand for something the reader has: a name in capitals, or a choice
PLACEHOLDERS = ("[", "|", "DIR", "RUN", "NAME", "FILE", "CAPTURE", "SOURCE", "FOOTAGE", "$")
# official files, which everyone downloads for themselves; the example that test_third_party_plugin.py installs;
# launchers, which tests of sweeps try where they are installed
NOT_OURS = ("body=smpl", "--body", "tinydecoder", "grey", "hydra/launcher")
SLOW = ("gavatar-demo", "gavatar-make", "gavatar-tradeoff", "gavatar-view")


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """What the pages take for granted: captures, a motion, and a trained and exported avatar."""
    folder = tmp_path_factory.mktemp("world")
    for name in ("my_capture", "captures/anna"):
        write_tiny_capture(folder / name, frames=(0, 16, 40), novel=(105,))
    with np.load(folder / "my_capture" / "body.npz") as file:
        np.savez(folder / "dance.npz", **file)
    shutil.copy(folder / "dance.npz", folder / "walk.npz")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run(["gavatar-train", "capture=captures/anna"])
        run(["gavatar-export", "runs/anna", "-o", "anna.gavatar"])
    return folder


def run(words: list[str]) -> int:
    """Exit code of a command in this process."""
    main = importlib.import_module(COMMANDS[words[0]]).main
    with pytest.raises(SystemExit) as done:
        main([*words[1:], *ADDED.get(words[0], [])])
    return done.value.code or 0


def read_files(words: list[str]) -> list[str]:
    """The words of a command that name files or folders that it reads."""
    files = []
    for before, word in itertools.pairwise(words):
        name = word.removeprefix("capture=") if word.startswith("capture=") else word
        if before not in OUTPUTS and not word.startswith("-") and (name != word or "=" not in word):
            files += [name] if name != word or "/" in name or "." in name else []
    return files


def runs_here(words: list[str]) -> bool:
    """Whether a command can be run in the world as it stands."""
    if words[0] not in COMMANDS or words[0] in SLOW or len(words) < 2:
        return False
    if any(sign in word for word in words for sign in (*PLACEHOLDERS, *NOT_OURS)):
        return False
    return all(any(Path().glob(name)) for name in read_files(words))


@pytest.mark.slow
@pytest.mark.parametrize("page", ROOMS, ids=[str(page.relative_to(ROOT)) for page in ROOMS])
def test_every_command_that_can_be_tried_works_as_written(page, world, tmp_path, monkeypatch):
    shutil.copytree(world, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    tried = []
    for words in commands(page, spans=False):
        if runs_here(words):
            for _ in range(2 if words[0] == "gavatar-train" else 1):
                assert run(words) == 0, " ".join(words)
            tried.append(words[0])
    if page == ROOT / "README.md":
        assert {"gavatar-train", "gavatar-eval", "gavatar-export", "gavatar-play"} <= set(tried)
