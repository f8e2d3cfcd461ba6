"""Python values as Hydra overrides: what is written is what is read."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gavatar.config import LevelConfig
from gavatar.overrides import as_overrides, from_overrides, literal
from gavatar_runtime.errors import UserError

# what a command line can carry; ${...} is OmegaConf's and is escaped on the way, tested below
TEXT = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=20).filter(lambda text: "${" not in text)
NAMES = st.from_regex(r"[a-z_][a-z_0-9]*", fullmatch=True).filter(
    lambda name: name not in ("nan", "inf", "null", "true", "false")
)
PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXT
VALUES = st.recursive(PLAIN, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3))


def parsed(override: str):
    (found,) = OverridesParser.create().parse_overrides([override])
    assert not found.is_sweep_override()
    return found.key_or_group, found.value()


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)  # its tables of characters are made once
@given(VALUES)
def test_every_value_is_read_back_as_it_was(value):
    assert parsed(f"key={literal(value)}") == ("key", value)


def test_not_a_number_and_infinity_are_read_back():
    assert math.isnan(parsed(f"key={literal(float('nan'))}")[1])
    assert parsed(f"key={literal(-math.inf)}")[1] == -math.inf


def test_numpy_scalars_paths_tuples_and_dataclasses_are_values_too():
    assert parsed(f"k={literal(np.float32(0.5))}")[1] == 0.5
    assert parsed(f"k={literal(np.bool_(True))}")[1] is True
    assert parsed(f"k={literal(Path('a b') / 'c,d=e')}")[1] == str(Path("a b") / "c,d=e")
    assert parsed(f"k={literal((1, 2))}")[1] == [1, 2]
    assert parsed(f"k={literal([LevelConfig()])}")[1] == [dataclasses.asdict(LevelConfig())]


def test_a_dollar_in_a_path_is_no_interpolation():
    from omegaconf import OmegaConf

    key, value = parsed(f"capture={literal('a/${b}/c')}")
    assert OmegaConf.to_container(OmegaConf.create({key: value}), resolve=True) == {"capture": "a/${b}/c"}


def test_a_command_line_is_settings_and_settings_are_a_command_line():
    arguments = ["decoder=mlp", "stage1.steps=20", "losses.l1=null", "motion.enabled=false", "name='a b'",
                 "stage1.levels=[{until: 1.0, gaussians: 2850, image: 0.25}]"]  # fmt: skip
    settings = from_overrides(arguments)
    assert settings == {
        "decoder": "mlp", "stage1.steps": 20, "losses.l1": None, "motion.enabled": False, "name": "a b",
        "stage1.levels": [{"until": 1.0, "gaussians": 2850, "image": 0.25}],
    }  # fmt: skip
    assert from_overrides(as_overrides(settings)) == settings
    assert from_overrides([]) == {}


@pytest.mark.parametrize("argument", ["decoder=mlp,upstream", "~losses.l1", "+new=1", "out=${capture}"])
def test_what_gives_no_one_value_is_no_setting(argument):
    with pytest.raises(UserError, match="give one value, KEY=VALUE"):
        from_overrides([argument])


def test_nested_and_dotted_settings_are_the_same():
    assert as_overrides({"stage1": {"steps": 50}}) == as_overrides({"stage1.steps": 50}) == ["stage1.steps=50"]


def test_the_name_of_a_component_chooses_it():
    assert as_overrides({"encoder": {"name": "unet", "width": 16}}) == ["encoder=unet", "encoder.width=16"]
    assert as_overrides({"losses": {"perceptual": {"weight": 0.1}}}) == ["losses.perceptual={weight: 0.1}"]


@pytest.mark.parametrize("name", ["", "a b", "a:b", "nan", 3])
def test_a_key_that_is_no_name_is_refused(name):
    with pytest.raises(UserError, match="is no name of a setting"):
        literal({name: 1})


@pytest.mark.parametrize("value", [object(), 1j, LevelConfig])
def test_a_value_that_is_no_setting_is_named(value):
    with pytest.raises(UserError, match=r"stage1\.steps: a \w+ is no setting"):
        as_overrides({"stage1": {"steps": value}})
