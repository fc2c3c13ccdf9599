"""Steady wind around buildings: incompressible Navier-Stokes with an effective (eddy) viscosity.

The wind of intensity I (m/s) and direction d (the angle TOWARDS which the air moves, counter-clockwise from east, in
radians) is I times a unit wind, which depends on d and on I / viscosity alone; the unit wind is what is solved for and
handed out. Gioia et al. 2024, equation (INS), doi:10.1109/SDF63218.2024.10773899; docs/physics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import ConfigurationError, ContractError, SolverError
from dafw.core.options import option
from dafw.plugins.models.dispersion.mesh import TaggedMesh

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.newton import Iterate


class WindError(SolverError):
    """No wind within the tolerance was found; there is nothing to use."""


@dataclass
class BasisOptions:
    """Options of the reduced basis: which winds are solved for it, and how far it is trusted."""

    directions: int = option(32, "directions all round of the winds it is made from", minimum=4)
    levels: int = option(5, "intensities in each direction, denser towards calm", minimum=1)
    max_intensity: float = option(12.0, "m/s; the strongest wind it is made from", above=0.0)
    modes: int = option(160, "modes kept; an enriched basis has more", minimum=1)
    tolerance: float = option(
        0.01,
        "estimated relative L2 error of the velocity above which the full equations are solved",
        above=0.0,
        maximum=1.0,
    )
    digest: str = option("", "the basis to use, as an earlier run recorded it; empty: the newest")


@dataclass
class WindOptions:
    """Options of the steady wind."""

    viscosity: float = option(25.0, "effective (eddy) viscosity in m^2/s", above=0.0)
    closure: str = option(
        "constant",
        "constant, or proportional: viscosity * intensity / reference_intensity",
        choices=("constant", "proportional"),
    )
    reference_intensity: float = option(
        5.0, "wind in m/s at which the proportional closure has the given viscosity", above=0.0
    )
    boundary: str = option(
        "uniform",
        "uniform: the wind prescribed all round; outflow: do-nothing where it leaves",
        choices=("uniform", "outflow"),
    )
    tolerance: float = option(
        1e-8, "residual norm accepted, relative to that of the boundary wind alone", above=0.0, maximum=1e-2
    )
    max_iterations: int = option(12, "factorisations in one Newton iteration", minimum=1)
    max_steps: int = option(40, "Newton iterations in one continuation from Stokes flow", minimum=1)
    solver: str = option(
        "newton",
        "newton; accelerated: to the same tolerance from a reduced basis; reduced: in the basis, to its tolerance",
        choices=("newton", "accelerated", "reduced"),
    )
    keep_factorisation: bool = option(True, "newton: use a factorisation again while it serves well")
    basis: BasisOptions = option(BasisOptions, "the reduced basis of the accelerated and the reduced solver")


def require_uniform(options: WindOptions) -> None:
    """Raise ConfigurationError where the boundary does not suit the solver."""
    if options.solver != "newton" and options.boundary != "uniform":
        raise ConfigurationError(
            f"wind: solver '{options.solver}' expects boundary 'uniform', got '{options.boundary}': where that "
            "prescribes the wind changes with the direction, and one basis does not fit; choose solver 'newton'"
        )


@dataclass(frozen=True)
class WindSolution:
    """A converged wind.

    ``unit`` (n,) holds the mixed unknowns of the unit wind and travels as plain numbers; ``intensity`` in m/s,
    ``direction`` in radians; ``iterations`` counts factorisations, ``residual`` is relative like the tolerance.
    """

    unit: np.ndarray
    intensity: float
    direction: float
    iterations: int
    residual: float


class WindSolver:
    """Solves for the steady wind on one mesh. Results depend on the arguments of ``solve`` alone.

    On a mesh that is partitioned among several ranks all of them call together, with the same intensity and direction;
    vectors hold the unknowns that the rank owns. An error is raised on all of them.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: WindOptions):
        """Assemble what no wind changes.

        Raises ConfigurationError where buildings cut the outer boundary of a wind that is ``uniform`` all round.
        """
        from dafw.plugins.models.dispersion.newton import Newton
        from dafw.plugins.models.dispersion.taylor_hood import TaylorHood
        from dafw.plugins.models.dispersion.wind_boundary import WindBoundary

        self.options = options
        self.problem = TaylorHood(tagged_mesh.mesh)
        self._newton = Newton(self.problem)
        self.boundary = WindBoundary(self.problem, tagged_mesh, options.boundary)

    @property
    def unknowns(self) -> int:
        """The length n of the vector of a unit wind."""
        return self.problem.unknowns

    @property
    def digest(self) -> str:
        """The name of the reduced basis in use, empty where there is none."""
        return ""

    def viscosity(self, intensity: float) -> float:
        """Return the effective viscosity in m^2/s at an intensity in m/s."""
        if self.options.closure == "constant":
            return self.options.viscosity
        return self.options.viscosity * intensity / self.options.reference_intensity

    def solve(self, intensity: float, direction: float, start: np.ndarray | None = None) -> WindSolution:
        """Return the wind of an intensity (m/s) and a direction (radians).

        ``start`` (n,) is the unit wind to start from, of any direction and intensity; None starts from Stokes flow.
        Where Newton's method fails from ``start``, the solution is followed from Stokes flow. Raises WindError where
        the tolerance is not reached and ContractError where an argument is not a finite number or of another size.
        """
        start = self._checked(intensity, direction, start)
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows does not converge, and is refused as such
            return self._solve(float(intensity), float(direction), start)

    def _solve(self, intensity: float, direction: float, start: np.ndarray | None) -> WindSolution:
        from dafw.plugins.models.dispersion.continuation import climb

        reynolds = self.reynolds(intensity)
        fixed, lift = self.boundary.conditions(direction)
        scale = self._norm(lift, reynolds, fixed)
        target = self.options.tolerance * scale

        def newton(start: np.ndarray, reynolds: float) -> Iterate:
            keep = self.options.keep_factorisation
            return self._newton.solve(start, reynolds, fixed, target, self.options.max_iterations, keep=keep)

        found, iterations = None, 0
        if start is not None:
            found = newton(np.where(fixed, lift, start), reynolds)
            iterations = found.factorisations
        if found is None or not found.converged:
            found, more = climb(newton, lift, reynolds, self.options.max_steps)
            iterations += more
        # Nothing leaves unless the vector itself, looked at afresh, satisfies the equations.
        residual = self._norm(found.unknowns, reynolds, fixed) / scale
        if not residual <= self.options.tolerance:
            raise WindError(
                f"wind: no solution for intensity {intensity:.6g} m/s, direction {direction:.6g} rad, viscosity "
                f"{self.viscosity(intensity):.6g} m^2/s: relative residual {residual:.3g} after {iterations} "
                f"factorisations, expected at most {self.options.tolerance:.3g}"
            )
        return WindSolution(found.unknowns, intensity, direction, iterations, residual)

    def reynolds(self, intensity: float) -> float:
        """Return the unit Reynolds number intensity / viscosity (1/m), which a calm has, too, in both closures."""
        reference = intensity if self.options.closure == "constant" else self.options.reference_intensity
        return reference / self.options.viscosity

    def derivatives(self, wind: WindSolution) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the velocity of a unit wind, (2 m,) each, to R and to the direction.

        Call it with the last solution: its last factorisation serves, so that they are exact up to Newton's last step;
        a kept factorisation is some steps older, and they are off by some per cent.
        """
        problem, unit = self.problem, wind.unit
        fixed, _ = self.boundary.conditions(wind.direction)
        _, turned = self.boundary.conditions(wind.direction + 0.5 * np.pi)
        reynolds = self.reynolds(wind.intensity)
        ahead, behind = (problem.residual(unit + sign * turned, reynolds) for sign in (1.0, -1.0))
        by_reynolds = problem.residual(unit, 1.0) - problem.residual(unit, 0.0)
        by_direction = 0.5 * (ahead - behind)  # exact for a quadratic
        velocities = []
        for force, fixed_part in ((by_reynolds, np.zeros(self.problem.unknowns)), (by_direction, turned)):
            force[fixed] = 0.0
            velocities.append(problem.velocity(fixed_part - self._newton.back_substitute(force)))
        return velocities[0], velocities[1]

    def _norm(self, unknowns: np.ndarray, reynolds: float, fixed: np.ndarray) -> float:
        return self.problem.norm(self.problem.residual(unknowns, reynolds)[~fixed])

    def _checked(self, intensity: float, direction: float, start: np.ndarray | None) -> np.ndarray | None:
        if not (np.isfinite(intensity) and intensity >= 0.0 and np.isfinite(direction)):
            raise ContractError(
                f"wind: expected a finite intensity of at least 0 m/s and a finite direction, got {intensity} m/s and "
                f"{direction} rad"
            )
        if start is None:
            return None
        from dafw.plugins.models.dispersion.sparsity import total

        start = np.asarray(start, dtype=np.float64)
        if total(self.problem.sparsity.comm, start.shape != (self.unknowns,) or not np.isfinite(start).all()):
            raise ContractError(
                f"wind: expected a start of {self.unknowns} finite numbers, got shape {start.shape}, "
                f"{np.count_nonzero(~np.isfinite(start))} of them not finite"
            )
        return start

    def velocity(self, wind: WindSolution | np.ndarray, intensity: float | None = None) -> Any:
        """Return the wind in m/s as a new DOLFINx function in the P2 vector space.

        ``wind`` is a solution, or a unit wind (n,) with its ``intensity``.
        """
        from dolfinx import fem

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
