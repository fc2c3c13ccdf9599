"""Policy: where the instruments go next."""

from __future__ import annotations

from itertools import pairwise, starmap
from math import dist
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dafw.core.ensemble import Ensemble, Memory, Route, Vehicle
from dafw.core.errors import ContractError
from dafw.core.plugin import Plugin
from dafw.core.space import Array, StateSpace

if TYPE_CHECKING:
    from dafw.core.window import Outlook


class Policy(Plugin):
    """Where the instruments go next, knowing only the belief and the vehicle.

    A policy that looks ahead (``looks_ahead = True``) defines ``plan`` instead of ``decide``: its ``Outlook`` runs the
    belief on, as the model expects it to evolve. ``uses_coarser``: it needs a cheaper version of the model
    (``Model.coarser``) for that (``Outlook.on_coarser``).

    >>> class East(Policy):
    ...     def decide(self, belief, vehicle, rng):
    ...         return Route(tuple(np.array([p, p + [vehicle.reach, 0.0]]) for p in vehicle.positions))
    >>> vehicle = Vehicle(np.array([[0.0, 0.0]]), speed=10.0)
    >>> East().route(None, vehicle, None, None).ends
    array([[10.,  0.]])
    """

    kind = "policy"
    looks_ahead: ClassVar[bool] = False
    uses_coarser: bool = False

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def decide(self, belief: Ensemble, vehicle: Vehicle, rng: np.random.Generator) -> Route:
        """Return the route until the next decision."""
        raise NotImplementedError(f"{self.label} must define decide(belief, vehicle, rng)")

    def plan(self, outlook: Outlook, rng: np.random.Generator) -> Route:
        """Return the route of a policy that looks ahead: one that says ``looks_ahead = True``."""
        raise NotImplementedError(f"{self.label} looks ahead and must define plan(outlook, rng)")

    def suit(self, space: StateSpace) -> None:
        """Raise ConfigurationError if the options do not fit a state space."""

    def suit_vehicles(self, vehicle: Vehicle) -> None:
        """Raise ConfigurationError if the options do not fit the vehicles at their start, or their airspace."""

    def initial_memory(self, vehicle: Vehicle) -> Memory | None:
        """Return the memory that the first decision is given."""
        return None

    def decide_with_memory(
        self, belief: Ensemble, vehicle: Vehicle, memory: Memory | None, rng: np.random.Generator
    ) -> Route:
        """Return the route of a policy that remembers."""
        return self.decide(belief, vehicle, rng)

    def route(
        self,
        belief: Ensemble,
        vehicle: Vehicle,
        memory: Memory | None,
        rng: np.random.Generator,
        outlook: Outlook | None = None,
    ) -> Route:
        """Ask for a route and check it: it begins at the vehicles, and no vehicle flies farther than it can.

        Raises ContractError if it does not, or if a policy that looks ahead is given no outlook.
        """
        if not self.looks_ahead:
            route = self.decide_with_memory(belief, vehicle, memory, rng)
        elif outlook is None:
            raise ContractError(f"{self.label} looks ahead: expected an outlook, got none")
        else:
            route = self.plan(outlook, rng)
        if not isinstance(route, Route):
            raise ContractError(f"{self.label}: expected a Route, got {type(route).__name__}")
        if len(route.paths) != len(vehicle.positions):
            raise ContractError(f"{self.label}: {len(vehicle.positions)} vehicles, but {len(route.paths)} paths")
        for number, (path, position) in enumerate(zip(route.paths, vehicle.positions, strict=True)):
            self._require_flyable(number, path, position, vehicle)
        self.checked_diagnostics(route.diagnostics)
        if route.dt == vehicle.dt:
            return route
        return Route(route.paths, route.memory, route.diagnostics, route.notes, vehicle.dt)

    def _require_flyable(self, number: int, path: Array, position: Array, vehicle: Vehicle) -> None:
        """Raise ContractError if vehicle ``number`` at ``position`` (2,) cannot fly the path (k, 2)."""
        self.checked(path, path.shape, f"the path of vehicle {number}")
        if len(path) == 0 or path[0].tolist() != position.tolist():
            raise ContractError(f"{self.label}: the path of vehicle {number} does not begin at {position.tolist()}")
        flown = sum(starmap(dist, pairwise(path.tolist())))
        if flown > vehicle.reach * (1.0 + 1e-9):
            raise ContractError(
                f"{self.label}: vehicle {number} would fly {flown:.6g} m, it can fly {vehicle.reach:.6g} m"
            )
        for leg in pairwise(path):
            if vehicle.airspace is not None and not vehicle.airspace.is_free(*leg):
                raise ContractError(
                    f"{self.label}: vehicle {number} would fly out of the domain or into a building on its way "
                    f"from {leg[0].tolist()} to {leg[1].tolist()}"
                )
