"""The wind in the reduced basis, or from the full equations if its estimated error is too large.

A wind travels with a member as a short vector: n coefficients and a mark. If the mark says that the basis is not
accurate enough, the wind is that of the accelerated solver, which gives the same bits for the same Reynolds number and
direction in any process. Such full winds are kept in the process to save time. With ``basis.enrich`` they are also
left on disk for the next basis.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from dafw.core.errors import ContractError
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.reduced_wind.accelerated import AcceleratedWindSolver
from dafw.plugins.models.dispersion.reduced_wind.flow import ReducedWind
from dafw.plugins.models.dispersion.reduced_wind.store import StoredBasis
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solution import WindSolution

# isort: split
from dolfinx import fem

KEPT = 32
"""Full winds that are kept in the process."""


class ReducedWindSolver(AcceleratedWindSolver):
    """Solves in the reduced basis. A result depends only on Reynolds number, direction and basis; a start is ignored.

    The ``unit`` (n + 1,) of a solution holds the n coefficients, cos d and sin d first, and then the mark: 1 if the
    basis is accurate enough, otherwise minus the unit Reynolds number, which with d says what the wind is. With mark 1
    the ``residual`` of a solution is its estimated relative L2 error.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: WindOptions, stored: StoredBasis):
        """Prepare the solver; the arguments are those of ``AcceleratedWindSolver``."""
        super().__init__(tagged_mesh, options, stored)
        self._full: OrderedDict[bytes, WindSolution] = OrderedDict()
        self._ahead: dict[tuple[float, float], ReducedWind] = {}

    @property
    def unknowns(self) -> int:
        """The length n + 1 of the vector that travels with a member."""
        return self.flow.basis.velocities.shape[1] + 1

    def solve_ahead(self, winds: Sequence[tuple[float, float]], threads: int) -> None:
        """Solve winds in the reduced basis, several at a time; ``solve`` finds those of the last call."""
        self._ahead = {}
        if min(threads, len(winds)) > 1:
            with ThreadPoolExecutor(min(threads, len(winds))) as pool:
                self._ahead = dict(zip(winds, pool.map(self._reduced, winds), strict=True))

    def _reduced(self, wind: tuple[float, float]) -> ReducedWind:
        reynolds, direction = wind
        with np.errstate(over="ignore", invalid="ignore"):  # each thread has its own setting
            return self.flow.solve(reynolds, direction, self.options.basis.tolerance)

    def _solve(self, intensity: float, direction: float, reynolds: float, start: np.ndarray | None) -> WindSolution:
        reduced = self._ahead.get((reynolds, direction)) or self._reduced((reynolds, direction))
        trusted = reduced.error <= self.options.basis.tolerance
        coefficients = reduced.coefficients
        if not trusted:  # those of a failed solve may not be finite; the first two still say the direction
            coefficients = np.zeros(self.unknowns - 1)
            coefficients[:2] = np.cos(direction), np.sin(direction)
        unit = np.append(coefficients, 1.0 if trusted else -reynolds)
        if trusted:
            return WindSolution(unit, intensity, direction, reynolds, 0, reduced.error)
        found = self._full_wind(unit, intensity)
        return WindSolution(unit, intensity, direction, reynolds, found.iterations, found.residual)

    def _full_wind(self, unit: np.ndarray, intensity: float) -> WindSolution:
        """Return the wind from the full equations for a unit wind (n + 1,) that the basis does not have.

        The intensity in m/s is named in errors.
        """
        name = unit[[0, 1, -1]].tobytes()
        if name not in self._full:
            reynolds, direction = -float(unit[-1]), float(np.arctan2(unit[1], unit[0]))
            found = super()._solve(intensity, direction, reynolds, None)
            if self.options.basis.enrich:
                self._stored.store.submit(reynolds, direction, self.problem.velocity(found.unit))
            self._full[name] = found
            if len(self._full) > KEPT:
                self._full.popitem(last=False)
        return self._full[name]

    def trusts(self, unit: np.ndarray) -> bool:
        """Say whether a unit wind (n + 1,) is one of the reduced basis: whether its mark is 1."""
        return bool(unit[-1] == 1.0)

    def velocity(self, wind: WindSolution | np.ndarray, intensity: float | None = None) -> Any:
        """Return the wind in m/s as a new DOLFINx function in the P2 vector space.

        It is solved again from the full equations if its mark is not 1 and it is no longer kept.

        Args:
            wind: a solution, or a unit wind (n + 1,).
            intensity: in m/s; required with a unit wind.
        """
        if isinstance(wind, WindSolution):
            intensity = wind.intensity if intensity is None else intensity
            wind = wind.unit
        if intensity is None:
            raise ContractError("wind: expected the intensity that goes with a unit wind, got none")
        if not self.trusts(wind):
            return super().velocity(self._full_wind(wind, intensity).unit, intensity)
        function = fem.Function(self.problem.velocity_space)
        function.x.array[:] = self.flow.basis.velocities @ (intensity * wind[:-1])
        return function
