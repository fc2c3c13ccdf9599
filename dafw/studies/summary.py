"""Contents of ``summary.json``: how the run ended, the scores of the belief, the parts and the times of the run."""

from __future__ import annotations

import json
import math
import platform
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.cycle import Cycle, Parts, State
from dafw.core.registry import registry
from dafw.core.study import Study

VERSIONED = ("dafw", "numpy", "scipy", "dolfinx-solver-real", "gmsh", "netcdf4", "xarray", "hydra-core")
USES_TO_WARN_OF = {
    "late_used_now": "a reading came late and is used as if it were of now",
    "late_dropped": "a reading came too late and is dropped",
    "before_start": "a reading is of a time before the study begins and is dropped",
}
"""Uses of a reading (``dafw.core.late.USES``) that a user must know of, in words."""


class Summary:
    """The summary of one run, updated in every cycle."""

    def __init__(self, study: Study, begun: float, processes: int) -> None:
        self.study, self.begun, self.processes = study, begun, processes
        self.status, self.error = "interrupted", ""
        self.cycles = 0
        self.warned: set[str] = set()
        self.diverged_at: float | None = None
        self.pinned: dict[str, Mapping[str, Any]] = {}
        self.forecasts: Mapping[str, Any] | None = None
        self.versions = versions_of(study)
        self.files: Mapping[str, str] = {}
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._scores: Mapping[str, float] = {}
        self._parameters: dict[str, dict[str, float | None]] = {}
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._left_out: defaultdict[str, int] = defaultdict(int)
        # Of innovation_rms, over the cycles that have readings: how many they are, and the sum of its squares.
        self._innovations, self._squares = 0, 0.0
        self.configuration = ""
        self.working_folder: str | None = None
        with suppress(OSError):  # somebody has removed it
            self.working_folder = str(Path.cwd())
        self.resumed_after: list[int] = []
        self.failed_at: Mapping[str, Any] | None = None

    def begin(self, study: Study) -> None:
        """Record the pinned options of the models, and how long set-up took."""
        found = {role: model.pinned_options() for role, model in study.models.items()}
        self.pinned = {role: options for role, options in found.items() if options}
        self._seconds["set-up"] = perf_counter() - self.begun

    def add(self, cycle: Cycle, scores: Mapping[str, float]) -> None:
        """Add a finished cycle."""
        self.cycles += 1
        self._scores = scores
        innovation = scores["innovation_rms"]
        if math.isfinite(innovation):
            self._innovations += 1
            self._squares += innovation * innovation
        for phase, seconds in cycle.seconds.items():
            self._seconds[phase] += seconds
        for use, count in cycle.readings.counts.items():
            self._counts[use] += count
        for reason, count in cycle.left_out.items():
            self._left_out[reason] += count
        belief = cycle.state.belief.ensemble
        if self.diverged_at is None and belief.space.exceeds(belief.members, 1.0):
            self.diverged_at = cycle.state.belief.ensemble.time

    def kept(self) -> dict[str, Any]:
        """Return as plain values what a checkpoint must hold for the summary to go on."""
        return {
            "cycles": self.cycles,
            "warned": sorted(self.warned),
            "diverged_at": self.diverged_at,
            "forecasts": self.forecasts,
            "seconds": dict(self._seconds),
            "scores": dict(self._scores),
            "counts": dict(self._counts),
            "left_out": dict(self._left_out),
            "innovations": {"cycles": self._innovations, "squares": self._squares},
            "resumed_after": self.resumed_after,
            "elapsed": perf_counter() - self.begun,
        }

    def go_on(self, kept: Mapping[str, Any]) -> None:
        """Go on from what ``kept`` returned; raises LookupError, TypeError or ValueError if it did not."""
        self.cycles, self.diverged_at, self.forecasts = kept["cycles"], kept["diverged_at"], kept["forecasts"]
        self.warned |= set(kept["warned"])
        for own, before in (
            (self._seconds, kept["seconds"]),
            (self._counts, kept["counts"]),
            (self._left_out, kept["left_out"]),
        ):
            for name, number in before.items():
                own[name] += number
        self._scores, innovations = dict(kept["scores"]), kept["innovations"]
        self._innovations, self._squares = innovations["cycles"], innovations["squares"]
        self.resumed_after = [*kept["resumed_after"], self.cycles]
        self.begun -= kept["elapsed"]

    def end(self, parts: Parts, state: State) -> None:
        """Record the parameters after the last cycle."""
        self._parameters = _parameters(parts, state)

    def warnings(self, cycle: Cycle, parts: Parts) -> Iterator[tuple[str, str]]:
        """Yield warnings about a cycle as pairs of topic and text; the caller prints each topic once."""
        belief = cycle.state.belief.ensemble
        if self.diverged_at == belief.time:
            member, entry = belief.space.farthest(belief.members)
            yield (
                "diverged",
                f"{parts.filter.label} has diverged: {belief.space.place_of(entry)} of member {member} is "
                f"{belief.members[member, entry]:.4g}, more than the model itself can produce",
            )
        for use, text in USES_TO_WARN_OF.items():
            if cycle.readings.counts.get(use):
                yield use, f"{text} (summary.json counts them)"
        for reason, count in cycle.left_out.items():
            rows = f"{parts.readings.word} is" if count == 1 else f"{parts.readings.word}s are"
            text = f"{parts.readings.label}: {count} {rows} left out, {reason.replace('_', ' ')}"
            yield reason, f"{text} (summary.json counts them)"

    def values(self) -> dict[str, Any]:
        """Return the present summary."""
        study = self.study
        summary = {
            "status": self.status,
            "name": study.name,
            "seed": study.seed,
            "members": study.members,
            "parts": registry().parts(study.parts_by_role),
            "executor": registry().recipe(study.executor) or {"name": type(study.executor).__name__},
            "processes": self.processes,
            "cycles": self.cycles,
            "cycles_wanted": study.cycles,
            "err_final": _finite(self._scores.get("err")),
            "err_free_final": _finite(self._scores.get("err_free")),
            "innovation_rms": math.sqrt(self._squares / self._innovations) if self._innovations else None,
            "diverged_at": self.diverged_at,
            "readings": dict(self._counts),
            "readings_left_out": dict(self._left_out),
            "parameters_final": self._parameters,
            "wall_seconds": round(perf_counter() - self.begun, 3),
            "pinned": self.pinned,
            "phase_seconds": {phase: round(seconds, 4) for phase, seconds in self._seconds.items()},
            "versions": self.versions,
            "forecasts": None if self.forecasts is None else dict(self.forecasts),
            "configuration": self.configuration,
            "files": dict(self.files),
            "working_folder": self.working_folder,
            "resumed_after": self.resumed_after,
        }
        failure = {"error": self.error, "failed_at": self.failed_at} if self.error else {}
        return summary | failure

    def file_attributes(self) -> dict[str, str | int]:
        """Return the global attributes of the run's file."""
        study = self.study
        return {
            "title": f"dafw study {study.name}",
            "name": study.name,
            "seed": study.seed,
            "dafw_version": self.versions["dafw"],
            "parts": json.dumps(registry().parts(study.parts_by_role)),
            "versions": json.dumps(self.versions),
            **{f"{role}_pinned": json.dumps(options) for role, options in self.pinned.items()},
        }

    def text(self) -> str:
        """Return the summary as JSON."""
        return json.dumps(self.values(), indent=2) + "\n"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def versions_of(study: Study) -> dict[str, str]:
    """Return the versions of Python, of the libraries that matter and of every package of plugins."""
    found = {"python": platform.python_version(), **_library_versions()}
    return found | registry().versions(study.parts_by_role.values())


@cache
def _library_versions() -> Mapping[str, str]:
    found = {}
    for name in VERSIONED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _parameters(parts: Parts, state: State) -> dict[str, dict[str, float | None]]:
    """Return truth, mean and spread of every state variable that is a single number; None if there is no value."""
    belief, truth = state.belief.ensemble, parts.seen(state.truth)
    listed = {}
    for variable in parts.model.space.variables:
        if variable.size == 1:
            place = parts.model.space.slice(variable.name).start
            listed[variable.name] = {
                "truth": _finite(float(truth.members[0, place])) if truth else None,
                "mean": float(belief.mean[place]),
                "spread": float(np.nan_to_num(belief.spread[place])),
            }
    return listed
