"""The registry, how plugins fill it, and how its components reach Hydra."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import sys
import textwrap
import warnings

import pytest
from places import ROOT

from gavatar import registry as registries
from gavatar.cli import list as listing
from gavatar.config import check, compose_config
from gavatar.optional import EXTRAS, extra_of, import_from_extra, requires_extra
from gavatar_runtime.components import Registry
from gavatar_runtime.errors import UserError, exit_cleanly


@dataclasses.dataclass
class Options:
    """width: how wide. names: of what."""

    width: int = 64
    names: list[str] = dataclasses.field(default_factory=lambda: ["a"])


@dataclasses.dataclass(frozen=True)
class FrozenOptions:
    """A frozen dataclass, one field of which the user owes."""

    path: str
    width: int = 4


@pytest.fixture
def decoders() -> Registry:
    registry = Registry("decoder")

    @registry.register("mlp", config=Options)
    def build_mlp(options, *, channels):
        """Builds nothing."""
        return options, channels

    registry.register("upstream", summary="another")(lambda options: None)
    return registry


def test_the_options_given_are_filled_and_the_rest_keeps_its_defaults(decoders):
    options, channels = decoders.build("mlp", {"name": "mlp", "width": 8}, channels=3)
    assert (options, channels) == (Options(width=8), 3)
    assert decoders.options("mlp", None).names is not decoders.options("mlp", None).names


def test_an_unknown_name_lists_the_choices_and_the_nearest(decoders):
    with pytest.raises(UserError, match=r"unknown decoder 'mpl': choose from: mlp, upstream; did you mean 'mlp'\?"):
        decoders["mpl"]
    with pytest.raises(UserError, match=r"choose from: mlp, upstream$"):
        decoders["zzzz"]
    with pytest.raises(UserError, match=r"choose from: \(none\)"):
        Registry("encoder")["none"]


def test_an_unknown_option_lists_the_choices_and_the_nearest(decoders):
    with pytest.raises(UserError, match=r"decoder 'mlp' has no option 'widht': .* did you mean 'width'\?"):
        decoders.options("mlp", {"widht": 3})
    with pytest.raises(UserError, match=r"decoder 'upstream' has no option 'width': choose from: \(none\)"):
        decoders.options("upstream", {"width": 3})


def test_a_name_taken_by_another_module_is_replaced_with_a_warning(decoders):
    def other(options):
        return "other"

    other.__module__ = "elsewhere.plugin"
    with pytest.warns(UserWarning, match="decoder 'mlp' of .* is replaced by elsewhere.plugin"):
        decoders.register("mlp")(other)
    assert decoders.build("mlp") == "other"
    assert decoders.names() == ["mlp", "upstream"]


def test_a_module_may_register_its_own_name_again_silently(decoders):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decoders.register("mlp")(decoders["mlp"].factory)


@pytest.mark.parametrize("config", [dict, {"width": 3}, None])
def test_options_must_be_a_dataclass(decoders, config):
    with pytest.raises(TypeError, match="decoder 'bad': config must be a dataclass"):
        decoders.register("bad", config=config)


def test_the_summary_falls_back_to_the_first_line_of_the_docstring(decoders):
    assert decoders["mlp"].summary == "Builds nothing."
    assert [c.name for c in decoders] == ["mlp", "upstream"]
    assert "mlp" in decoders
    assert "none" not in decoders


# Plugins


@pytest.fixture
def plugin_modules(tmp_path, monkeypatch):
    """Write modules into an importable folder and announce them as entry points: {module: source}."""

    def install(sources: dict[str, str]) -> None:
        for name, source in sources.items():
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(source))
        points = [importlib.metadata.EntryPoint(name, name, registries.ENTRY_POINT_GROUP) for name in sources]
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)

    monkeypatch.syspath_prepend(str(tmp_path))
    registries.load_plugins()  # the real ones, so that only what `install` adds is new
    monkeypatch.setattr(registries, "_builtin_modules", lambda: [])
    registries.load_plugins.cache_clear()
    before = {registry.group: dict(registry._components) for registry in registries.REGISTRIES}
    yield install
    for registry in registries.REGISTRIES:
        registry._components = before[registry.group]
    registries.load_plugins.cache_clear()
    for name in [n for n, m in sys.modules.items() if str(getattr(m, "__file__", "")).startswith(str(tmp_path))]:
        del sys.modules[name]


GOOD = """
    from gavatar.registry import DECODERS

    @DECODERS.register("fine")
    def fine(options): ...
"""


def test_a_failing_plugin_is_reported_with_its_cause_and_the_rest_go_on(plugin_modules):
    plugin_modules({"p_raises": "1 / 0", "p_exits": "raise SystemExit(3)", "p_good": GOOD})
    with pytest.warns(UserWarning, match=r"p_(raises|exits) .* was skipped") as caught:
        failures = registries.load_plugins()
    assert {f.plugin.split()[0]: f.cause for f in failures} == {
        "p_raises": "ZeroDivisionError: division by zero",
        "p_exits": "SystemExit: 3",
    }
    assert len(caught) == 2
    assert "fine" in registries.DECODERS


def test_plugins_that_want_an_extra_share_one_warning_that_says_what_to_install(plugin_modules, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)  # as if not installed
    plugin_modules({"p_one": "import gsplat", "p_two": "from gsplat import rasterization", "p_good": GOOD})
    with pytest.warns(UserWarning, match=r"pip install 'gavatar\[gpu\]' brings them: p_one .*, p_two ") as caught:
        failures = registries.load_plugins()
    assert len(caught) == 1
    assert {f.extra for f in failures} == {"gpu"}
    assert all(f.cause == "needs gsplat: pip install 'gavatar[gpu]'" for f in failures)
    assert "fine" in registries.DECODERS


def test_a_plugin_that_lacks_its_own_dependency_is_not_blamed_on_an_extra(plugin_modules):
    plugin_modules({"p_needs": "import no_such_module_anywhere"})
    with pytest.warns(UserWarning, match="was skipped: ModuleNotFoundError"):
        (failure,) = registries.load_plugins()
    assert failure.extra == ""


def test_every_shipped_plugin_imports_with_the_training_extras():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert [f for f in registries.load_plugins() if f.extra in ("", "train")] == []


# Hydra


def compose(*overrides):
    hydra = pytest.importorskip("hydra")
    store = pytest.importorskip("hydra.core.config_store").ConfigStore.instance()
    defaults = ["_self_"] + [{r.group: r.names()[0]} for r in (registries.DECODERS, registries.ENCODERS)]
    store.store(name="registry_test", node={"defaults": defaults, "decoder": {}, "encoder": {}})
    registries.fill_config_store()
    with hydra.initialize(version_base="1.3", config_path=None):
        return hydra.compose("registry_test", overrides=list(overrides))


def test_every_component_composes_by_name_with_its_defaults():
    registries.load_plugins()
    for registry in (registries.DECODERS, registries.ENCODERS):
        for component in registry:
            node = compose(f"{registry.group}={component.name}")[registry.group]
            assert node.name == component.name
            assert set(node) == {"name"} | {f.name for f in dataclasses.fields(component.config)}


def test_an_override_of_an_option_is_typed_and_checked(plugin_modules):
    registries.DECODERS.register("typed", config=Options)(lambda options: options)
    node = compose("decoder=typed", "decoder.width=8", "decoder.names=[x,y]").decoder
    assert registries.DECODERS.build("typed", node) == Options(8, ["x", "y"])
    for wrong in ("decoder.width=wide", "decoder.widht=8"):
        with pytest.raises(Exception, match=r"widht|width"):
            compose("decoder=typed", wrong)


def test_frozen_options_and_options_without_default_compose(plugin_modules):
    from omegaconf import OmegaConf

    registries.DECODERS.register("frozen", config=FrozenOptions)(lambda options: options)
    assert OmegaConf.is_missing(compose("decoder=frozen").decoder, "path")
    node = compose("decoder=frozen", "decoder.path=here", "decoder.width=5").decoder
    assert registries.DECODERS.build("frozen", node) == FrozenOptions("here", 5)


def test_options_that_hydra_cannot_hold_are_named_and_the_rest_go_on(plugin_modules):
    @dataclasses.dataclass
    class Odd:
        value: complex = 1j

    registries.DECODERS.register("odd", config=Odd)(lambda options: options)
    with pytest.warns(UserWarning, match="decoder 'odd' cannot be configured"):
        node = compose("decoder=mlp").decoder
    assert node.name == "mlp"


# gavatar-list


def test_the_list_shows_options_origin_and_failures(plugin_modules, capsys):
    plugin_modules({"p_raises": "1 / 0", "p_good": GOOD})
    registries.DECODERS.register(
        "frozen", config=FrozenOptions, needs="a file of your own", missing=lambda: "nobody brought the file"
    )(lambda options: options)
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


# Extras


@pytest.mark.parametrize("preset", ["default", "demo", "paper", "upstream"])
def test_every_preset_takes_every_encoder_and_decoder(preset):
    registries.load_plugins()
    for registry in (registries.ENCODERS, registries.DECODERS):
        for name in registry.names():
            config = check(compose_config(["capture=x", f"experiment={preset}", f"{registry.group}={name}"]))
            assert getattr(config, registry.group)["name"] == name


def test_every_module_named_for_an_extra_is_one_that_pyproject_lists():
    tomllib = pytest.importorskip("tomllib")
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    brought_by = {"omegaconf": "hydra_core", "cv2": "opencv_contrib_python_headless"}
    for extra, modules in EXTRAS.items():
        names = " ".join(declared[extra]).replace("-", "_")
        for module in modules:
            assert brought_by.get(module, module) in names, f"{module} is not in extra {extra}"


def test_the_extras_bring_one_wheel_of_opencv_by_one_line():
    """Two of OpenCV's wheels in one environment overwrite each other's files."""
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    (line,) = {line for lines in extras.values() for line in lines if line.startswith("opencv")}
    assert line in extras["train"]
    assert line in extras["video"]
    assert not [line for line in project["dependencies"] if line.startswith("opencv")]


def test_submodules_belong_to_the_extra_of_their_package():
    assert extra_of("torch.nn.functional") == "train"
    assert extra_of("numpy") is None
    assert extra_of(None) is None


@pytest.mark.parametrize("absent", ["torch", "kornia"])
def test_a_command_without_its_extra_is_one_sentence_and_exit_code_2(absent, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, absent, None)
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/gavatar-train", "capture=x"])

    @exit_cleanly
    @requires_extra("train")
    def main():
        import kornia  # noqa: F401

    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == 2
    expected = f"error: gavatar-train needs {absent}, which is not installed: pip install 'gavatar[train]'\n"
    assert capsys.readouterr().err == expected


def test_a_missing_module_of_no_extra_stays_a_bug():
    @requires_extra("train")
    def main():
        import no_such_module_anywhere  # noqa: F401

    with pytest.raises(ModuleNotFoundError):
        main()
    with pytest.raises(ModuleNotFoundError):
        import_from_extra("no_such_module_anywhere", "decoder 'x'")


def test_a_heavy_import_on_first_use_names_the_user_and_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(UserError, match=r"rasterizer 'gsplat' needs gsplat, .*: pip install 'gavatar\[gpu\]'"):
        import_from_extra("gsplat", "rasterizer 'gsplat'")
