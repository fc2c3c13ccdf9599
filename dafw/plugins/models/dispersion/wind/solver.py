"""Steady wind around buildings: incompressible Navier-Stokes with an effective (eddy) viscosity.

A wind has an intensity I in m/s and a direction d, the angle TOWARDS which the air moves, counter-clockwise from east,
in radians. It is I times a unit wind, which depends only on d and on the unit Reynolds number I / viscosity. The
solver returns the unit wind. Gioia et al. 2024, equation (INS), doi:10.1109/SDF63218.2024.10773899; docs/physics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dafw.core.errors import ContractError
from dafw.plugins.models.dispersion.fem.iterate import Iterate
from dafw.plugins.models.dispersion.fem.newton import NewtonSolver
from dafw.plugins.models.dispersion.fem.sparsity import total
from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.wind.boundary import WindBoundary
from dafw.plugins.models.dispersion.wind.continuation import climb
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solution import WindError, WindSolution

# isort: split
from dolfinx import fem


class WindSolver:
    """Solves for the steady wind on one mesh. A result depends only on the arguments of ``solve``.

    On a mesh that is divided among several ranks all methods are collective calls: all ranks call them with the same
    intensity and direction, vectors hold the unknowns that the rank owns, and an error is raised on all ranks.

    Attributes:
        options: the options of the wind.
        problem: the discrete equations.
        boundary: the boundary conditions.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: WindOptions):
        """Assemble what is the same for all winds.

        Raises ConfigurationError if the boundary is ``uniform`` and buildings cut the outer boundary.
        """
        self.options = options
        self.problem = TaylorHood(tagged_mesh.mesh)
        self._newton = NewtonSolver(self.problem)
        self.boundary = WindBoundary(self.problem, tagged_mesh, options.boundary)

    @property
    def unknowns(self) -> int:
        """The length n of the vector of a unit wind."""
        return self.problem.unknowns

    @property
    def digest(self) -> str:
        """The digest of the reduced basis in use; empty if there is none."""
        return ""

    def reynolds(self, intensity: float, viscosity: float | None = None) -> float:
        """Return the unit Reynolds number intensity / viscosity in 1/m.

        With the proportional closure it is the same number for all intensities, zero included.

        Args:
            intensity: in m/s.
            viscosity: in m^2/s; None: that of the options.
        """
        reference = intensity if self.options.closure == "constant" else self.options.reference_intensity
        return reference / (self.options.viscosity if viscosity is None else viscosity)

    def solve(
        self, intensity: float, direction: float, start: np.ndarray | None = None, viscosity: float | None = None
    ) -> WindSolution:
        """Return the wind of an intensity and a direction.

        If Newton's method fails from ``start``, the solution is followed from Stokes flow.

        Args:
            intensity: in m/s, at least 0.
            direction: towards which the air moves, in radians.
            start: (n,) a unit wind of any direction and intensity to start from; None starts from Stokes flow.
            viscosity: in m^2/s, instead of that of the options.

        Raises WindError if the tolerance is not reached, and ContractError if an argument is not finite or has another
        shape.
        """
        start = self._checked(intensity, direction, start, viscosity)
        reynolds = self.reynolds(float(intensity), viscosity)
        # An overflow makes the iteration fail to converge, which is reported as such.
        with np.errstate(over="ignore", invalid="ignore"):
            return self._solve(float(intensity), float(direction), reynolds, start)

    def solve_ahead(self, winds: Sequence[tuple[float, float]], threads: int) -> None:
        """Solve winds that ``solve`` will be asked for, several at a time where a solver can. No bit depends on it.

        Args:
            winds: unit Reynolds number in 1/m and direction in radians of each.
            threads: how many at a time.
        """

    def _solve(self, intensity: float, direction: float, reynolds: float, start: np.ndarray | None) -> WindSolution:
        fixed, lift = self.boundary.conditions(direction)
        scale = self._norm(lift, reynolds, fixed)
        target = self.options.tolerance * scale

        def iterate(start: np.ndarray, reynolds: float) -> Iterate:
            keep = self.options.keep_factorisation
            return self._newton.solve(start, reynolds, fixed, target, self.options.max_iterations, keep=keep)

        found, iterations = None, 0
        if start is not None:
            found = iterate(np.where(fixed, lift, start), reynolds)
            iterations = found.factorisations
        if found is None or not found.converged:
            found, more = climb(iterate, lift, reynolds, self.options.max_steps)
            iterations += more
        # The residual of the vector that is returned is computed afresh, whatever the iteration said of it.
        residual = self._norm(found.unknowns, reynolds, fixed) / scale
        if not residual <= self.options.tolerance:
            raise WindError(
                f"wind: no solution for intensity {intensity:.6g} m/s, direction {direction:.6g} rad, intensity / "
                f"viscosity {reynolds:.6g} 1/m: relative residual {residual:.3g} after {iterations} factorisations, "
                f"expected at most {self.options.tolerance:.3g}"
            )
        return WindSolution(found.unknowns, intensity, direction, reynolds, iterations, residual)

    def derivatives(self, wind: WindSolution) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (2 m,) of the velocity of a unit wind with respect to R and to the direction.

        ``wind`` must be the last solution, because the last factorisation is used. The derivatives are exact up to
        Newton's last step if that step made its own factorisation. With ``keep_factorisation`` the factorisation may
        be some steps older, and the derivatives are off by some per cent.
        """
        problem, unit = self.problem, wind.unit
        fixed, _ = self.boundary.conditions(wind.direction)
        _, turned = self.boundary.conditions(wind.direction + 0.5 * np.pi)
        reynolds = wind.reynolds
        ahead, behind = (problem.residual(unit + sign * turned, reynolds) for sign in (1.0, -1.0))
        by_reynolds = problem.residual(unit, 1.0) - problem.residual(unit, 0.0)
        by_direction = 0.5 * (ahead - behind)  # exact, because the residual is quadratic
        velocities = []
        for force, fixed_part in ((by_reynolds, np.zeros(self.problem.unknowns)), (by_direction, turned)):
            force[fixed] = 0.0
            velocities.append(problem.velocity(fixed_part - self._newton.factorisation.solve(force)))
        return velocities[0], velocities[1]

    def _norm(self, unknowns: np.ndarray, reynolds: float, fixed: np.ndarray) -> float:
        return self.problem.norm(self.problem.residual(unknowns, reynolds)[~fixed])

    def _checked(
        self, intensity: float, direction: float, start: np.ndarray | None, viscosity: float | None
    ) -> np.ndarray | None:
        if viscosity is not None and not 0.0 < viscosity < np.inf:
            raise ContractError(f"wind: expected a finite viscosity above 0 m^2/s, got {viscosity}")
        if not (np.isfinite(intensity) and intensity >= 0.0 and np.isfinite(direction)):
            raise ContractError(
                f"wind: expected a finite intensity of at least 0 m/s and a finite direction, got {intensity} m/s and "
                f"{direction} rad"
            )
        if start is None:
            return None
        start = np.asarray(start, dtype=np.float64)
        if total(self.problem.sparsity.comm, start.shape != (self.unknowns,) or not np.isfinite(start).all()):
            raise ContractError(
                f"wind: expected a start of {self.unknowns} finite numbers, got shape {start.shape}, "
                f"{np.count_nonzero(~np.isfinite(start))} of them not finite"
            )
        return start

    def velocity(self, wind: WindSolution | np.ndarray, intensity: float | None = None) -> Any:
        """Return the wind in m/s as a new DOLFINx function in the P2 vector space.

        Args:
            wind: a solution, or a unit wind (n,).
            intensity: in m/s; required with a unit wind.
        """
        if isinstance(wind, WindSolution):
            intensity = wind.intensity if intensity is None else intensity
            wind = wind.unit
        if intensity is None:
            raise ContractError("wind: expected the intensity that goes with a unit wind, got none")
        function = fem.Function(self.problem.velocity_space)
        velocity = self.problem.velocity(wind)
        function.x.array[: velocity.size] = intensity * velocity
        function.x.scatter_forward()
        return function
