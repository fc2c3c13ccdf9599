"""The registry: plugins of all packages, and clear errors if a package is broken."""

import sys
import types
from dataclasses import dataclass, field
from importlib.metadata import entry_points, version

import pytest

from dafw import Filter, OptionError, PluginError, PluginSpec, hookimpl
from dafw.core.registry import Registry, _distributions


@dataclass
class Toy(Filter):
    """A class that no package has registered."""


BUILT_IN = list(entry_points(group="dafw", name="builtin"))


@dataclass(frozen=True)
class FakeEntry:
    """An entry point that loads a given object, or fails."""

    name: str
    loaded: object
    dist: object = None
    value: str = field(default="fake.package")

    def load(self):
        if isinstance(self.loaded, Exception):
            raise self.loaded
        return self.loaded


def package(*specs, hook="dafw_plugins", marked=True):
    """Return a module whose hook gives ``specs``."""
    module = types.ModuleType("fake")

    def give():
        return list(specs)

    give.__name__ = hook
    setattr(module, hook, hookimpl(give) if marked else give)
    return module


@dataclass
class MyFilter(Filter):
    gain: float = 1.0


class NotADataclass(Filter):
    gain: float = 1.0

    def __init__(self):
        pass


sys.modules["fake_filters"] = types.ModuleType("fake_filters")
sys.modules["fake_filters"].MyFilter = MyFilter
sys.modules["fake_filters"].NotADataclass = NotADataclass
GOOD = PluginSpec("filter", "mine", "fake_filters:MyFilter")


def registry_with(*entries):
    return Registry([*BUILT_IN, *entries])


def test_the_built_ins_come_through_the_same_door():
    registry = Registry(BUILT_IN)
    assert registry.problems == []
    assert {"etkf", "none"} <= set(registry.names("filter")) and {"ad", "ad_ins"} <= set(registry.names("model"))


def test_a_package_adds_its_plugins():
    registry = registry_with(FakeEntry("acme", package(GOOD)))
    mine = registry.create("filter", {"name": "mine", "gain": 3})
    assert isinstance(mine, MyFilter) and mine.gain == 3.0 and mine.label == "filter 'mine'"
    assert [option.name for option in registry.options("filter", "mine")] == ["gain"]


@pytest.mark.parametrize(
    ("loaded", "message"),
    [
        (ImportError("no module named 'torch'"), "cannot be imported: ImportError: no module named 'torch'"),
        (package(GOOD, hook="dafw_plugin"), "unknown hook 'dafw_plugin'"),
        (package(GOOD, marked=False), "no hook 'dafw_plugins' marked"),
        (types.ModuleType("empty"), "no hook 'dafw_plugins' marked"),
        (package(PluginSpec("filter", "etkf", "fake_filters:MyFilter")), "filter 'etkf' is taken already by dafw"),
        (package(PluginSpec("filtre", "mine", "fake_filters:MyFilter")), "unknown kind 'filtre'"),
        (package("mine"), "gave a str, not a PluginSpec"),
    ],
)
def test_a_broken_package_is_named_and_the_others_are_there(loaded, message):
    registry = registry_with(FakeEntry("acme", loaded))
    assert [problem.package for problem in registry.problems] == ["fake.package (fake.package)"]
    assert message in registry.problems[0].message
    assert "etkf" in registry.names("filter")
    assert type(registry.create("filter", {"name": "etkf"})).__module__ == "dafw.plugins.filters.etkf"


def test_asking_for_what_a_broken_package_should_hold_gives_the_reason():
    registry = registry_with(FakeEntry("acme", ImportError("no module named 'torch'")))
    with pytest.raises(PluginError, match=r"no filter 'mine'.*no module named 'torch'"):
        registry.create("filter", {"name": "mine"})


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("no_such_module:X", "cannot be imported: ModuleNotFoundError"),
        ("fake_filters:Missing", "cannot be imported: AttributeError"),
        ("dafw.plugins.policies.enie2d:EnIE2D", "is no filter class"),
    ],
)
def test_a_target_that_is_wrong_is_named(target, message):
    registry = registry_with(FakeEntry("acme", package(PluginSpec("filter", "mine", target))))
    with pytest.raises(PluginError, match=f"filter 'mine' of fake.package.*{message}"):
        registry.create("filter", {"name": "mine"})


def test_a_plugin_that_is_no_dataclass_is_told_so():
    registry = registry_with(FakeEntry("acme", package(PluginSpec("filter", "mine", "fake_filters:NotADataclass"))))
    with pytest.raises(PluginError, match="NotADataclass is not a dataclass: decorate it"):
        registry.schema("filter", "mine")


def test_names_and_options_are_suggested():
    registry = Registry(BUILT_IN)
    with pytest.raises(PluginError, match="did you mean 'etkf'"):
        registry.create("filter", {"name": "etfk"})
    with pytest.raises(
        OptionError, match=r"filter 'etkf': unknown option 'inflatoin', did you mean 'inflation'. .accepted: "
    ):
        registry.create("filter", {"name": "etkf", "inflatoin": 1})
    with pytest.raises(PluginError, match="a filter needs a name"):
        registry.create("filter", {"inflation": 1})


def test_parts_are_named_as_registered_or_by_their_class():
    registry = Registry(BUILT_IN)
    parts = {"filter": registry.create("filter", {"name": "etkf"}), "truth": Toy()}
    assert registry.parts(parts) == {"filter": "etkf", "truth": f"{Toy.__module__}:Toy"}


def test_versions_are_those_of_every_package_of_plugins(tmp_path, monkeypatch):
    registry = Registry(entry_points(group="dafw"))
    assert registry.versions()["dafw"] == version("dafw")
    about = tmp_path / "theirs-2.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 2.5\n")
    (about / "top_level.txt").write_text("their_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(Toy, "__module__", "their_module.models")
    _distributions.cache_clear()
    try:
        assert registry.versions([Toy()])["theirs"] == "2.5"
    finally:
        _distributions.cache_clear()


def as_a_function_makes_it():
    @dataclass
    class Inner(Filter):
        gain: float = 1.0

    return Inner


Alias = as_a_function_makes_it()


def test_a_class_is_known_by_where_it_was_registered_whatever_it_calls_itself():
    registry = Registry([FakeEntry("fake", package(PluginSpec("filter", "mine", f"{__name__}:Alias")))])
    assert registry.recipe(Alias(gain=2.0)) == {"name": "mine", "gain": 2.0}
    assert registry.parts({"filter": Alias(), "other": MyFilter()})["filter"] == "mine"
    assert registry.recipe(MyFilter()) is None
