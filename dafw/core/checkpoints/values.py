"""The state of a run as a tree of plain values, for JSON, and arrays, for a file without pickle.

``packed`` turns a ``State`` into such a tree; ``unpacked`` makes the same state of it, to the last bit and with the
same order of the numbers in memory, on which the bits of sums depend. Opening a checkpoint executes nothing: only the
classes below are made, and observation operators whose classes the study's plugins have loaded already; no name in
a file is ever imported or called.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import fields
from typing import Any

import numpy as np

from dafw.core.cycle import Parts, State
from dafw.core.domain import Domain
from dafw.core.ensemble import Diagnostic, Ensemble, Forecast, Vehicle
from dafw.core.errors import CheckpointError
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.space import StateSpace
from dafw.core.window import PastCycle

type Tree = Any
"""What JSON can hold."""
VALUES: Mapping[str, type[Any]] = {
    one.__name__: one for one in (State, Forecast, Ensemble, Vehicle, PastCycle, Observation, Diagnostic)
}
PLAIN = (bool, int, float, str)


class UnwritableError(Exception):
    """A value cannot be written into a checkpoint; the text says which."""


def packed(state: State, parts: Parts, arrays: MutableMapping[str, np.ndarray]) -> Tree:
    """Return a state as a tree; its arrays are added to ``arrays``, an array that occurs twice only once.

    Raises UnwritableError, which names the place of the value.
    """
    return _Packing(parts, arrays).tree(state, "state")


class _Packing:
    """One state that is being packed."""

    def __init__(self, parts: Parts, arrays: MutableMapping[str, np.ndarray]) -> None:
        self._spaces, self._domain, self._arrays = _spaces(parts), parts.model.domain, arrays
        self._known: dict[int, Tree] = {}

    def tree(self, value: Any, place: str) -> Tree:
        if value is None or type(value) in PLAIN:
            return value
        if isinstance(value, np.ndarray):
            return self._array(value, place)
        if isinstance(value, np.generic):
            return {"number": self._array(np.asarray(value), place)}
        if isinstance(value, list):
            return [self.tree(one, f"{place}[{number}]") for number, one in enumerate(value)]
        if isinstance(value, tuple):
            return {"tuple": [self.tree(one, f"{place}[{number}]") for number, one in enumerate(value)]}
        if isinstance(value, Mapping):
            if any(type(key) not in PLAIN for key in value):
                raise UnwritableError(f"{place} has keys that are neither texts nor numbers")
            return {"mapping": [[key, self.tree(one, f"{place}['{key}']")] for key, one in value.items()]}
        if isinstance(value, StateSpace):
            return {"space": self._role(value, place)}
        if isinstance(value, Domain) and value is self._domain:
            return {"domain": True}
        if VALUES.get(type(value).__name__) is type(value):
            found = {one.name: getattr(value, one.name) for one in fields(VALUES[type(value).__name__])}
            return {"value": type(value).__name__, "fields": self._fields(found, place)}
        if isinstance(value, ObservationOperator):
            return {"operator": _name(type(value)), "fields": self._fields(vars(value), place)}
        raise UnwritableError(f"{place} is of the type {type(value).__name__}")

    def _fields(self, found: Mapping[str, Any], place: str) -> Tree:
        return {name: self.tree(one, f"{place}.{name}") for name, one in found.items()}

    def _role(self, space: StateSpace, place: str) -> str:
        for same in (lambda one: one is space, lambda one: one.agrees(space)):
            for role, one in self._spaces.items():
                if same(one):
                    return role
        raise UnwritableError(f"{place} is a state space that none of the study's models has")

    def _array(self, array: np.ndarray, place: str) -> Tree:
        if array.dtype.hasobject:
            raise UnwritableError(f"{place} is an array of Python objects")
        if type(array) is not np.ndarray:
            raise UnwritableError(f"{place} is of the type {type(array).__name__}")
        if id(array) not in self._known:
            name = f"a{len(self._arrays)}"
            # From the axis with the largest strides to that with the smallest: the order in which the numbers lie.
            axes = sorted(range(array.ndim), key=lambda axis: -abs(array.strides[axis]))
            self._arrays[name] = array.transpose(axes)
            self._known[id(array)] = {"array": name, "axes": axes, "fixed": not array.flags.writeable}
        return self._known[id(array)]


def unpacked(tree: Tree, parts: Parts, arrays: Mapping[str, np.ndarray]) -> State:
    """Return the state that ``packed`` made a tree of; raises CheckpointError if the tree is none."""
    try:
        state = _Unpacking(parts, arrays).value(tree)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"its state cannot be read ({type(error).__name__}: {error})") from error
    if not isinstance(state, State):
        raise CheckpointError(f"its state cannot be read (it is a {type(state).__name__})")
    return state


class _Unpacking:
    """One state that is being unpacked."""

    def __init__(self, parts: Parts, arrays: Mapping[str, np.ndarray]) -> None:
        self._spaces, self._domain, self._arrays = _spaces(parts), parts.model.domain, arrays
        self._operators = {_name(one): one for one in _subclasses(ObservationOperator)}
        self._made: dict[str, np.ndarray] = {}

    def value(self, tree: Tree) -> Any:
        if tree is None or type(tree) in PLAIN:
            return tree
        if isinstance(tree, list):
            return [self.value(one) for one in tree]
        if "array" in tree:
            return self._array(tree)
        if "number" in tree:
            return self._array(tree["number"])[()]
        if "tuple" in tree:
            return tuple(self.value(one) for one in tree["tuple"])
        if "mapping" in tree:
            return {key: self.value(one) for key, one in tree["mapping"]}
        if "space" in tree:
            return self._spaces[tree["space"]]
        if "domain" in tree:
            return self._domain
        if "value" in tree:
            kind = VALUES[tree["value"]]
            if set(tree["fields"]) != {one.name for one in fields(kind)}:
                raise ValueError(f"a {kind.__name__} has other fields: {sorted(tree['fields'])}")
            return self._object(kind, tree["fields"])
        return self._object(self._operators[tree["operator"]], tree["fields"])

    def _object(self, kind: type, told: Mapping[str, Tree]) -> Any:
        made: Any = object.__new__(kind)
        for name, one in told.items():
            object.__setattr__(made, name, self.value(one))  # the values were checked when they were first made
        return made

    def _array(self, tree: Tree) -> np.ndarray:
        if (name := tree["array"]) not in self._made:
            array = self._arrays[name].transpose(np.argsort(tree["axes"]) if tree["axes"] else ())
            array.setflags(write=not tree["fixed"])
            self._made[name] = array
        return self._made[name]


def _spaces(parts: Parts) -> dict[str, StateSpace]:
    models = {"model": parts.model, "truth": parts.truth, "free": parts.free}
    return {role: model.space for role, model in models.items() if model is not None}


def _subclasses(kind: type[Any]) -> Iterator[type[Any]]:
    for one in kind.__subclasses__():
        yield one
        yield from _subclasses(one)


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"
