"""Options of plugins: typed dataclass fields with a help text and a range, checked before anything is computed.

A plugin's options are the fields of its dataclass::

    @dataclass
    class ETKF(Filter):
        inflation: float = option(1.0, "factor on the forecast anomalies", minimum=1.0)

Nested dataclasses group options. ``schema`` turns such a class into what Hydra composes, ``build`` turns a composed
mapping back into an instance, and ``describe`` lists the options for people.
"""

from __future__ import annotations

import copy
import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, make_dataclass
from functools import cache, partial
from typing import Any

from dafw.core.errors import ConfigurationError, OptionError

REQUIRED = MISSING
"""Marks an option that has no default and must be given."""


def option(
    default: Any,
    help: str,
    *,
    minimum: float | None = None,
    above: float | None = None,
    maximum: float | None = None,
    choices: Sequence[Any] | None = None,
) -> Any:
    """Declare one option of a plugin; with ``REQUIRED`` for a default it must be given.

    ``minimum`` and ``maximum`` are inclusive, ``above`` is exclusive; each holds for every number in a list.
    A mutable default (list, dict) or a dataclass type is made anew for every instance.
    """
    metadata = {"help": help, "minimum": minimum, "above": above, "maximum": maximum, "choices": choices}
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    if isinstance(default, list | dict):
        return field(default_factory=lambda: copy.deepcopy(default), metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Described:
    """One option as people see it; ``default`` is REQUIRED where it must be given."""

    name: str
    type: str
    default: Any
    help: str
    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    choices: list[Any] | None = None

    @property
    def accepted(self) -> str:
        """The range in words, such as ``at least 1, at most 2``."""
        limits = (("at least", self.minimum), ("above", self.above), ("at most", self.maximum))
        words = [f"{word} {limit:g}" for word, limit in limits if limit is not None]
        return ", ".join(words + ([f"one of {', '.join(map(str, self.choices))}"] if self.choices is not None else []))

    def plain(self) -> dict[str, Any]:
        """Return the option for JSON: without ``default`` if it must be given, and without limits that it lacks."""
        entries = {f.name: getattr(self, f.name) for f in fields(self)}
        required = self.default is REQUIRED
        return {"required": required} | {
            name: value
            for name, value in entries.items()
            if not (required if name == "default" else value is None and name not in ("name", "type", "help"))
        }


def _option_fields(cls: type) -> tuple[tuple[dataclasses.Field[Any], Any], ...]:
    """The option fields of a dataclass with their resolved types."""
    if not is_dataclass(cls) or ("__dataclass_fields__" not in vars(cls) and vars(cls).get("__annotations__")):
        raise OptionError(f"{cls.__module__}.{cls.__qualname__} is not a dataclass: decorate it with @dataclass")
    return _resolved(cls)


@cache
def _resolved(cls: type) -> tuple[tuple[dataclasses.Field[Any], Any], ...]:
    """Evaluate the text of types: that takes a millisecond a class, and a study asks some forty times."""
    hints = typing.get_type_hints(cls)
    return tuple((f, hints[f.name]) for f in fields(cls) if f.init)


def _is_group(hint: Any) -> bool:
    return is_dataclass(hint) and isinstance(hint, type)


def _is_required(f: dataclasses.Field[Any]) -> bool:
    return f.default is MISSING and f.default_factory is MISSING


def _default(f: dataclasses.Field[Any], hint: Any, where: str) -> Any:
    """Return the default of an option, checked like a given value; raises OptionError."""
    default = f.default_factory() if f.default_factory is not MISSING else f.default
    if _is_group(hint):
        return default
    if not _is_plain(default):
        raise OptionError(f"{where}: the default of option '{f.name}' is no plain value, but {default!r}")
    try:
        return _checked(default, hint, f, where)
    except OptionError as error:
        raise OptionError(f"{error}, its own default") from None


def _is_plain(value: Any) -> bool:
    """Tell whether configurations and JSON can hold a value."""
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and _is_plain(entry) for key, entry in value.items())
    return value is None or isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value))


def schema(cls: type, **fixed: str) -> type:
    """Return a dataclass type that Hydra can compose: the options of ``cls`` after the ``fixed`` string fields."""
    made: list[tuple[str, Any, Any]] = [
        (name, str, field(default=value, metadata={"fixed": True})) for name, value in fixed.items()
    ]
    for f, hint in _option_fields(cls):
        if _is_group(hint):
            nested = schema(hint)
            made.append((f.name, nested, field(default_factory=nested)))
        elif _is_required(f):
            # A mapping is empty instead of missing, so that entries can be added one by one.
            missing = field(default_factory=dict) if typing.get_origin(hint) is dict else field(default="???")
            made.append((f.name, _composable(hint), missing))
        else:
            default = _default(f, hint, cls.__qualname__)
            made.append((f.name, _composable(hint), field(default_factory=partial(copy.deepcopy, default))))
    return make_dataclass(cls.__name__, made)


def _composable(hint: Any) -> Any:
    """Return the type that Hydra checks, or Any for types that only ``build`` can check.

    These are a union with a container, and a container of containers (where Hydra does not accept an int for a float).
    """
    parts = [part for part in typing.get_args(hint) if part is not type(None)]
    return Any if any(typing.get_origin(part) is not None for part in parts) or len(parts) > 2 else hint


def build[T](cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Make a ``cls`` from plain values, nested mappings included.

    ``where`` names the place in messages (``filter 'etkf'``). Raises OptionError if an option is unknown, of the
    wrong type or out of range, and ConfigurationError if the class itself refuses the values.
    """
    known = dict((f.name, (f, hint)) for f, hint in _option_fields(cls))
    for name in values:
        if name not in known:
            raise OptionError(unknown_option(cls, str(name), where))
    arguments: dict[str, Any] = {}
    for name, (f, hint) in known.items():
        if _is_required(f) and values.get(name, {}) == {}:
            raise OptionError(f"{where}: option '{name}' must be given")
        if name not in values:
            arguments[name] = _default(f, hint, where)
        elif _is_group(hint):
            if not isinstance(values[name], Mapping):
                raise OptionError(f"{where}: option '{name}' must be a mapping, got {values[name]!r}")
            arguments[name] = build(hint, values[name], f"{where}, {name}")
        else:
            arguments[name] = _checked(values[name], hint, f, where)
    try:
        return cls(**arguments)
    except ConfigurationError as error:  # raised by its __post_init__, which does not know the plugin's name
        if str(error).startswith(where):
            raise
        raise type(error)(f"{where}: {error}") from error


def unknown_option(cls: type, name: str, where: str) -> str:
    """Return the message about an option that ``cls`` does not have: it suggests the nearest and lists all."""
    known = [f.name for f, _ in _option_fields(cls) if "fixed" not in f.metadata]
    nested = [described.name for described in describe(cls) if described.name.rpartition(".")[2] == name]
    near = [*nested, *difflib.get_close_matches(name, known, n=1)]
    hint = f", did you mean '{near[0]}'?" if near else ""
    return f"{where}: unknown option '{name}'{hint} (accepted: {', '.join(known) or 'none'})"


def _checked(value: Any, hint: Any, f: dataclasses.Field[Any], where: str) -> Any:
    converted = _converted(value, hint)
    if converted is MISSING:
        raise OptionError(f"{where}: option '{f.name}' must be of type {type_name(hint)}, got {value!r}")
    limits = f.metadata
    if limits.get("choices") is not None and converted not in limits["choices"]:
        accepted = ", ".join(map(str, limits["choices"]))
        raise OptionError(f"{where}: option '{f.name}' must be one of {accepted}; got {value!r}")
    for number in _numbers(converted):
        if limits.get("minimum") is not None and not number >= limits["minimum"]:
            raise OptionError(f"{where}: option '{f.name}' must be at least {limits['minimum']}, got {value!r}")
        if limits.get("above") is not None and not number > limits["above"]:
            raise OptionError(f"{where}: option '{f.name}' must be above {limits['above']}, got {value!r}")
        if limits.get("maximum") is not None and not number <= limits["maximum"]:
            raise OptionError(f"{where}: option '{f.name}' must be at most {limits['maximum']}, got {value!r}")
        if number != number or number in (float("inf"), float("-inf")):
            raise OptionError(f"{where}: option '{f.name}' must be finite, got {value!r}")
    return converted


def _converted(value: Any, hint: Any) -> Any:
    """Return ``value`` as the hinted type, or MISSING if it has another; the only conversion is from int to float."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if isinstance(hint, types.UnionType) or origin is typing.Union:
        return next((c for part in parts if (c := _converted(value, part)) is not MISSING), MISSING)
    if hint is type(None):
        return None if value is None else MISSING
    if origin is list and isinstance(value, list | tuple):
        items = [_converted(item, parts[0]) for item in value]
        return MISSING if any(item is MISSING for item in items) else items
    if origin is dict and isinstance(value, Mapping):
        entries = {key: _converted(item, parts[1]) for key, item in value.items()}
        return MISSING if any(item is MISSING for item in entries.values()) else entries
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, type) and isinstance(value, hint) and (hint is bool or not isinstance(value, bool)):
        return value
    return MISSING


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield value
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(item)


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` updated with ``changes``; nested mappings are merged entry by entry."""
    result = dict(base)
    for name, value in changes.items():
        old = result.get(name)
        result[name] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def describe(cls: type, prefix: str = "") -> list[Described]:
    """List the options of ``cls``, nested ones under dotted names; raises OptionError if a default is wrong."""
    listed: list[Described] = []
    for f, hint in _option_fields(cls):
        if _is_group(hint):
            listed += describe(hint, f"{prefix}{f.name}.")
        else:
            default = REQUIRED if _is_required(f) else _default(f, hint, cls.__qualname__)
            limits = {name: f.metadata.get(name) for name in ("minimum", "above", "maximum")}
            choices = list(f.metadata["choices"]) if f.metadata.get("choices") is not None else None
            text = f.metadata.get("help", "")
            listed.append(Described(prefix + f.name, type_name(hint), default, text, **limits, choices=choices))
    return listed


def type_name(hint: Any) -> str:
    """Return a type as a reader would write it: ``float | None``, ``list[float]``."""
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint).replace("typing.", "")


def require_options(made: Any, where: str) -> None:
    """Check the options of an object that was made in Python against their types and ranges; raises OptionError.

    Numpy numbers and arrays count as Python's. Fields that were not declared by ``option`` are not checked, nor is an
    object that is not a dataclass.
    """
    if not is_dataclass(made) or not any("help" in f.metadata for f in fields(made)):
        return
    for f, hint in _option_fields(type(made)):
        value = getattr(made, f.name)
        if "help" not in f.metadata:
            continue
        if _is_group(hint):
            if not isinstance(value, hint):
                raise OptionError(
                    f"{where}: option '{f.name}' must be of type {hint.__name__}, got {value!r}; from plain mappings "
                    f"{type(made).__name__}.from_options(...) makes it"
                )
            require_options(value, f"{where}, {f.name}")
        else:
            _checked(value.tolist() if hasattr(value, "tolist") else value, hint, f, where)
