"""Model ``ad``: a gas carried and spread by a wind that is the same everywhere.

State: the concentration at the nodes of the mesh (relative to the released maximum), the wind speed (m/s), the wind
direction (radians, the angle TOWARDS which the air moves, counter-clockwise from east). Algorithm 1 of Gioia et al.
(2024), doi:10.1109/SDF63218.2024.10773899, gives the order of a step: noise on the concentration, cut-off of spurious
values, transport. Speed and direction of the state are those at t = 0 (``wind_change`` says how the wind changes in
time), so they do not evolve; only the assimilation changes them.

This module holds the options, so it is imported when a configuration is checked, and must be light. What computes is
imported where it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Diagnostics, Memory, Step
from dafw.core.errors import ConfigurationError
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import NONNEGATIVE, Array, StateSpace, Variable
from dafw.plugins.models.dispersion.mesh.partition import Partition, Undivided
from dafw.plugins.models.dispersion.on_mesh import OnMesh
from dafw.plugins.models.dispersion.plausible import largest_concentration
from dafw.plugins.models.dispersion.sources import SourceOptions, largest_scale, released, sources, supply
from dafw.plugins.models.dispersion.transport.kept import KeptSystems
from dafw.plugins.models.dispersion.transport.options import TransportOptions, require_one_process
from dafw.plugins.models.dispersion.unknowns import Possible, unknowns
from dafw.plugins.models.dispersion.wind_change import WindChange, WindChangeOptions

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.transport.transport import System, Transport

MAX_DRAWS = 1000
"""Draws from the priors for one member of the first guess; where fewer than 1 % are possible, something is wrong."""
BLOCK_BYTES = 2**23
"""About how much memory, in bytes, the states of the steps that are made at once may take."""


@dataclass
class AdvectionDiffusion(OnMesh):
    """Gas dispersion in a given uniform wind, over open ground: buildings stop vehicles, not the gas."""

    transport: TransportOptions = option(TransportOptions, "the transport of the gas")
    dt: float = option(1.0, "time step in seconds", above=0.0)
    release: list[float] = option([0.0, 0.0], "place of the (first) release, [x, y] in metres")
    release_radius: float = option(30.0, "standard deviation of the released Gaussian cloud, in metres", above=0.0)
    release_sd: float | None = option(
        None,
        "uncertainty of a release's place where that is estimated: standard deviation, m; null: release_radius",
        minimum=0.0,
    )
    source: SourceOptions = option(SourceOptions, "the kind and amount of the release, and more sources")
    wind_speed: float | None = option(
        5.0, "first guess of the wind speed: mean, m/s; null: the measured one", minimum=0.0
    )
    wind_speed_sd: float = option(0.0, "first guess of the wind speed: standard deviation, m/s (Weibull)", minimum=0.0)
    wind_speed_max: float | None = option(
        None, "strongest wind that the first guess can draw, m/s; null: any of the Weibull distribution", above=0.0
    )
    wind_direction: float | None = option(
        np.pi,
        "first guess of the wind direction: mean, radians, towards which it blows; null: the measured one",
    )
    wind_direction_sd: float = option(
        0.0, "first guess of the wind direction: standard deviation, radians", minimum=0.0
    )
    wind_change: WindChangeOptions = option(WindChangeOptions, "how the wind changes in time")
    noise: float = option(0.0, "standard deviation of the noise before a step, relative to the value", minimum=0.0)
    cutoff: float = option(1e-6, "with noise: concentrations up to this are set to zero before a step")
    estimate: list[str] = option(
        [],
        "more unknowns, which become part of the state: diffusion, release_x, release_y; for a burst amount; for a "
        "leak rate, leak_start; for a second source release_2_x, rate_2, ...; ad_ins has viscosity, too",
    )
    priors: dict[str, Any] = option({}, "priors of unknowns by name, instead of the default priors")
    certain: bool = option(False, "every unknown has the value of its option; for the truth and the free run")

    _systems: KeptSystems[Any] = field(default_factory=KeptSystems, init=False, repr=False)

    @property
    def expected_failures(self) -> Mapping[str, str]:  # type: ignore[override]  # it depends on the options
        """The checks that the model is meant to fail: without flux correction, concentrations below zero."""
        if self.transport.scheme == "fct":
            return {}
        return {"steps_in_set": "undershoots of the scheme are left to the filter's retraction"}

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return six tanks of the plant on a mesh of some 200 nodes, in light and uncertain winds."""
        site = {"bounds": [7.995, 50.0005, 7.9975, 50.0022]}
        mesh = {"wall_size": 30.0, "far_size": 60.0, "across": 1}
        cloud = {"release": [-6.0, -45.0], "release_radius": 10.0, "noise": 0.1}
        return {"site": site, "mesh": mesh, **cloud, "wind_speed_sd": 0.5, "wind_direction_sd": 0.5}

    def __post_init__(self) -> None:
        if len(self.release) != 2:
            raise ConfigurationError(f"the release must be one place [x, y] in metres, got {self.release}")
        self._sources = sources(self.release, self.release_radius, self.source)
        self._wind_change = WindChange(self.wind_change)
        self._unknown = unknowns(self, self.own_unknowns(), self.first_wind)

    @property
    def first_wind(self) -> tuple[float, float]:
        """The first guess of the wind at t = 0: m/s, and radians from east towards which it blows.

        Raises ConfigurationError if there is none, ReadingsError if the record of a measured one cannot be read.
        """
        speed, direction = self.wind_speed, self.wind_direction
        if speed is None or direction is None:
            if self.wind_change.kind != "measured":
                name = "wind_speed" if speed is None else "wind_direction"
                raise ConfigurationError(f"{name} is null, which means the measured one: set wind_change.kind=measured")
            measured = self._wind_change.at_start
            return measured[0] if speed is None else speed, measured[1] if direction is None else direction
        return speed, direction

    @property
    def input_files(self) -> Sequence[Path]:
        """The files with a measured wind. A changed site is noticed by the state at the start."""
        from dafw.plugins.readings.files.any_file import paths_of

        return paths_of(self.wind_change.measured)

    def own_unknowns(self) -> Mapping[str, Possible]:
        """Return what can be estimated of this model beside what all have, by name."""
        return {}

    def distribute(self, communicator: Any) -> None:
        """Divide the mesh among the ranks of an MPI communicator; every rank still has the full state.

        Raises ConfigurationError if the scheme or the outer boundary works in one process.
        """
        try:
            require_one_process(self.transport)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error
        self._communicator = communicator

    def require_available(self) -> None:
        """Read a measured wind; raises ReadingsError, and ConfigurationError if it cannot be used."""
        try:
            self._wind_change.notes()
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error

    @cached_property
    def _nodes(self) -> Partition | Undivided:
        """The step between the nodes of the state and those of the transport on this rank."""
        from dafw.plugins.models.dispersion.fem.numbering import nearest

        nodes = self._topology[0]
        if self._communicator is None:
            return Undivided(len(nodes))
        return Partition(nearest(nodes, self._transport.matrices.places), self._communicator)

    @cached_property
    def space(self) -> StateSpace:  # type: ignore[override]  # made when first asked for
        """Concentration, wind speed, wind direction, and whatever else is estimated."""
        nodes, triangles = self._topology
        largest = largest_concentration(self.noise) * largest_scale(self._sources, self.estimate)
        return StateSpace(
            [
                Variable("concentration", len(nodes), NONNEGATIVE, "1", nodes, "", largest, triangles),
                *(Variable(one.name, 1, one.kind, one.units, plausible=one.plausible) for one in self._unknown),
            ]
        )

    @cached_property
    def domain(self) -> Domain:  # type: ignore[override]  # made when first asked for
        """The rectangle, the buildings and the triangles."""
        site = self.place
        rings = tuple(np.asarray(building.exterior.coords)[:-1] for building in site.buildings)
        places = {"release" if one.number == 1 else f"release_{one.number}": one.place for one in self._sources}
        domain = Domain(site.bounds, rings, site.names, self._topology[1], places, site.origin)
        for place in places.values():
            if not domain.is_free(np.array(place), np.array(place)):
                raise ConfigurationError(
                    f"{self.label}: the release {list(place)} lies in a building or outside the site"
                )
        return domain

    @cached_property
    def _transport(self) -> Transport:
        from dafw.plugins.models.dispersion.transport.transport import Transport

        return Transport(self.solver_mesh, self.transport, self.dt)

    def notes(self) -> list[str]:
        """Return what was done to the site, and the size of the mesh."""
        size = f"{self._topology[0].shape[0]} nodes, {len(self._topology[1])} triangles"
        divided = f", divided among {self._communicator.size} processes" if self._communicator else ""
        return [*self.place.report_lines(), size + divided, *self._wind_change.notes()]

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return the gas of the bursts, with the wind and whatever else is estimated drawn from the first guess."""
        nothing = np.zeros(self.space["concentration"].size)

        def one(generator: np.random.Generator) -> Array:
            for _ in range(MAX_DRAWS):
                drawn = {one.name: one.prior.draw(generator) for one in self._unknown}
                member = self.space.pack({"concentration": nothing, **drawn})
                if self.possible(member[np.newaxis]).all():
                    return member
            raise ConfigurationError(f"{self.label}: of {MAX_DRAWS} draws of the first guess none is possible")

        return self.settled(rng.draw(n_members, one))

    def log_first_guess(self, members: Array) -> Array:
        """Return the log density (N,) of the priors at the unknowns of members (N, n); -inf if not possible."""
        state = self.space.unpack(members)
        density = np.sum([one.prior.log_density(state[one.name][:, 0]) for one in self._unknown], axis=0)
        return np.where(self.possible(members), density, -np.inf)

    def possible(self, members: Array) -> np.ndarray:
        """Return for which members (N, n) the model has a step (N,), bool: what the prior of one number cannot say."""
        return np.ones(len(members), dtype=bool)

    def settled(self, members: Array) -> Array:
        """Return the members (N, n) with the gas that the bursts of their releases leave at t = 0."""
        settled = members.copy()
        state = self.space.unpack(settled)
        state["concentration"][:] = released(self._sources, self._topology[0], state)
        return settled

    def step_with_memory(self, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Return the members a step later: noise, cut-off, wind, transport with what the leaks add."""
        return self.steps_with_memory(members, memory, t, rng, 1)[0]

    def steps_with_memory(
        self, members: Array, memory: Memory | None, t: float, rng: MemberStreams, n_steps: int
    ) -> list[Step]:
        """Return the next steps: without noise several, which are quicker together (transport/carry.py)."""
        from dafw.plugins.models.dispersion.transport.carry import carry

        count = 1
        if self.noise == 0.0 and self._communicator is None:
            size = members.nbytes + sum(array.nbytes for array in (memory or {}).values())
            count = min(n_steps, 1 + BLOCK_BYTES // size)
        states = [members.copy() for _ in range(count)]
        first = self.space.unpack(states[0])
        if self.noise > 0.0:
            concentration = first["concentration"]
            concentration += self.noise * concentration * rng.standard_normal(concentration.shape)
            concentration[concentration <= self.cutoff] = 0.0
        if self._communicator is not None:
            # Ranks on other kinds of processors may have rounded differently; all continue with the numbers of rank 0.
            self._communicator.Bcast(states[0])
        times = list(accumulate([t] + [self.dt] * (count - 1)))  # the same sums as one step after the other
        steps, winds, rates = [], [], []
        for state, time in zip(states, times, strict=True):
            speed, direction = first["wind_speed"][:, 0], first["wind_direction"][:, 0]
            speed, direction = self._wind_change.wind(time + 0.5 * self.dt, speed, direction, first)
            found, memory, diagnostics = self.winds(speed, direction, first, memory, time)
            winds.append(found)
            supplied = supply(self._sources, self._topology[0], first, time, self.dt)
            rates.append(None if supplied is None else np.broadcast_to(supplied, first["concentration"].shape))
            steps.append(Step(state, memory, diagnostics))
        diffusion = (
            first["diffusion"][:, 0] if "diffusion" in first else np.full(len(members), self.transport.diffusion)
        )
        fields = [self.space.unpack(state)["concentration"] for state in states]
        self._systems.limit = max(self._systems.limit, self._transport.systems_kept(len(members)))
        # Without flux correction there may be values below zero; the filter's retraction puts that right.
        threads = self.threads(winds)
        added = carry(fields, winds, rates, diffusion, self._system, self._nodes, threads, self._systems.limit)
        return [
            Step(step.members, step.memory, {**step.diagnostics, **more})
            for step, more in zip(steps, added, strict=True)
        ]

    def winds(
        self, speed: Array, direction: Array, state: Mapping[str, Array], memory: Memory | None, t: float
    ) -> tuple[Array, Memory | None, Diagnostics]:
        """Return the winds (N, k) of the members, in numbers that define them, with new memory and diagnostics.

        Args:
            speed: (N,) wind speed of every member in m/s.
            direction: (N,) towards which the air moves, in radians.
            state: the variables of the members by name, (N, size) each, for what else a wind depends on.
            memory: that of the members.
            t: time in s.
        """
        return np.stack([speed, direction], axis=1), None, {}

    def velocity(self, wind: Array) -> Any:
        """Return the wind of one member in m/s as a DOLFINx function; ``wind`` (k,) is a row of ``winds``."""
        speed, direction = wind
        return self._transport.uniform_velocity(speed, direction)

    def threads(self, winds: Sequence[Array]) -> int:
        """Return how many threads may make and use systems for winds (N, k); one, because DOLFINx is not thread-safe.

        Args:
            winds: those of several steps.
        """
        return 1

    def _system(self, wind: Array, diffusion: float) -> Callable[[], Any]:
        """Return a function that returns the ``System`` of a step, which may be kept from an earlier step.

        A whole run of ten members takes 14 % longer if only one is kept.
        """
        place = self._systems.place(np.append(wind, diffusion))
        return lambda: place.system(lambda reuse: self.system(wind, diffusion, reuse))

    def system(self, wind: Array, diffusion: float, reuse: System | None = None) -> System:
        """Return the system of a step in the wind of one member.

        Args:
            wind: (k,) a row of ``winds``.
            diffusion: coefficient in m^2/s.
            reuse: a system that is no longer needed; it may be overwritten and returned.
        """
        return self._transport.system(self.velocity(wind), reuse, diffusion=diffusion)
