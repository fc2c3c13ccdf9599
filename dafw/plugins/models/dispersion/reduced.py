"""The wind in the reduced basis, with the full equations where its estimated error is too large.

What travels with a member is small: n coefficients and a mark. Where the mark says that the basis does not do, the full
wind is that of the accelerated solver, which the same intensity and direction give again anywhere; it is kept in the
process only to save time, and left on disk for the next basis.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np

from dafw.core.errors import ContractError
from dafw.plugins.models.dispersion.accelerated import AcceleratedWindSolver
from dafw.plugins.models.dispersion.mesh import TaggedMesh
from dafw.plugins.models.dispersion.wind import WindOptions, WindSolution

KEPT = 32
"""Full winds kept in the process."""


class ReducedWindSolver(AcceleratedWindSolver):
    """Solves in the reduced basis; ``unit`` (n + 1,) holds the coefficients, cos d and sin d first, and the mark.

    The mark is 1 where the basis does and 0 where it does not. The ``residual`` of a solution is then its estimated
    relative L2 error. Results depend on intensity, direction and the basis alone: a ``start`` is not looked at.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: WindOptions):
        """Read or make the basis; raises ConfigurationError like ``wind_solver``."""
        super().__init__(tagged_mesh, options)
        self._full: OrderedDict[bytes, WindSolution] = OrderedDict()

    @property
    def unknowns(self) -> int:
        """The length n + 1 of what travels with a member."""
        return self.flow.basis.velocities.shape[1] + 1

    def _solve(self, intensity: float, direction: float, start: np.ndarray | None) -> WindSolution:
        reynolds = self.reynolds(intensity)
        reduced = self.flow.solve(reynolds, direction, self.options.basis.tolerance)
        trusted = reduced.error <= self.options.basis.tolerance
        coefficients = reduced.coefficients
        if not trusted:  # what travels must be finite, and still say the direction
            coefficients = np.zeros(self.unknowns - 1)
            coefficients[:2] = np.cos(direction), np.sin(direction)
        unit = np.append(coefficients, float(trusted))
        if trusted:
            return WindSolution(unit, intensity, direction, 0, reduced.error)
        found = self._full_wind(unit, intensity)
        return WindSolution(unit, intensity, direction, found.iterations, found.residual)

    def _full_wind(self, unit: np.ndarray, intensity: float) -> WindSolution:
        """Return the wind from the full equations, whose direction the coefficients tell."""
        name = np.append(unit[:2], intensity).tobytes()
        if name not in self._full:
            direction = float(np.arctan2(unit[1], unit[0]))
            found = super()._solve(intensity, direction, None)
            self._store.submit(self.reynolds(intensity), direction, self.problem.velocity(found.unit))
            self._full[name] = found
            if len(self._full) > KEPT:
                self._full.popitem(last=False)
        return self._full[name]

    def trusts(self, unit: np.ndarray) -> bool:
        """Say whether a unit wind (n + 1,) is one of the reduced basis."""
        return bool(unit[-1] == 1.0)

    def velocity(self, wind: WindSolution | np.ndarray, intensity: float | None = None) -> Any:
        """Return the wind in m/s as a new DOLFINx function in the P2 vector space; solves where the basis does not."""
        from dolfinx import fem

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
