"""A truth and a drone that obeys: what stands on the other side of the feed in a rehearsal.

The truth, its readings and their noise are those of the twin study with the same seed. The vehicles fly where the
advice of the run says, and the feed says what they read and where they are.

With ``clock=feed`` both sides wait for each other, so the readings are those of the twin to the last bit. With
``clock=wall`` time passes: the vehicles hover until the advice for a cycle has come, and fly for the rest of it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import dist
from typing import Any

import numpy as np

from dafw.core.cycle import TRUTH_ERROR, Parts
from dafw.core.ensemble import Route, Vehicle
from dafw.core.errors import ComputationError
from dafw.core.interfaces.readings import Request
from dafw.core.observation import Interpolation, Observation, Selection
from dafw.core.space import Array
from dafw.plugins.readings.feed.channels import Channel
from dafw.plugins.readings.live import Live
from dafw.studies.truth_file import TruthFile

LOOK = 0.2
"""Seconds between two looks whether anybody still reads the feed."""


class Advised:
    """The advice that comes as lines of a channel: the file in the run's folder, or a broker's topic."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def next(self, seconds: float) -> dict[str, Any] | None:
        """Return the next piece of advice; None if there is none, or if a line is no advice."""
        line = self._channel.next(seconds)
        try:
            advice = None if line is None else json.loads(line.text)
        except (ValueError, RecursionError):
            return None
        return advice if isinstance(advice, dict) else None


@dataclass
class Simulation:
    """Plays ``cycles`` cycles of a twin's truth into ``send``, which takes messages, and raises BrokenPipeError.

    ``parts`` and ``vehicle`` are those of the twin study, ``live`` says how the run understands messages. ``adviser``
    is None where there are no vehicles and the run need not be waited for. ``listened`` returns whether anybody still
    reads. ``patience``: seconds without advice after which the simulation gives up.
    """

    parts: Parts
    vehicle: Vehicle
    live: Live
    cycles: int
    send: Callable[[dict[str, Any]], None]
    adviser: Advised
    truth: TruthFile
    patience: float = 600.0
    listened: Callable[[], bool] = lambda: True
    readings: int = 0
    begun: bool = False

    def play(self) -> int:
        """Return how many cycles were played; raises ComputationError if no advice comes."""
        parts, streams = self.parts, self.parts.streams
        assert parts.truth is not None
        truth = parts.truth.first_guess(1, streams.members("initial truth", 0))
        memory = parts.readings.initial_memory()
        self.truth.append(_seen(parts, truth))
        zero = None
        for cycle in range(self.cycles):
            now = truth.ensemble.time
            advice = self._advice(cycle, None if zero is None else zero + now + parts.model.dt)
            if advice is not None and advice.get("end"):
                return cycle
            self.begun = True
            if self.live.clock == "wall" and zero is None and advice is not None:
                zero = datetime.fromisoformat(advice["date"]).timestamp() - advice["time"]
            left = parts.model.dt if zero is None else max(0.0, zero + now + parts.model.dt - time.time())
            route = obeyed(self.vehicle, advice, min(left, parts.model.dt))
            operator = parts.observer.look(parts.model.space, route, now)
            truth = parts.truth.forecast(truth.ensemble, truth.memory, streams.members(TRUTH_ERROR, cycle))
            seen = _seen(parts, truth)
            request = Request(cycle, now, seen.time, parts.model.space, parts.model.domain, operator, seen)
            taken = parts.readings.collect(request, memory, streams.generator("observation noise", cycle))
            memory = taken.memory
            self.vehicle = self.vehicle.moved(route.ends) if route.paths else self.vehicle
            self.truth.append(seen)
            if zero is not None:
                time.sleep(max(0.0, zero + seen.time - time.time()))
            for message in self._messages(taken.observations, seen.time, zero):
                self.send(message)
        self.send({"end": True})
        return self.cycles

    def _advice(self, cycle: int, deadline: float | None) -> dict[str, Any] | None:
        """Return the advice for a cycle; None if it has not come by the ``deadline``, a Unix time, or None: none."""
        silent = time.monotonic() + self.patience
        while deadline is None or time.time() < deadline:
            advice = self.adviser.next(LOOK if deadline is None else min(LOOK, max(0.0, deadline - time.time())))
            if advice is not None and (advice.get("cycle") == cycle or (advice.get("end") and cycle > 0)):
                return advice
            if not self.listened():
                raise BrokenPipeError
            if time.monotonic() > silent:
                raise ComputationError(f"no advice for cycle {cycle} came within {self.patience:g} s")
        return None

    def _messages(self, observations: Sequence[Observation], end: float, zero: float | None) -> list[dict[str, Any]]:
        """Return what the vehicles and sensors send at the end of a cycle."""
        space, live = self.parts.model.space, self.live
        variable = space.variables[0] if live.variable is None else space[live.variable]
        found = []
        for one in observations:
            places = places_of(one, space.slice(variable.name).start, live)
            sensors = one.operator.sensors or [""] * one.values.size
            for value, sd, place, sensor in zip(one.values, np.sqrt(one.variance), places, sensors, strict=True):
                told = {"time": _stamp(one.time, zero), **place, "value": float(value), "sd": float(sd)}
                told |= {"unit": variable.units} if variable.units != "1" else {}
                found.append(told | ({"sensor": sensor} if sensor else {}))
        self.readings += len(found)
        for number, (x, y) in enumerate(self.vehicle.positions.tolist()):
            name = live.vehicles[number] if live.vehicles else f"drone {number}"
            found.append({"time": _stamp(end, zero), "x": x, "y": y, "sensor": name})
        renamed = {
            role: getattr(live.columns, role, None) or role for role in ("time", "x", "y", "entry", "value", "sd")
        }
        renamed |= {role: getattr(live.columns, role) or role for role in ("unit", "sensor")}
        return [
            *({renamed[role]: value for role, value in told.items()} for told in found),
            {"until": _stamp(end, zero)},
        ]


def _seen(parts: Parts, truth: Any) -> Any:
    """Return a truth in the belief's state space."""
    return parts.seen(truth)


def _stamp(seconds: float, zero: float | None) -> float | str:
    return seconds if zero is None else datetime.fromtimestamp(zero + seconds, UTC).isoformat()


def places_of(observation: Observation, start: int, live: Live) -> list[dict[str, float]]:
    """Return where each reading was taken: x and y, or the entry of the variable, which begins at ``start``.

    Readings of named entries or paths of the run need no place. Raises ComputationError for a reading that a message
    cannot place.
    """
    operator = observation.operator
    if live.entries or live.paths:
        return [{} for _ in observation.values]
    # What reads more than the corners of a triangle reads no place, but the mean along a line.
    placed = isinstance(operator, Selection) or (isinstance(operator, Interpolation) and operator.weights.shape[1] <= 3)
    places = operator.coordinates
    if placed and places is not None and places.shape[1] == 2 and np.isfinite(places).all():
        return [{"x": x, "y": y} for x, y in places.tolist()]
    if isinstance(operator, Selection):
        return [{"entry": int(index) - start} for index in operator.indices]
    raise ComputationError("the observer has readings that no message can place: give readings.entries or paths")


def obeyed(vehicle: Vehicle, advice: dict[str, Any] | None, seconds: float) -> Route:
    """Return the way that vehicles fly in so many seconds: along the waypoints, as far as they get."""
    told = {} if advice is None else {one["vehicle"]: one.get("waypoints", []) for one in advice["vehicles"]}
    paths = []
    for number, position in enumerate(vehicle.positions):
        way = [position, *np.array(told.get(number, []), dtype=np.float64).reshape(-1, 2)]
        paths.append(_cut(way, vehicle.speed * seconds))
    return Route(tuple(paths), dt=vehicle.dt)


def _cut(way: list[Array], reach: float) -> Array:
    """Return the beginning of a way (k, 2), at most so many metres long."""
    path, left = [way[0]], reach
    for point in way[1:]:
        length = dist(path[-1], point)
        if length > left + 1e-9 * reach:
            path.append(path[-1] + (point - path[-1]) * (left / length))
            break
        path.append(point)
        left -= length
    return np.array(path)


def line_of(message: dict[str, Any]) -> bytes:
    """Return a message as a line of JSON; numbers are read again to the last bit."""
    return json.dumps(message).encode() + b"\n"
