"""From a composed configuration to a study.

``StudyOptions`` is the whole of what a configuration may say; ``study_from`` checks it and makes the plugins, without
computing anything. Configuration holds names and numbers only: which code runs is decided by the registry.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.core.errors import ConfigurationError
from dafw.core.forecasts.plan import ForecastPlan
from dafw.core.interfaces import Model, Readings
from dafw.core.late import LATE_CHOICES
from dafw.core.options import build, merged, option
from dafw.core.registry import registry
from dafw.core.study import FIELDS_RECORDED, RECORDED, Study

RESUME = ("never", "auto")
NAME = re.compile(r"[\w.-]{1,100}")


@dataclass
class VehicleOptions:
    """The vehicles of a study."""

    start: list[list[float]] = option([], "positions of the vehicles at t = 0, [[x, y], ...] in metres")
    speed: float = option(10.0, "speed of every vehicle in m/s", minimum=0.0)


@dataclass
class RecordOptions:
    """What ``run.nc`` keeps beyond means and spreads."""

    members: str = option(
        "parameters",
        "state variables whose members are all recorded: single numbers (parameters), all, or none",
        choices=RECORDED,
    )
    fields: str = option(
        "all", "rows that have the fields: all, or the ends (the first and the last)", choices=FIELDS_RECORDED
    )


@dataclass
class StudyOptions:
    """Everything that a study's configuration may say."""

    name: str = option("study", "name of the study, used for folders and titles")
    seed: int = option(0, "seed of every random stream", minimum=0, maximum=2**63 - 1)
    members: int = option(10, "number N of ensemble members", minimum=1)
    cycles: int | None = option(
        100, "number of cycles; null: until the last reading, of readings that have one (recorded)", minimum=1
    )
    model: dict[str, Any] = option({}, "name and options of the model")
    truth: dict[str, Any] | None = option({}, "options of the truth that differ from the model's; null: no truth")
    free: dict[str, Any] | None = option({}, "options of the free run that differ from the model's; null: no free run")
    observer: dict[str, Any] = option({}, "name and options of the observer")
    policy: dict[str, Any] = option({}, "name and options of the policy")
    filter: dict[str, Any] = option({}, "name and options of the filter")
    readings: dict[str, Any] = option({"name": "twin"}, "name and options of the source of readings")
    executor: dict[str, Any] = option({"name": "serial"}, "name and options of the executor, which steps the members")
    late_readings: str = option(
        "drop",
        "a reading that arrives too late for the filter's window: drop it, or use it as if it were taken now",
        choices=LATE_CHOICES,
    )
    score_truth: bool = option(False, "compute the truth for the scores, even if the readings do not come from it")
    vehicle: VehicleOptions = field(default_factory=VehicleOptions)
    record: RecordOptions = field(default_factory=RecordOptions)
    forecast: ForecastPlan = field(default_factory=ForecastPlan)
    checkpoint: CheckpointPlan = field(default_factory=CheckpointPlan)
    resume: str = option(
        "never",
        "auto: go on if the folder holds an unfinished run of the same configuration, start otherwise",
        choices=RESUME,
    )
    section: list[list[float]] = option([], "corners [[x, y], ...] of the polyline of the section picture, in metres")
    advice: list[str] = option(
        [],
        "where the advice of a run is written beside its advice.jsonl: - for standard output, the path of a file or "
        "a named pipe, or mqtt for the broker of readings=live",
    )
    pictures: bool = option(True, "draw the pictures at the end")


def _variant(model: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration ``model`` with ``changes``. If they name another plugin, its defaults are the base."""
    return dict(changes) if changes.get("name", model.get("name")) != model.get("name") else merged(model, changes)


def options_from(config: Mapping[str, Any]) -> StudyOptions:
    """Check everything of a composed configuration but the plugins' options; raises ConfigurationError."""
    options = build(StudyOptions, config, "study")
    for label, points in (("vehicle.start", options.vehicle.start), ("section", options.section)):
        if any(len(point) != 2 for point in points):
            raise ConfigurationError(f"{label} must be [[x, y], ...] in metres, got {points}")
    if len(options.section) == 1:
        raise ConfigurationError(f"section needs two corners or more, got {options.section}")
    if not NAME.fullmatch(options.name):
        raise ConfigurationError(f"name must be of letters, digits and . _ - (it names a folder), got '{options.name}'")
    return options


def study_from(config: Mapping[str, Any]) -> Study:
    """Check a composed configuration as far as that is possible without computing, and make the study's plugins.

    Raises ConfigurationError.
    """
    options = options_from(config)
    made = {
        kind: registry().create(kind, getattr(options, kind))
        for kind in ("observer", "policy", "filter", "readings", "executor")
    }
    with_truth = options.truth is not None and (made["readings"].needs_truth or options.score_truth)
    models = _models(options, with_truth)
    return Study(
        **models,
        **made,
        start=options.vehicle.start,
        speed=options.vehicle.speed,
        members=options.members,
        cycles=_until_the_last(made["readings"], models["model"].dt) if options.cycles is None else options.cycles,
        seed=options.seed,
        late_readings=options.late_readings,
        record=options.record.members,
        record_fields=options.record.fields,
        section=options.section,
        forecast=options.forecast,
        advice=options.advice,
        checkpoint=options.checkpoint,
        pictures=options.pictures,
        name=options.name,
        configuration=dict(config),
    )


def _until_the_last(readings: Readings, dt: float) -> int:
    """Return the number of cycles until the last reading; raises ConfigurationError if nobody knows which it is."""
    covered = readings.cycles_covered(dt)
    if covered is None:
        raise ConfigurationError(
            f"cycles=null goes with readings that have a last one, such as readings=recorded, got {readings.label}: "
            f"expected a number of cycles"
        )
    return covered


def _models(options: StudyOptions, with_truth: bool) -> dict[str, Any]:
    """Make the model, the truth and the free run."""

    def make(role: str, changes: Mapping[str, Any]) -> Model:
        try:
            model: Model = registry().create("model", _variant(options.model, changes))
        except ConfigurationError as error:
            raise type(error)(f"{role}: {error}" if changes else str(error)) from error
        return model

    return {
        "model": make("model", {}),
        "truth": make("truth", options.truth or {}) if with_truth else None,
        "free": None if options.free is None else make("free", options.free),
    }
