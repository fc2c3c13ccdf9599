"""Options of plugins: types, ranges, nesting; the error for a wrong one says what is accepted."""

from dataclasses import dataclass, make_dataclass
from typing import Any

import pytest

from dafw import REQUIRED, ConfigurationError, OptionError, option
from dafw.core.options import build, describe, schema


@dataclass
class Nested:
    size: float = option(1.0, "a size", above=0.0)


@dataclass
class Options:
    count: int = option(3, "a count", minimum=1)
    factor: float = option(1.0, "a factor", maximum=2.0)
    mode: str = option("slow", "a mode", choices=("slow", "fast"))
    limits: list[float] | None = option(None, "two limits", minimum=0.0)
    names: dict[str, str] = option({}, "names")
    anything: Any = option(0, "anything")
    nested: Nested = option(Nested, "a group")


@dataclass
class Required:
    value: int


def test_defaults_are_made_anew_for_every_instance():
    first, second = build(Options, {}, "x"), build(Options, {}, "x")
    first.names["a"] = "b"
    first.nested.size = 7.0
    assert second.names == {} and second.nested.size == 1.0


def test_values_arrive_typed():
    made = build(Options, {"factor": 2, "limits": [1, 2], "nested": {"size": 4}, "anything": [1]}, "x")
    assert (made.factor, made.limits, made.nested.size, made.anything) == (2.0, [1.0, 2.0], 4.0, [1])
    assert isinstance(made.factor, float)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"cuont": 1}, "filter 'x': unknown option 'cuont', did you mean 'count'. .accepted: count, factor"),
        ({"count": 1.5}, "'count' must be of type int, got 1.5"),
        ({"count": True}, "'count' must be of type int, got True"),
        ({"count": 0}, "'count' must be at least 1, got 0"),
        ({"factor": "2"}, "'factor' must be of type float, got '2'"),
        ({"factor": 2.5}, "at most 2.0"),
        ({"factor": float("nan")}, "'factor' must be"),
        ({"factor": float("-inf")}, "must be finite"),
        ({"mode": "medium"}, "one of slow, fast; got 'medium'"),
        ({"limits": [1.0, -1.0]}, "at least 0.0"),
        ({"limits": "ab"}, "must be of type"),
        ({"names": {"a": 1}}, "must be of type"),
        ({"nested": 3}, "'nested' must be a mapping"),
        ({"nested": {"size": 0.0}}, "filter 'x', nested: option 'size' must be above 0.0"),
        ({"nested": {"length": 1}}, "unknown option 'length' .accepted: size"),
    ],
)
def test_wrong_values_are_refused_by_name(values, message):
    with pytest.raises(OptionError, match=message):
        build(Options, values, "filter 'x'")


def test_a_required_option_must_be_given():
    with pytest.raises(OptionError, match="'value' must be given"):
        build(Required, {}, "x")
    assert build(Required, {"value": 4}, "x").value == 4


def test_options_are_described_with_dotted_names():
    described = {entry.name: entry for entry in describe(Options)}
    assert described["nested.size"].help == "a size"
    assert described["limits"].type == "list[float] | None"
    assert describe(Required)[0].default is REQUIRED


def test_ranges_are_described_in_words_and_as_plain_values():
    described = {entry.name: entry for entry in describe(Options)}
    assert described["nested.size"].accepted == "above 0" and described["mode"].accepted == "one of slow, fast"
    assert described["count"].plain() == {
        "required": False,
        "name": "count",
        "type": "int",
        "default": 3,
        "help": "a count",
        "minimum": 1,
    }
    assert described["limits"].plain()["default"] is None and described["mode"].plain()["choices"] == ["slow", "fast"]
    assert describe(Required)[0].plain() == {"required": True, "name": "value", "type": "int", "help": ""}


@pytest.mark.parametrize(
    ("hint", "default", "message"),
    [
        (float, option(None, ""), "Wrong: option 'gain' must be of type float, got None, its own default"),
        (float, option(0.5, "", minimum=1.0), "'gain' must be at least 1.0, got 0.5, its own default"),
        (str, option("c", "", choices=("a", "b")), "'gain' must be one of a, b; got 'c', its own default"),
        (float, option(float("inf"), ""), "the default of option 'gain' is no plain value, but inf"),
        (Any, option({"a": object()}, ""), "the default of option 'gain' is no plain value"),
    ],
)
def test_a_default_is_held_to_what_a_given_value_is(hint, default, message):
    wrong = make_dataclass("Wrong", [("gain", hint, default)])
    for ask in (describe, schema):
        with pytest.raises(OptionError, match=message):
            ask(wrong)
    with pytest.raises(OptionError, match="gain"):
        build(wrong, {}, "filter 'wrong'")


def test_a_default_is_converted_as_a_given_value_is():
    assert build(make_dataclass("Whole", [("gain", float, option(1, ""))]), {}, "x").gain.hex() == (1.0).hex()


def test_nested_defaults_are_made_anew():
    nested = make_dataclass("Nested", [("places", list[list[float]], option([[1.0]], ""))])
    build(nested, {}, "x").places[0].append(2.0)
    assert build(nested, {}, "x").places == [[1.0]]


def test_a_subclass_with_options_of_its_own_must_be_a_dataclass_itself():
    class Forgotten(Required):
        share: float = 0.5

    with pytest.raises(OptionError, match="Forgotten is not a dataclass"):
        describe(Forgotten)


def test_a_class_that_is_no_dataclass_is_named():
    class Plain:
        value: int = 3

    with pytest.raises(OptionError, match="Plain is not a dataclass"):
        describe(Plain)


@dataclass
class Ordered:
    low: float = option(0.0, "the lower one")
    high: float = option(1.0, "the upper one")

    def __post_init__(self):
        if self.low > self.high:
            raise ConfigurationError(f"low is {self.low}, expected at most high, {self.high}")


def test_what_the_class_itself_refuses_says_where_it_was_said():
    with pytest.raises(ConfigurationError, match=r"^filter 'x': low is 2.0, expected at most high, 1.0$"):
        build(Ordered, {"low": 2.0}, "filter 'x'")
