"""Advice: before each cycle where the vehicles should fly, and what the belief is, as a line of JSON.

docs/live.md describes the lines. A live run writes them to ``advice.jsonl`` in its folder; the option ``advice`` names
further places. A place that nobody reads, or that cannot be written, costs a warning and never the run; only the
run's own file must be written.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from time import time
from typing import Any, BinaryIO

import numpy as np

from dafw.core.cycle import Parts, State
from dafw.core.domain import node_areas
from dafw.core.ensemble import Ensemble, Route
from dafw.core.errors import RecordError
from dafw.core.geography import to_degrees
from dafw.core.space import Kind, StateSpace
from dafw.core.study import Study
from dafw.studies.reporting import warn_once

FILE = "advice.jsonl"
QUANTILES = (0.05, 0.5, 0.95)
EXTENT = 0.1
"""The gas is where the mean is above this share of its maximum."""


class Advice:
    """Writes the advice of one run; does nothing for a study that is not live and names no place for it."""

    def __init__(self, study: Study, parts: Parts, folder: Path) -> None:
        self._parts, self._folder = parts, folder
        self._stream: BinaryIO | None = None
        self._ways: dict[str, Callable[[bytes], None]] = {}
        self._warned: set[str] = set()
        self._ended = False
        self._known = 0
        if not (study.readings.is_live or study.advice):
            return
        for place in dict.fromkeys([*study.advice, *study.readings.advises]):
            self._ways[place] = _way_to(place, parts)
        self._known = study.readings.known_cycles()
        try:
            self._stream = (folder / FILE).open("a+b", buffering=0)
            _end_line(self._stream)
        except OSError as error:
            raise RecordError(f"{folder / FILE}: cannot be written ({error.strerror or error})") from error

    def give(self, state: State, route: Route) -> None:
        """Write where the vehicles should fly in the cycle after ``state``, and what is believed.

        Not for a cycle that the journal of a run that goes on knows: it is past, and was advised before.
        """
        if self._stream is not None and state.cycle >= self._known:
            self._write(advice_of(self._parts, state, route))

    def end(self, state: State) -> None:
        """Write the belief after the last cycle, and that there will be no more advice."""
        if self._stream is not None:
            self._write(advice_of(self._parts, state, None) | {"end": True})
            self._ended = True

    def close(self) -> None:
        """Close the file; of a run that did not reach its end, say that there will be no more advice."""
        if self._stream is None:
            return
        try:
            if not self._ended:
                with suppress(RecordError):  # another error has ended the run already
                    self._write({"end": True})
        finally:
            self._stream.close()
            self._stream = None

    def _write(self, advice: Mapping[str, Any]) -> None:
        line = json.dumps(advice, allow_nan=False).encode() + b"\n"
        assert self._stream is not None
        try:
            self._stream.write(line)
        except OSError as error:
            raise RecordError(f"{self._folder / FILE}: cannot be written ({error.strerror or error})") from error
        for place, write in self._ways.items():
            try:
                write(line)
            except OSError as error:
                text = f"advice does not reach {place} ({error.strerror or error}); it is in {FILE}"
                warn_once(self._warned, place, text)


def _way_to(place: str, parts: Parts) -> Callable[[bytes], None]:
    """Return what writes a line to standard output, to a file or named pipe, or to a broker's topic."""
    if place == "-":
        return _to_standard_output
    if place == "mqtt":
        return parts.readings.publisher()
    path = Path(place).expanduser()

    def to_path(line: bytes) -> None:
        # A named pipe that nobody reads is no reason to wait.
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NONBLOCK, 0o644)
        try:
            os.write(descriptor, line)
        finally:
            os.close(descriptor)

    return to_path


def _end_line(stream: BinaryIO) -> None:
    """End a line that was being written when a run was killed."""
    if stream.seek(0, os.SEEK_END) > 0:
        stream.seek(-1, os.SEEK_END)
        if stream.read(1) != b"\n":
            stream.write(b"\n")


def _to_standard_output(line: bytes) -> None:
    sys.stdout.write(line.decode())
    sys.stdout.flush()


def advice_of(parts: Parts, state: State, route: Route | None) -> dict[str, Any]:
    """Return the advice after ``state`` as plain values; ``route`` is where the vehicles should fly, None: nowhere."""
    belief, domain = state.belief.ensemble, parts.model.domain
    origin = None if domain is None else domain.origin
    told: dict[str, Any] = {"cycle": state.cycle, "time": belief.time}
    zero = parts.readings.zero_of_run(state.readings_memory)
    if zero is not None:
        told["date"] = datetime.fromtimestamp(zero + belief.time, UTC).isoformat()
        if parts.readings.follows_wall:
            told["behind"] = max(0.0, time() - zero - belief.time)
    told["vehicles"] = []
    for number, position in enumerate(state.vehicle.positions):
        one = {"vehicle": number, "at": position.tolist()}
        if origin is not None:
            one["at_lonlat"] = to_degrees(position, origin).tolist()
        if route is not None:
            way = route.paths[number][1:]
            one["waypoints"] = way.tolist()
            if origin is not None:
                one["waypoints_lonlat"] = to_degrees(way, origin).tolist()
        told["vehicles"].append(one)
    if route is not None:
        told["until"] = belief.time + parts.model.dt
    told["belief"] = {"members": len(belief), "parameters": parameters_of(belief)}
    gas, confidence = gas_of(belief, None if domain is None else domain.triangles, origin)
    if gas:
        told["belief"]["gas"] = gas
    told["confidence"] = {"effective_members": belief.effective_size, **confidence}
    return told


def parameters_of(belief: Ensemble) -> dict[str, dict[str, Any]]:
    """Return by name the mean, spread and quantiles of every variable that is one number."""
    single = [variable for variable in belief.space.variables if variable.size == 1]
    if not single:
        return {}
    places = [belief.space.slice(variable.name).start for variable in single]
    part = Ensemble(belief.members[:, places], StateSpace(single), belief.time, belief.weights)
    quantiles = {f"q{100 * level:02.0f}": part.quantile(level) for level in QUANTILES}
    return {
        variable.name: {
            "mean": float(part.mean[row]),
            "spread": _finite(part.spread[row]),
            **{name: float(values[row]) for name, values in quantiles.items()},
            "units": variable.units,
        }
        for row, variable in enumerate(single)
    }


def gas_of(
    belief: Ensemble, triangles: Any, origin: tuple[float, float] | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return where the gas is, and how sure that is.

    The centre is that of the mean field, weighted by the areas of the nodes; the extent is the rectangle of the nodes
    at which it exceeds EXTENT of its maximum. ``centre_sd`` is how far the members' own centres are from it, the root
    of the mean square, in m. ``expected_error`` is the size of the spread as a share of the mean's in percent: the ERR
    that an honest belief expects. Only for a first variable that cannot be negative and has places in the plane.
    """
    variable = belief.space.variables[0]
    part = belief.space.slice(variable.name)
    mean, spread = belief.mean[part], belief.spread[part]
    size = float(np.linalg.norm(mean))
    certain = {"expected_error": _finite(100.0 * float(np.linalg.norm(spread)) / size)} if size > 0.0 else {}
    nodes = variable.coordinates
    if variable.kind is not Kind.NONNEGATIVE or nodes is None or nodes.shape[1] != 2 or not mean.max() > 0.0:
        return {}, certain
    area = np.ones(len(nodes)) if triangles is None else node_areas(np.asarray(nodes), triangles)
    centre = (area * mean) @ nodes / (area @ mean)
    masses = belief.members[:, part] @ area
    there = masses > 0.0
    off = (belief.members[there][:, part] * area) @ nodes / masses[there, np.newaxis] - centre
    weights = np.full(len(belief), 1.0 / len(belief)) if belief.weights is None else belief.weights
    share = weights[there]
    inside = np.asarray(nodes)[mean > EXTENT * mean.max()]
    low, high = inside.min(axis=0), inside.max(axis=0)
    gas = {"variable": variable.name, "centre": centre.tolist(), "extent": [*low.tolist(), *high.tolist()]}
    if origin is not None:
        gas["centre_lonlat"] = to_degrees(centre, origin).tolist()
        gas["extent_lonlat"] = [*to_degrees(low, origin).tolist(), *to_degrees(high, origin).tolist()]
    if share.sum() > 0.0:
        certain["centre_sd"] = float(np.sqrt(share @ (off**2).sum(axis=1) / share.sum()))
    return gas, certain


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
