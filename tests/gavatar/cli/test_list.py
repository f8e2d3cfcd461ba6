"""`gavatar-list`: what there is, where it comes from, what it needs, what it can."""

from __future__ import annotations

import dataclasses
import json
import warnings

import pytest
from plugin_sources import GOOD

from gavatar import registry as registries
from gavatar.cli import list as listing


@dataclasses.dataclass(frozen=True)
class FrozenOptions:
    """A frozen dataclass, one field of which the user owes."""

    path: str
    width: int = 4


def test_the_list_shows_options_origin_and_failures(plugin_modules, capsys):
    plugin_modules({"p_raises": "1 / 0", "p_good": GOOD})
    registries.DECODERS.register(
        "frozen", config=FrozenOptions, needs="a file of your own", missing=lambda: "nobody brought the file"
    )(lambda options: options)
    registries.DECODERS.register("kept", traits=registries.DecoderTraits(not_exported="it is a secret"))(lambda o: o)
    with pytest.raises(SystemExit) as exit_:
        listing.main(["decoder"])
    out, err = capsys.readouterr()
    assert exit_.value.code == 0
    assert err == ""
    assert "from p_good" in out
    assert "path: str, required" in out
    assert "width: int = 4" in out
    assert "needs a file of your own" in out
    assert "not here: nobody brought the file" in out
    assert "not_exported='it is a secret'" in out
    assert "ZeroDivisionError: division by zero" in out
    assert "\nencoder\n" not in out


def test_an_unknown_group_is_one_sentence_and_exit_code_2(capsys):
    with pytest.raises(SystemExit) as exit_:
        listing.main(["decoders"])
    assert exit_.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_shipped_components_have_a_summary_and_name_their_distribution():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        registries.load_plugins()
    for group, rows in listing.catalogue(None).items():
        for row in rows:
            if row["origin"].startswith("gavatar"):
                assert row["summary"], f"{group} {row['name']}"
                assert row["distribution"].startswith("gavatar "), f"{group} {row['name']}"


def test_the_list_says_what_components_can(capsys):
    with pytest.raises(SystemExit):
        listing.main(["loss", "--json"])
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["groups"]["loss"]}
    assert rows["feature"]["traits"] == {"judges_poses": False, "in_progress_bar": False}
    assert rows["l1"]["traits"]["judges_poses"]
    with pytest.raises(SystemExit):
        listing.main(["encoder"])
    out = capsys.readouterr().out
    assert "static=True" in out
    assert "static=False" not in out  # only what differs from the rule
    with pytest.raises(SystemExit):
        listing.main(["rasterizer", "--json"])
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["groups"]["rasterizer"]}
    assert [name for name, row in rows.items() if row["default"]] == ["auto"]
    assert rows["gsplat"]["traits"]["devices"] == ["cuda"]
