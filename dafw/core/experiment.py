"""From a composed configuration to the parts of a cycle.

``Study`` is the whole of what a configuration may say; ``study_from`` checks it without computing anything, and
``assemble`` builds the plugins. Configuration holds names and numbers only: which code runs is decided by the registry.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dafw.core.cycle import Parts
from dafw.core.ensemble import Route, Vehicle
from dafw.core.errors import ConfigurationError
from dafw.core.executors import make_executor
from dafw.core.interfaces import Filter, Model, Observer, Policy
from dafw.core.options import build, merged, option
from dafw.core.registry import KINDS, registry
from dafw.core.rng import Streams
from dafw.core.sharing import together

NAME = re.compile(r"[\w.-]{1,100}")


@dataclass
class VehicleOptions:
    """The vehicles of a study."""

    start: list[list[float]] = option([], "where the vehicles are at t = 0, [[x, y], ...] in metres")
    speed: float = option(10.0, "speed of every vehicle in m/s", minimum=0.0)


@dataclass
class RecordOptions:
    """What ``run.nc`` keeps beyond means and spreads."""

    members: str = option(
        "parameters", "state variables of which every member is kept", choices=("none", "parameters", "all")
    )


@dataclass
class Study:
    """Everything that a study's configuration may say."""

    name: str = option("study", "name of the study, for folders and titles")
    seed: int = option(0, "seed of every random stream", minimum=0, maximum=2**63 - 1)
    members: int = option(10, "number N of ensemble members", minimum=1)
    cycles: int = option(100, "number of cycles", minimum=1)
    model: dict[str, Any] = option({}, "the model's name and options")
    truth: dict[str, Any] = option({}, "options in which the truth differs from the model")
    free: dict[str, Any] | None = option({}, "options in which the free run differs from the model; null: no free run")
    observer: dict[str, Any] = option({}, "the observer's name and options")
    policy: dict[str, Any] = option({}, "the policy's name and options")
    filter: dict[str, Any] = option({}, "the filter's name and options")
    executor: dict[str, Any] = option({"name": "serial"}, "the name and options of what steps the members")
    vehicle: VehicleOptions = field(default_factory=VehicleOptions)
    record: RecordOptions = field(default_factory=RecordOptions)
    section: list[list[float]] = option([], "corners [[x, y], ...] of the polyline of the section picture, in metres")
    pictures: bool = option(True, "draw the pictures at the end")


def _variant(model: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration of a model that differs from ``model``; another name starts from that plugin's own."""
    return dict(changes) if changes.get("name", model.get("name")) != model.get("name") else merged(model, changes)


def study_from(config: Mapping[str, Any]) -> Study:
    """Check a composed configuration as far as that is possible without computing; raises ConfigurationError."""
    study = build(Study, config, "study")
    for label, points in (("vehicle.start", study.vehicle.start), ("section", study.section)):
        if any(len(point) != 2 for point in points):
            raise ConfigurationError(f"{label} must be [[x, y], ...] in metres, got {points}")
    if len(study.section) == 1:
        raise ConfigurationError(f"section needs two corners or more, got {study.section}")
    if not NAME.fullmatch(study.name):
        raise ConfigurationError(f"name must be of letters, digits and . _ - (it names a folder), got '{study.name}'")
    for kind in KINDS:
        registry().create(kind, getattr(study, kind))
    make_executor(study.executor)
    _models(study)
    registry().create("filter", study.filter).require_members(study.members)
    return study


def _models(study: Study) -> tuple[Model, Model, Model | None]:
    """Make the model, the truth and the free run, which share what they have in common."""

    def make(role: str, changes: Mapping[str, Any]) -> Model:
        try:
            model: Model = registry().create("model", _variant(study.model, changes))
        except ConfigurationError as error:
            raise type(error)(f"{role}: {error}" if changes else str(error)) from error
        return model

    with together():
        return make("model", {}), make("truth", study.truth), None if study.free is None else make("free", study.free)


def assemble(study: Study, communicator: Any = None) -> tuple[Parts, Vehicle]:
    """Build the parts of a cycle and place the vehicles; raises a DafwError that names the plugin.

    The ranks of an MPI ``communicator``, which call together, share the work of the models.
    """
    model, truth, free = _models(study)
    if communicator is not None:
        if study.executor.get("name") != "serial":
            raise ConfigurationError(f"mpirun expects the executor 'serial', got '{study.executor.get('name')}'")
        for shared in (model, truth, free):
            if shared is not None:
                shared.share(communicator)
    for label, other in (("truth", truth), ("free run", free)):
        if other is not None and not (other.space.agrees(model.space) and other.dt == model.dt):
            raise ConfigurationError(
                f"the {label} has {other.space!r} and dt = {other.dt:g} s, "
                f"the model {model.space!r} and {model.dt:g} s: they must agree, in their coordinates too"
            )
    for role, asked in (("", model), ("truth: ", truth), ("free: ", free)):
        try:
            if asked is not None:
                asked.require_available()
        except ConfigurationError as error:  # the model was asked first
            raise type(error)(f"{role}{error}") from error
    observer: Observer = registry().create("observer", study.observer)
    policy: Policy = registry().create("policy", study.policy)
    filter_: Filter = registry().create("filter", study.filter)
    executor = make_executor(study.executor)
    parts = Parts(model, truth, free, observer, policy, filter_, Streams(study.seed), executor)
    positions = np.array(study.vehicle.start, dtype=np.float64).reshape(-1, 2)
    for number, position in enumerate(positions):
        if model.domain is not None and not model.domain.is_free(position, position):
            raise ConfigurationError(
                f"vehicle {number} cannot start at {position.tolist()}: that is inside a building or outside the "
                f"domain {[round(bound, 1) for bound in model.domain.bounds]}"
            )
    for corner in study.section:
        if model.domain is not None and not model.domain.contains(np.array(corner)):
            raise ConfigurationError(f"the section's corner {corner} lies outside the domain {model.domain.bounds}")
    vehicle = Vehicle(positions, study.vehicle.speed, model.dt, model.domain)
    observer.suit(model.space, model.dt)
    observer.look(model.space, Route.hover(vehicle), 0.0)
    policy.suit(model.space)
    filter_.suit(model.space, study.members)
    return parts, vehicle
