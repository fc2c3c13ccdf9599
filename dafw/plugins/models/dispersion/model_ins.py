"""Model ``ad_ins``: a gas carried by a steady wind that flows around the buildings.

The wind of a member is solved again only if its parameters differ from those of its last solve (marked INS) by more
than the thresholds of Algorithm 1, Gioia et al. (2024), doi:10.1109/SDF63218.2024.10773899::

    |I - I_INS| >= tr_I |I|   or   |d - d_INS| >= tr_d |d|         differences of directions wrapped to [-pi, pi)

A viscosity that is estimated has the threshold of the speed. Otherwise the wind of the last solve carries the gas. A
solve starts from the member's last wind. That wind is in the memory of the run, so results do not depend on what else
ran in the process. A wind that changes in time (``wind_change``) is solved in every step.

The viscosity can be estimated, too. A wind depends on its direction and on the ratio of speed and viscosity alone, so
the reduced basis serves as it is.

Like model.py this module must be light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.ensemble import Diagnostic, Diagnostics, Memory
from dafw.core.errors import ConfigurationError, SolverError, about_member
from dafw.core.options import option
from dafw.core.space import POSITIVE, Array
from dafw.core.workers import spare_cores
from dafw.plugins.models.dispersion.mesh.partition import Partition, Undivided
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.unknowns import Possible, about
from dafw.plugins.models.dispersion.wind.options import (
    WindOptions,
    require_constant,
    require_one_process,
    require_uniform,
)

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.reduced_wind.advection import ReducedAdvection
    from dafw.plugins.models.dispersion.site.site import Site
    from dafw.plugins.models.dispersion.transport.transport import System
    from dafw.plugins.models.dispersion.wind.solver import WindSolver


@dataclass
class AdvectionDiffusionINS(AdvectionDiffusion):
    """Gas dispersion in a steady Navier-Stokes wind around buildings."""

    wind: WindOptions = option(WindOptions, "the wind and its solver")
    speed_threshold: float = option(
        0.10,
        "tr_I: a wind is solved anew if its speed, or an estimated viscosity, changes by this fraction or more",
        minimum=0,
    )
    direction_threshold: float = option(0.05, "tr_d: the same for its direction in radians", minimum=0)
    on_unsolved: str = option(
        "stop", "if a wind cannot be solved: stop, or keep the member's last solved wind", choices=("stop", "keep")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_uniform(self.wind)
        if "viscosity" in self.estimate and not self.certain:
            require_constant(self.wind)

    def own_unknowns(self) -> Mapping[str, Possible]:
        """Return the viscosity, which changes how the wind flows around buildings."""
        return {"viscosity": Possible(POSITIVE, "m2 s-1", self.wind.viscosity, lambda nu: about("lognormal", nu, 0.5))}

    @property
    def _largest_reynolds(self) -> float:
        """The largest unit Reynolds number, 1/m, that the first guess has if the viscosity is estimated.

        It is that of the strongest wind of the reduced basis: beyond it every wind would be solved in full, and some
        have no steady solution.
        """
        if self.wind.solver == "newton" or "viscosity" not in self.estimate or self.certain:
            return np.inf
        return self.wind.basis.max_intensity / self.wind.viscosity

    def possible(self, members: Array) -> np.ndarray:
        """Return for which members (N, n) the model has a wind (N,), bool."""
        if not np.isfinite(self._largest_reynolds):
            return super().possible(members)
        state = self.space.unpack(members)
        return np.asarray(state["wind_speed"][:, 0] <= self._largest_reynolds * state["viscosity"][:, 0])

    @cached_property
    def ground(self) -> Site:
        """The site with its buildings: the wind is zero at their walls."""
        return self.place

    @cached_property
    def solver(self) -> WindSolver:
        """The wind solver, one for all models of a run with the same mesh and the same wind options."""
        from dafw.plugins.models.dispersion.wind_solvers import wind_solver

        name = ("wind solver", self.solver_mesh, repr(self.wind))
        return self._shared.once(name, lambda: wind_solver(self.solver_mesh, self.wind))

    def distribute(self, communicator: Any) -> None:
        """Divide the mesh among the ranks; raises ConfigurationError if the wind solver works in one process."""
        try:
            require_one_process(self.wind)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error
        super().distribute(communicator)

    def require_available(self) -> None:
        """Raise ConfigurationError if the options name a reduced basis that is missing or damaged."""
        super().require_available()
        if self.wind.solver == "newton":
            return
        from dafw.plugins.models.dispersion.reduced_wind.choice import require_basis

        name = ("basis is there", self.tagged_mesh, repr(self.wind))
        try:
            self._shared.once(name, lambda: require_basis(self.tagged_mesh, self.wind))
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error

    @cached_property
    def _unit(self) -> Partition | Undivided:
        """The step between the unit winds in the memory and those of the solver on this rank."""
        from dafw.plugins.models.dispersion.fem.mixed_space import MixedSpace
        from dafw.plugins.models.dispersion.fem.numbering import places_of

        if self._communicator is None:
            return Undivided(self.solver.unknowns)
        return Partition(places_of(self.solver.problem, MixedSpace(self.tagged_mesh.mesh)), self._communicator)

    def pinned_options(self) -> Mapping[str, Any]:
        """Return the digest of the reduced basis in use, if any: an enriched basis may be replaced by a newer one."""
        return {"wind": {"basis": {"digest": self.solver.digest}}} if self.solver.digest else {}

    def initial_memory(self, members: Array) -> Memory:
        """Return the memory of members (N, n) for which no wind was solved yet: their last parameters are NaN."""
        n_members = len(members)
        never = np.full(n_members, np.nan)
        numbers = ("speed", "direction", *(["viscosity"] if "viscosity" in self.estimate else []))
        return {"unit": np.zeros((n_members, self._unit.size)), **dict.fromkeys(numbers, never)}

    def due(self, speed: Array, direction: Array, memory: Memory, viscosity: Array | None = None) -> np.ndarray:
        """Return for which members the wind must be solved again (N,), bool.

        A wind that changes in time is solved whenever it differs, without thresholds: otherwise it would change in
        jumps.

        Args:
            speed: (N,) wind speed in m/s.
            direction: (N,) towards which the air moves, in radians.
            memory: has the parameters of the last solves.
            viscosity: (N,) in m^2/s; None: it is not estimated.
        """
        if self._wind_change.changes:
            changes = (speed != memory["speed"]) | (direction != memory["direction"])
            return changes if viscosity is None else changes | (viscosity != memory["viscosity"])
        turned = np.abs(np.mod(direction - memory["direction"] + np.pi, 2.0 * np.pi) - np.pi)
        changed = np.abs(speed - memory["speed"])
        within = (changed < self.speed_threshold * np.abs(speed)) & (
            turned < self.direction_threshold * np.abs(direction)
        )
        if viscosity is not None:
            within &= np.abs(viscosity - memory["viscosity"]) < self.speed_threshold * viscosity
        return ~within

    def winds(
        self, speed: Array, direction: Array, state: Mapping[str, Array], memory: Memory | None, t: float
    ) -> tuple[Array, Memory | None, Diagnostics]:
        """Solve the winds that are due; a row of the result is a unit wind and its intensity in m/s.

        The arguments are those of ``AdvectionDiffusion.winds``. Raises SolverError, which names the member, if a wind
        cannot be solved and the last one must not be kept.
        """
        if memory is None:
            raise SolverError(f"{self.label}: a step needs the memory that initial_memory or the last step gave")
        memory = {name: array.copy() for name, array in memory.items()}
        viscosity = state["viscosity"][:, 0] if "viscosity" in state else None
        solved = self.due(speed, direction, memory, viscosity)
        kept = np.zeros(len(speed), dtype=bool)
        iterations = np.zeros(len(speed), dtype=np.int64)
        due = np.flatnonzero(solved).tolist()
        viscosities = [None if viscosity is None else float(viscosity[member]) for member in range(len(speed))]
        reynolds = [self.solver.reynolds(float(speed[member]), viscosities[member]) for member in due]
        self.solver.solve_ahead(list(zip(reynolds, direction[due].tolist(), strict=True)), spare_cores())
        for member in due:
            first = np.isnan(memory["speed"][member])
            start = None if first else self._unit.local(memory["unit"][member])
            try:
                with about_member(member):
                    wind = self.solver.solve(speed[member], direction[member], start, viscosities[member])
            except SolverError:
                if self.on_unsolved == "stop" or first:
                    raise
                kept[member], solved[member] = True, False
                continue
            iterations[member] = wind.iterations
            memory["unit"][member] = self._unit.gather(wind.unit)
            memory["speed"][member], memory["direction"][member] = speed[member], direction[member]
            if viscosity is not None:
                memory["viscosity"][member] = viscosity[member]
        diagnostics = {
            "wind_solved": Diagnostic(solved, ("member",), long_name="the wind was solved anew in this cycle"),
            "wind_kept": Diagnostic(kept, ("member",), long_name="the wind could not be solved, the last one was kept"),
            "wind_iterations": Diagnostic(iterations, ("member",), long_name="factorisations of the wind's solve"),
            "wind_speed": Diagnostic(memory["speed"], ("member",), "m s-1", "speed of the wind that carried the gas"),
            "wind_direction": Diagnostic(
                memory["direction"], ("member",), "rad", "angle of the wind that carried the gas"
            ),
        }
        return np.column_stack([memory["unit"], memory["speed"]]), memory, diagnostics

    def velocity(self, wind: Array) -> Any:
        """Return the solved wind of one member in m/s as a DOLFINx function; ``wind`` is a row of ``winds``."""
        return self.solver.velocity(self._unit.local(wind[:-1]), wind[-1])

    @cached_property
    def _reduced_advection(self) -> ReducedAdvection | None:
        """The advection in winds of the reduced basis; None without one, and for SUPG: it is not linear in the wind."""
        from dafw.plugins.models.dispersion.reduced_wind.advection import ReducedAdvection
        from dafw.plugins.models.dispersion.reduced_wind.reduced import ReducedWindSolver

        solver = self.solver
        if not isinstance(solver, ReducedWindSolver) or self.transport.scheme == "supg":
            return None
        # It depends neither on the diffusion nor on the time step.
        name = ("reduced advection", self.tagged_mesh, repr(self.wind))
        return self._shared.once(name, lambda: ReducedAdvection(self._transport, solver))

    def threads(self, winds: Sequence[Array]) -> int:
        """Return how many threads may make and use systems: one for each spare core, if all winds are of the basis.

        Only the systems of flux-corrected transport with ``solver: direct`` are made without DOLFINx and PETSc then.

        Args:
            winds: those of several steps, (N, k) each.
        """
        reduced, transport = self._reduced_advection, self.transport
        if reduced is None or (transport.scheme, transport.solver) != ("fct", "direct"):
            return 1
        return spare_cores() if all(reduced.holds(wind[:-1]) for step in winds for wind in step) else 1

    def system(self, wind: Array, diffusion: float, reuse: System | None = None) -> System:
        """Return the system of a step in the wind of one member; the arguments are as above."""
        reduced = self._reduced_advection
        if reduced is None or not reduced.holds(wind[:-1]):
            return super().system(wind, diffusion, reuse)
        return self._transport.system_of(reduced.matrix(wind[:-1], wind[-1]), reuse, diffusion=diffusion)
