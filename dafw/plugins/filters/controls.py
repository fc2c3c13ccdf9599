"""Control variables: the numbers at the start that a filter with re-runs moves; the rest of the start follows.

In a dispersion model they are the wind, the diffusion, the place of the release, ...; the cloud at the start follows
from them (``Model.settled``). In a model without single numbers, such as Lorenz-96, they are the whole state.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.rerun import Rerun
from dafw.core.space import ANGLE, NONNEGATIVE, POSITIVE, Array, IntArray, StateSpace

SMALLEST = 1e-12
"""Numbers that must not be negative are at least this much in coordinates, where their logarithm is taken."""
WRAPS = (0.0, 2.0 * np.pi, -2.0 * np.pi)
"""Turns after which an angle is the same: a density that is drawn from without wrapping is summed over them."""


class Controls:
    """The control variables of a state space.

    Attributes:
        names: of the variables.
        entries: (k,) their entries in the state.
        has_fields: whether one of them has more than one number.

    Raises ConfigurationError for names that are not variables of the space.
    """

    def __init__(self, space: StateSpace, names: Sequence[str] = ()) -> None:
        """Take the variables named; without names those of size 1, and if there are none, all variables."""
        single = [variable.name for variable in space.variables if variable.size == 1]
        self.space = space
        self.names = tuple(names) or tuple(single) or tuple(variable.name for variable in space.variables)
        if len(set(self.names)) < len(self.names):
            raise ConfigurationError(f"control variables: a name is listed twice in {list(self.names)}")
        self.has_fields = any(space[name].size > 1 for name in self.names)
        parts = [space.slice(name) for name in self.names]
        self.entries: IntArray = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        kinds = np.concatenate([np.full(space[name].size, space[name].kind.value) for name in self.names])
        # Where a field is zero, it may well stay zero. A single number, such as a wind speed, must not be caught there.
        sizes = np.concatenate([np.full(space[name].size, space[name].size) for name in self.names])
        self._logarithmic = (kinds == POSITIVE.value) | ((kinds == NONNEGATIVE.value) & (sizes == 1))
        self._angles = np.flatnonzero(kinds == ANGLE.value)

    def __len__(self) -> int:
        return len(self.entries)

    def left_open(self, first_guess: Array) -> Controls:
        """Return those of the controls in which the members (N, n) of the first guess differ: the others are known."""
        differs = [name for name in self.names if np.ptp(first_guess[:, self.space.slice(name)], axis=0).any()]
        return self if len(differs) in (0, len(self.names)) else Controls(self.space, differs)

    def missing(self, rerun: Rerun, first_guess: Array) -> list[str]:
        """Return the single numbers in which members (N, n) of the first guess still differ if the controls agree."""
        agreeing = self.at(rerun, first_guess, np.repeat(self.coordinates(first_guess[:1]), len(first_guess), axis=0))
        single = [variable.name for variable in self.space.variables if variable.size == 1]
        return [name for name in single if np.ptp(agreeing[:, self.space.slice(name)]) > 0.0]

    def moved(self, rerun: Rerun, start: Array, steps: Array) -> Array:
        """Return members (N, n) at the start whose controls have moved by ``steps`` (N, k), the fields recomputed.

        The steps are those of ``StateSpace.retract``: positive numbers move in their logarithms.
        """
        moves = np.zeros_like(start)
        moves[:, self.entries] = steps
        return rerun.settled_members(self.space.retract(start, moves))

    def coordinates(self, members: Array) -> Array:
        """Return the controls (N, k) in coordinates: logarithms of positive and of single nonnegative numbers."""
        values: Array = members[:, self.entries].copy()
        values[:, self._logarithmic] = np.log(np.maximum(values[:, self._logarithmic], SMALLEST))
        return values

    def log_volume(self, coordinates: Array) -> Array:
        """Return log |dx / dz| (N,): added to a log density of the numbers x, it makes one of the coordinates z."""
        return np.asarray(coordinates[:, self._logarithmic].sum(axis=1))

    def at(self, rerun: Rerun, start: Array, coordinates: Array, *, settle: bool = True) -> Array:
        """Return members (N, n) at the start with the controls at ``coordinates`` (N, k), the fields recomputed.

        ``settle=False``: the other numbers stay as they are, because the members are not at the release, or because a
        field is itself a control.
        """
        values = coordinates.copy()
        values[:, self._logarithmic] = np.exp(values[:, self._logarithmic])
        members = start.copy()
        members[:, self.entries] = values
        members = self.space.retract(members, np.zeros(self.space.size))
        return rerun.settled_members(members) if settle else members

    def offset(self, coordinates: Array, centre: Array) -> Array:
        """Return ``coordinates`` less ``centre``, both (..., k); angles wrapped to [-pi, pi)."""
        offset: Array = np.subtract(coordinates, centre)
        offset[..., self._angles] = np.mod(offset[..., self._angles] + np.pi, 2.0 * np.pi) - np.pi
        return offset

    def turns(self) -> Array:
        """Return the steps (3^a, k) by whole turns of each of the a angles; the first is no step at all."""
        turns = np.zeros((len(WRAPS) ** len(self._angles), len(self)))
        turns[:, self._angles] = list(product(WRAPS, repeat=len(self._angles)))
        return turns
