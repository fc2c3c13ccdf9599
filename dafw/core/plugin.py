"""What all kinds of plugins share: their name in messages, and the checks of what they return."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from dafw.core.ensemble import Diagnostic, Diagnostics
from dafw.core.errors import (
    ComputationError,
    ConfigurationError,
    ContractError,
    DafwError,
    DivergenceError,
    about_member,
    is_request,
)
from dafw.core.options import build
from dafw.core.space import Array, StateSpace, Variable, sum_of_squares

SENSELESS = 1e3
"""A number has diverged if it exceeds this many times the ``plausible`` value of its variable."""


class Plugin:
    """What all kinds share: their kind, and the name under which they were registered.

    ``expected_failures`` declares, by name and with a reason, the checks of ``dafw.testing`` that a plugin is meant to
    fail; docs/conformance.md lists the checks.
    """

    kind: ClassVar[str]
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType({})
    name: str = ""

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return the options with which ``dafw check`` makes the plugin: a small and quick case."""
        return {}

    @classmethod
    def from_options(cls, **options: Any) -> Self:
        """Make the plugin from plain values, nested mappings for groups of options, as a configuration does.

        Raises OptionError if an option is unknown, of the wrong type or out of range.
        """
        return build(cls, options, f"{cls.kind} '{cls.__name__}'")

    @property
    def label(self) -> str:
        """The plugin as messages name it: ``filter 'etkf'``."""
        return f"{self.kind} '{self.name or type(self).__name__}'"

    @property
    def input_files(self) -> Sequence[Path]:
        """The files with readings, winds and the like that decide the numbers of a run; none, unless a plugin says so.

        A run's summary has a digest of each, and after a kill the run goes on only if they are the same. Relative
        paths count from the folder in which the run works. Raises a DafwError if a file that an option names is not
        there.
        """
        return ()

    def require_variable(self, space: StateSpace, name: str) -> Variable:
        """Return the state variable ``name``; raises ConfigurationError that names the plugin."""
        try:
            return space[name]
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error

    def require_places(self, space: StateSpace, name: str) -> Array:
        """Return the coordinates (M, 2) of a state variable in metres; raises ConfigurationError if it has none."""
        coordinates = self.require_variable(space, name).coordinates
        if coordinates is None or coordinates.shape[1] != 2:
            raise ConfigurationError(f"{self.label}: the variable '{name}' has no coordinates in the plane")
        return coordinates

    def checked(self, array: Any, shape: tuple[int, ...], what: str) -> Array:
        """Return ``array`` as float64 of ``shape`` and finite, or raise ContractError with the plugin's name."""
        values = np.asarray(array)
        # A sum of squares is finite only if all numbers are, and takes a third of the time of np.isfinite on each.
        if values.dtype == np.float64 and values.shape == shape and isfinite(sum_of_squares(values)):
            return values
        if values.dtype.kind not in "fiu":
            raise ContractError(f"{self.label}: {what} must be real numbers, got the type {values.dtype}")
        if values.shape != shape:
            raise ContractError(f"{self.label}: {what} must have the shape {shape}, got {values.shape}")
        values = values.astype(np.float64, copy=False)
        if not np.isfinite(values).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise ContractError(f"{self.label}: {what} holds {values[place]} at {place}")
        return values

    def checked_members(self, array: Any, shape: tuple[int, ...], what: str, space: StateSpace) -> Array:
        """Return members as ``checked`` does; raises DivergenceError if they are far beyond what is plausible."""
        values = np.asarray(array)
        agreed = values.dtype == np.float64 and values.shape == shape
        # Unless there are very large numbers, one sum of squares shows that all are finite and plausible.
        if agreed and sum_of_squares(values) <= space.plausible_squares * SENSELESS**2:
            return values
        values = self.checked(values, shape, what)
        require_sense(self, space, values)
        return values

    def checked_diagnostics(self, diagnostics: Diagnostics) -> None:
        """Raise ContractError if a diagnostic does not hold real numbers or lacks a name for an axis."""
        for name, diagnostic in diagnostics.items():
            if not isinstance(diagnostic, Diagnostic):
                raise ContractError(f"{self.label}: '{name}' must be a Diagnostic, got {type(diagnostic).__name__}")
            values = np.asarray(diagnostic.values)
            if values.dtype.kind not in "fiub" or values.ndim != len(diagnostic.dims):
                raise ContractError(
                    f"{self.label}: diagnostic '{name}' must hold numbers with one of its dims {diagnostic.dims} for "
                    f"each axis, got the type {values.dtype} and the shape {values.shape}"
                )


def described(space: StateSpace, members: Array) -> str:
    """Describe the most extreme of the numbers (N, n): variable, node, member and value."""
    member, entry = space.farthest(members)
    return f"{space.place_of(entry)} of member {member}: {members[member, entry]:.6g}"


def require_sense(plugin: Plugin, space: StateSpace, members: Array) -> None:
    """Raise DivergenceError if one of the members (N, n), which are finite, is far beyond what is plausible."""
    if space.exceeds(members, SENSELESS):
        member, entry = space.farthest(members)
        what, value = space.place_of(entry), members[member, entry]
        with about_member(member):
            raise DivergenceError(
                f"{plugin.label}: the numbers have diverged: {what}, {value:.6g}, is "
                f"{space.excess(members):.3g} times the largest value that is plausible"
            )


def label_of(plugin: Plugin) -> str:
    """Return the plugin's label, or a substitute if the author's own ``label`` fails."""
    try:
        return str(plugin.label)
    except Exception:
        return f"{plugin.kind} '{type(plugin).__name__}'"


def by_plugin(error: BaseException) -> ComputationError | None:
    """Return an error that names the plugin and the method which raised ``error``; None if no plugin did.

    Of several plugins in the call stack it is the innermost.
    """
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        plugin = frame.f_locals.get("self")
        if isinstance(plugin, Plugin):
            what = f"raised {type(error).__name__} in '{frame.f_code.co_name}'"
            return ComputationError(f"{label_of(plugin)} {what}: {error}")
    return None


@contextmanager
def plugins_named() -> Iterator[None]:
    """Turn errors other than DafwError that plugins raise in the block into errors that name the plugin."""
    try:
        yield
    except DafwError:
        raise
    except Exception as error:
        failure = by_plugin(error)
        if failure is None:
            raise
        # For example, a file that an option names does not exist.
        raise ConfigurationError(str(failure)) if is_request(error) else failure from error
