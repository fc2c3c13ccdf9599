"""The wind to the full tolerance, cheaply: from a reduced basis, with a factorisation that is not its own.

A wind in the reduced basis is where the iteration starts. Its steps are Newton's with the Jacobian of another wind,
that of the next point of a fixed lattice of directions and Reynolds numbers, and Anderson's mixing of the last few:
Walker and Ni, SIAM J. Numer. Anal. 49 (2011), doi:10.1137/10078356X. Factorisations are kept, a few of them; as they
depend on the lattice and the basis alone, what is kept changes the time and never the result. Where the iteration
stalls, Newton's method goes on from where it came to.

A start that is handed in serves only where the reduced basis has none.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from dafw.plugins.models.dispersion.basis_cache import basis_for
from dafw.plugins.models.dispersion.mesh import TaggedMesh
from dafw.plugins.models.dispersion.newton import Iterate, Newton
from dafw.plugins.models.dispersion.reduced_flow import ReducedFlow, ReducedWind
from dafw.plugins.models.dispersion.wind import WindOptions, WindSolution, WindSolver

DIRECTIONS = 90
"""At R = 1/m; weaker winds look more alike, and the lattice has sqrt(R) of that all round."""
RATIO = 1.7
WEAKEST = 0.01
"""1/m; from here up the lattice has a factor ``RATIO`` between its Reynolds numbers, below there is Stokes flow."""
STRONGEST = 0.25
"""1/m; above, the Jacobian of a wind of the lattice helps little, and Newton's method goes its own way at once."""
KEPT_MEGABYTES = 2000
"""Memory for kept factorisations; one takes 90 MB on 10,000 nodes."""
DEPTH = 5
"""Steps that are mixed."""
MAX_STEPS = 14
SLOW = 0.6
"""A step that leaves more than this fraction of the residual is one too many."""


class AcceleratedWindSolver(WindSolver):
    """Like ``WindSolver``, to the same tolerance; a start that is handed in serves where the basis does not."""

    def __init__(self, tagged_mesh: TaggedMesh, options: WindOptions):
        """Read or make the basis; raises ConfigurationError like ``wind_solver``."""
        super().__init__(tagged_mesh, options)
        self._store, self._digest, basis = basis_for(tagged_mesh, options)
        self.flow = ReducedFlow(basis)
        self._kept: OrderedDict[tuple[float, int], Newton] = OrderedDict()
        self._products = self._products_of_lifts()

    @property
    def digest(self) -> str:
        """The name of the reduced basis in use."""
        return self._digest

    def _solve(self, intensity: float, direction: float, start: np.ndarray | None) -> WindSolution:
        reynolds = self.reynolds(intensity)
        reduced = self.flow.solve(reynolds, direction)
        if not np.isfinite(reduced.error):
            return super()._solve(intensity, direction, start)
        fixed, lift = self.boundary.conditions(direction)
        begun = np.where(fixed, lift, self._mixed(reduced))
        if reynolds > STRONGEST:
            return super()._solve(intensity, direction, begun)
        scale = self._scale(reynolds, direction)
        found = self._iterate(begun, reynolds, direction, fixed, self.options.tolerance * scale)
        if not found.converged:
            return super()._solve(intensity, direction, found.unknowns)
        return WindSolution(found.unknowns, intensity, direction, 0, found.residual / scale)

    def _products_of_lifts(self) -> np.ndarray:
        """Return the scalar products (5, 5) of the residuals of winds from the west and the south, at rest inside.

        The residual of all such winds is linear and quadratic in cos d and sin d: two vectors, and three times R.
        """
        fixed, east = self.boundary.conditions(0.0)
        north = self.boundary.conditions(0.5 * np.pi)[1]
        linear = [self.problem.residual(lift, 0.0) for lift in (east, north)]
        squares = [self.problem.residual(lift, 1.0) - part for lift, part in zip((east, north), linear, strict=True)]
        both = self.problem.residual(east + north, 1.0) - sum(linear) - sum(squares)
        vectors = np.array([*linear, *squares, both])[:, ~fixed]
        return vectors @ vectors.T

    def _scale(self, reynolds: float, direction: float) -> float:
        """Return the norm of the residual of a wind that is at rest inside, to which the tolerance is relative."""
        c, s = np.cos(direction), np.sin(direction)
        parts = np.array([c, s, reynolds * c * c, reynolds * s * s, reynolds * c * s])
        return float(np.sqrt(parts @ self._products @ parts))

    def _mixed(self, wind: ReducedWind) -> np.ndarray:
        """Return the mixed unknowns (n,) of a reduced wind, its pressure zero."""
        unknowns = np.zeros(self.problem.unknowns)
        unknowns[self.problem.velocity_dofs] = self.flow.basis.velocities @ wind.coefficients
        return unknowns

    def _iterate(
        self, start: np.ndarray, reynolds: float, direction: float, fixed: np.ndarray, target: float
    ) -> Iterate:
        """Iterate from ``start`` (n,) while it pays; the residual is that of the vector handed out."""
        factorised = self._factorisation(reynolds, direction, fixed)
        x, best, least = start, start, np.inf
        last_step = last_mixed = start
        # Differences between the last few steps, and between where they led to.
        changes, both = np.zeros((2, DEPTH, start.size))
        products = np.zeros((DEPTH, DEPTH))
        for count in range(MAX_STEPS + 1):
            force = self.problem.residual(x, reynolds)
            force[fixed] = 0.0
            before, norm = least, float(np.linalg.norm(force))
            if norm < least:
                best, least = x, norm
            # The first step finds the pressure, which the reduced basis knows nothing of; then progress counts.
            if norm <= target or count == MAX_STEPS or (count > 1 and not norm <= SLOW * before):
                break
            step = -factorised.back_substitute(force)
            x = mixed = x + step
            if count > 1:
                place, used = (count - 2) % DEPTH, min(count - 1, DEPTH)
                changes[place], both[place] = step - last_step, mixed - last_mixed
                products[place, :used] = products[:used, place] = changes[:used] @ changes[place]
                scale = np.sqrt(np.diagonal(products)[:used])
                scaled = products[:used, :used] / np.outer(scale, scale)
                weights = np.linalg.lstsq(scaled, changes[:used] @ step / scale, rcond=1e-14)[0] / scale
                x = mixed - weights @ both[:used]
            last_step, last_mixed = step, mixed
        return Iterate(best, least, 0, bool(least <= target))

    def _factorisation(self, reynolds: float, direction: float, fixed: np.ndarray) -> Newton:
        """Return the factorised Jacobian of the wind on the lattice that is next to R and d."""
        if self.options.closure == "proportional":  # one R for all
            lattice_reynolds = reynolds
        elif reynolds < WEAKEST:
            lattice_reynolds = 0.0
        else:
            lattice_reynolds = WEAKEST * RATIO ** round(float(np.log(reynolds / WEAKEST) / np.log(RATIO)))
        directions = max(1, round(DIRECTIONS * np.sqrt(lattice_reynolds)))
        turn = round(direction / (2.0 * np.pi) * directions) % directions
        point = (lattice_reynolds, turn)
        if point in self._kept:
            self._kept.move_to_end(point)
            return self._kept[point]
        full = sum(kept.megabytes for kept in self._kept.values()) >= KEPT_MEGABYTES
        factorised = self._kept.popitem(last=False)[1] if full else Newton(self.problem, single=True)
        wind = self.flow.solve(lattice_reynolds, 2.0 * np.pi * turn / directions)
        factorised.factorise(self.problem.jacobian(self._mixed(wind), lattice_reynolds), fixed)
        self._kept[point] = factorised
        return factorised
