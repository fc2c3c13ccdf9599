"""A study composed of Python objects. A configuration, too, is turned into such a study.

``Study(...)`` computes nothing. Iterating over a study yields its cycles one at a time, so that users can write their
own loop. ``begin`` returns the parts of a cycle and the first state, for users who keep the state as well. ``prepare``
builds what the parts need, such as a mesh, and checks that they fit together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.core.cycle import Cycle, Parts, State, advance, start
from dafw.core.ensemble import Route, Vehicle
from dafw.core.errors import ConfigurationError, NoMoreReadingsError
from dafw.core.executors import Executor
from dafw.core.forecasts.ahead import arrays_of
from dafw.core.forecasts.areas import places_of
from dafw.core.forecasts.plan import ForecastPlan
from dafw.core.interfaces import Filter, Model, Observer, Policy, Readings
from dafw.core.interpolation import view
from dafw.core.late import LATE_CHOICES
from dafw.core.memory import require_memory
from dafw.core.options import require_options
from dafw.core.plugin import plugins_named
from dafw.core.registry import registry
from dafw.core.rng import Streams
from dafw.core.sharing import Shared

RECORDED = ("none", "parameters", "all")
FIELDS_RECORDED = ("all", "ends")


def _built_in(kind: str, name: str) -> Any:
    """Return a built-in part with its defaults."""
    return registry().create(kind, {"name": name})


@dataclass(kw_only=True)
class Study:
    """All parts of a study and its number of cycles.

    model, filter            the forecast model, and the filter that corrects the forecast
    readings                 the source of the readings; by default ``Twin()``, which reads the truth
    truth                    the model that makes a twin's truth; None: there is no truth, and no score that needs one
    free                     the model of the free run, the first guess without any correction; None: no free run
    observer, policy         what is read of a truth, and where the vehicles go; by default nothing, and nowhere
    executor                 steps the members; by default in this process
    start, speed             the vehicles' first positions, [[x, y], ...] in metres, and their speed in m/s
    members, cycles, seed    the size N of the ensemble, the number of time steps, the seed of all random numbers
    late_readings            what to do with late readings from before the filter's window: ``drop`` or ``use`` now
    record                   the variables for which run.nc keeps every member: none, parameters, all
    record_fields            the rows of run.nc that have the fields: all, or its ends, the first and the last
    forecast                 the forecasts of a run: how often, how far, of what; by default none
    checkpoint               how often a run of the study writes a checkpoint, from which it can go on
    section                  corners [[x, y], ...] of the polyline of the section picture, in metres
    advice                   where a run also says what it advises: ``-``, paths of files or named pipes, ``mqtt``
    pictures                 whether a run of the study ends with its pictures
    name                     what the study is called in files, titles and messages
    configuration            the configuration that the study was made from; None: it was made in Python

    Raises ConfigurationError if a part is of the wrong kind or the parts do not fit together.
    """

    model: Model
    filter: Filter
    readings: Readings = field(default_factory=partial(_built_in, "readings", "twin"))
    truth: Model | None = None
    free: Model | None = None
    observer: Observer = field(default_factory=partial(_built_in, "observer", "none"))
    policy: Policy = field(default_factory=partial(_built_in, "policy", "stationary"))
    executor: Executor = field(default_factory=partial(_built_in, "executor", "serial"))
    start: Sequence[Sequence[float]] = ()
    speed: float = 10.0
    members: int = 10
    cycles: int = 100
    seed: int = 0
    late_readings: str = "drop"
    record: str = "parameters"
    record_fields: str = "all"
    forecast: ForecastPlan = field(default_factory=ForecastPlan)
    checkpoint: CheckpointPlan = field(default_factory=CheckpointPlan)
    section: Sequence[Sequence[float]] = ()
    advice: Sequence[str] = ()
    pictures: bool = False
    name: str = "study"
    configuration: Mapping[str, Any] | None = None

    @plugins_named()
    def __post_init__(self) -> None:
        wanted = {"model": Model, "filter": Filter, "readings": Readings, "observer": Observer, "policy": Policy}
        for role, kind in {**wanted, "executor": Executor, "truth": Model, "free": Model}.items():
            part = getattr(self, role)
            if part is None and role in ("truth", "free"):
                continue
            if isinstance(part, type) and issubclass(part, kind):
                raise ConfigurationError(
                    f"a study's {role} must be made already: expected {part.__name__}(...), got the class"
                )
            if not isinstance(part, kind):
                wanted_kind = f"an {kind.kind}" if kind.kind[0] in "aeo" else f"a {kind.kind}"
                raise ConfigurationError(f"a study's {role} must be {wanted_kind}, got {type(part).__name__}")
            require_options(part, part.label)
        for what, plan, wanted_plan in (
            ("forecast", self.forecast, ForecastPlan),
            ("checkpoint", self.checkpoint, CheckpointPlan),
        ):
            if not isinstance(plan, wanted_plan):
                raise ConfigurationError(
                    f"a study's {what} must be a {wanted_plan.__name__}, got {type(plan).__name__}"
                )
            require_options(plan, f"study, {what}")
        for label, value, choices in (
            ("late_readings", self.late_readings, LATE_CHOICES),
            ("record", self.record, RECORDED),
            ("record_fields", self.record_fields, FIELDS_RECORDED),
        ):
            if value not in choices:
                raise ConfigurationError(f"a study's {label} must be one of {', '.join(choices)}, got {value!r}")
        for label, number in (("members", self.members), ("cycles", self.cycles)):
            if number < 1:
                raise ConfigurationError(f"a study's {label} must be at least 1, got {number}")
        if not 0 <= self.seed < 2**63:
            raise ConfigurationError(f"a study's seed must lie between 0 and 2^63 - 1, got {self.seed}")
        window = self.filter.window
        if window is not None and window < 0:
            raise ConfigurationError(f"{self.filter.label}: its window must not be negative, got {window}")
        self.filter.require_members(self.members)
        for label, places in (("start", self.start), ("section", self.section)):
            if any(np.shape(place) != (2,) for place in places):
                raise ConfigurationError(f"a study's {label} must be [[x, y], ...] in metres, got {places}")
        if "mqtt" in self.advice and not self.readings.is_live:
            raise ConfigurationError("advice=[mqtt] goes with readings=live, whose options say which broker")
        if self.readings.needs_truth and self.truth is None:
            raise ConfigurationError(
                f"{self.readings.label} reads a truth, and the study has none: give it a truth, or readings of another "
                f"source (readings=...)"
            )

    @property
    def models(self) -> dict[str, Model]:
        """The models by their role: model, truth, free."""
        models = {"model": self.model, "truth": self.truth, "free": self.free}
        return {role: model for role, model in models.items() if model is not None}

    @property
    def parts_by_role(self) -> Mapping[str, Any]:
        """All plugins of the study by their role."""
        kinds = ("observer", "policy", "filter", "readings", "executor")
        return {**self.models, **{kind: getattr(self, kind) for kind in kinds}}

    @property
    def model_configuration(self) -> Mapping[str, Any] | None:
        """The configuration from which other processes can make the model; None if its class is not registered."""
        return registry().recipe(self.model) if self.configuration is None else self.configuration["model"]

    @plugins_named()
    def prepare(self, communicator: Any = None) -> tuple[Parts, Vehicle]:
        """Build the parts of a cycle and place the vehicles; raises a DafwError that names the plugin.

        The work of the models is distributed among the ranks of an MPI ``communicator``, which all call this.
        """
        model, shared = self.model, Shared()
        for one in self.models.values():
            one.share_with(shared)
        if communicator is not None:
            if self.readings.is_live:
                raise ConfigurationError(f"mpirun: {self.readings.label} cannot be shared by several processes")
            if registry().recipe(self.executor) != {"name": "serial"}:
                raise ConfigurationError(f"mpirun expects the executor 'serial', got {self.executor.label}")
            for one in self.models.values():
                one.distribute(communicator)
        for role, other in self.models.items():
            if other.dt != model.dt:
                raise ConfigurationError(f"the {role} has dt = {other.dt:g} s, the model {model.dt:g} s: expected one")
        if self.free is not None and not self.free.space.agrees(model.space):
            raise ConfigurationError(
                f"the free run has {self.free.space!r}, the model {model.space!r}: they must agree, in their "
                f"coordinates too"
            )
        truth_view = None
        if self.truth is not None:
            truth_view = view(self.truth.space, self.truth.domain, model.space, "truth")
        for role, asked in self.models.items():
            try:
                asked.require_available()
            except ConfigurationError as error:  # the model's own check has passed before
                raise type(error)(str(error) if role == "model" else f"{role}: {error}") from error
        vehicle = self._vehicle()
        self.observer.suit(model.space, model.dt)
        self.observer.look(model.space, Route.hover(vehicle), 0.0)
        self.policy.suit(model.space)
        self.policy.suit_vehicles(vehicle)
        self.filter.suit(model.space, self.members)
        if self.filter.weighs_first_guess:
            model.require_log_first_guess()
        if self.filter.uses_coarser or self.policy.uses_coarser:
            model.coarser().require_available()
        self.readings.suit(model.space, model.domain, model.dt)
        if self.forecast.every is not None:
            self.forecast.suit(model.dt)
            places_of(self.forecast, model.space.variables[0], model.domain)
        require_memory(self.wanted_memory())
        parts = Parts(
            model=model,
            truth=self.truth,
            free=self.free,
            observer=self.observer,
            policy=self.policy,
            filter=self.filter,
            readings=self.readings,
            streams=Streams(self.seed),
            executor=self.executor,
            late_readings=self.late_readings,
            truth_view=truth_view,
        )
        return parts, vehicle

    def _vehicle(self) -> Vehicle:
        """Return the vehicles at their start; raises ConfigurationError if a position is not allowed."""
        domain = self.model.domain
        positions = np.array(self.start, dtype=np.float64).reshape(-1, 2)
        for number, position in enumerate(positions):
            if domain is not None and not domain.is_free(position, position):
                raise ConfigurationError(
                    f"vehicle {number} cannot start at {position.tolist()}: that is inside a building or outside the "
                    f"domain {[round(bound, 1) for bound in domain.bounds]}"
                )
        for corner in self.section:
            if domain is not None and not domain.contains(np.array(corner)):
                raise ConfigurationError(f"the section's corner {corner} lies outside the domain {domain.bounds}")
        return Vehicle(positions, self.speed, self.model.dt, domain)

    def wanted_memory(self) -> dict[str, float]:
        """Return the bytes that the ensemble and the past that the filter looks back to need, by their purpose."""
        state = 8.0 * self.members * self.model.space.size
        window = self.cycles if self.filter.window is None else self.filter.window
        beliefs = window if self.filter.past_beliefs == "all" or self.filter.window is not None else 1
        wanted = {f"{self.members} members of {self.model.space.size} numbers, with what is made of them": 8.0 * state}
        if copies := self.executor.copies():
            wanted[f"the members in the workers of {self.executor.label}"] = copies * state
        if window:
            wanted[f"{beliefs} past beliefs that {self.filter.label} looks back to"] = beliefs * state
        if self.forecast.every is not None:
            wanted["forecasts of all members"] = state * arrays_of(self.forecast)
        return wanted

    def begin(self) -> tuple[Parts, State]:
        """Build the parts, start the executor and draw the first belief.

        Use it to keep the state yourself: ``advance(parts, state)`` computes one cycle, and the ``state`` of the
        returned cycle is the input of the next. Close ``parts.executor`` at the end if it uses other processes.
        """
        parts, vehicle = self.prepare()
        parts.executor.start(parts.model, self.model_configuration)
        try:
            return parts, start(parts, self.members, vehicle)
        except BaseException:
            parts.executor.close()
            raise

    def __iter__(self) -> Iterator[Cycle]:
        """Run the study and yield its cycles one at a time; nothing is written."""
        parts, state = self.begin()
        with parts.executor:
            try:
                for _ in range(self.cycles):
                    cycle = advance(parts, state)
                    yield cycle
                    state = cycle.state
            except NoMoreReadingsError:
                return
            finally:
                parts.readings.end()
