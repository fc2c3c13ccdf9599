"""Truths that the model cannot be: amis, the same with local corrections, and the floor.

``python -m benchmarks.mismatch [overrides] [--truths T ...] [--seeds S ...] [--no-floor]`` prints a table.

All beliefs of a truth and a seed are given the same readings, so that the estimation is compared and not the search:
a drone that knows the truth flies to and fro through the true cloud. ``amis`` inside of ``local`` has the bits of
``amis`` alone, so one run gives both. The floor is that of ``dafw.studies.floor``: what constant wind and diffusion
reach at best.

The column "perfect near" says what a local correction could reach at most: the ERR of ``amis`` if its field were made
right at all nodes within 20 m of a place read in the last 20 s. The places have moved with the middle of the cloud.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dafw.core.composition import compose, study_part
from dafw.core.diagnostics import error_of
from dafw.core.ensemble import Ensemble
from dafw.core.experiment import study_from
from dafw.core.space import Array
from dafw.core.study import Study
from dafw.plugins.observers.none import NoObserver
from dafw.plugins.policies.stationary import Stationary
from dafw.plugins.readings.listed import Listed
from dafw.studies.floor import floor_of

BELIEF = ("experiment=enie2d", "filter=local_amis", "pictures=false", "free=null")
# One wind is solved for the truth: in full, because a reduced basis of its own would take longer.
NEWTON = "truth.wind.solver=newton"
GALERKIN = ("truth.transport.scheme=galerkin", "truth.transport.solver=iterative")
TRUTHS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "changing_wind": (
        "truth.wind_change.kind=prescribed",
        "truth.wind_change.veer=0.2618",
        "truth.wind_change.gust=0.2",
    ),
    "viscosity_doubled": (NEWTON, "truth.wind.viscosity=50"),
    "viscosity_halved": (NEWTON, "truth.wind.viscosity=12.5"),
    "finer_mesh": (
        NEWTON,
        *GALERKIN,
        "truth.mesh.wall_size=5.5",
        "truth.mesh.far_size=14",
        "truth.mesh.transition=120",
    ),
    "galerkin": GALERKIN,
    "release_off": ("truth.release=[272.1,86.1]",),
    "amount_off": ("truth.source.amount=1.3",),
    "sensor_lag": (),
}
LAG = {"sensor_lag": 5.0}
"""Time constants of slow sensors, s."""
WIDE, NEAR = 1.6, 10.0
"""How far from the middle of the cloud the drone turns, in its standard deviations, and when it has arrived, in m."""

REACH, RECENT = 20.0, 20.0
"""Metres and seconds within which a reading says something about the present field."""


def truth_of(study: Study) -> tuple[Array, Array]:
    """Return the truth (T, n) after each cycle in the belief's state space, and its first variable (T, nodes)."""
    parts, _ = study.prepare()
    if parts.truth is None:
        raise ValueError("the study has no truth")
    streams, states = parts.streams, []
    now = parts.truth.first_guess(1, streams.members("initial truth", 0))
    for cycle in range(study.cycles):
        now = parts.truth.forecast(now.ensemble, now.memory, streams.members("truth error", cycle))
        seen = parts.seen(now)
        states.append(np.empty(0) if seen is None else seen.members[0])
    truth = np.array(states)
    return truth, truth[:, study.model.space.slice(study.model.space.variables[0].name)]


def route(fields: Array, nodes: Array, study: Study, rng: np.random.Generator, samples: int = 2) -> Array:
    """Return the places (T, samples, 2) that a drone passes which flies to and fro through the true cloud."""
    position, offset = np.array(study.start[0], dtype=np.float64), None
    reach = study.speed * study.model.dt / samples
    places = np.empty((len(fields), samples, 2))
    for cycle, field in enumerate(fields):
        gas, middle = np.maximum(field, 0.0), middles(field[np.newaxis], nodes)[0]
        spread = np.sqrt(gas @ (nodes - middle) ** 2 / gas.sum())
        if offset is None or np.linalg.norm(middle + offset - position) < NEAR:
            offset = rng.uniform(-WIDE, WIDE, 2) * spread
        for sample in range(samples):
            way = middle + offset - position
            position = position + way * min(1.0, reach / max(float(np.linalg.norm(way)), 1e-9))
            places[cycle, sample] = position
    return places


def middles(fields: Array, nodes: Array) -> Array:
    """Return the middle of the gas (T, 2) in m after each cycle."""
    gas = np.maximum(fields, 0.0)
    return np.asarray(gas @ nodes / gas.sum(axis=1, keepdims=True))


def near_readings(study: Study, fields: Array, listed: Listed) -> NDArray[np.bool_]:
    """Return which nodes (n,) are within ``REACH`` of a reading of the last ``RECENT`` seconds, moved with the gas."""
    nodes = np.asarray(study.model.space.variables[0].coordinates)
    centres, near = middles(fields, nodes), np.zeros(len(nodes), dtype=bool)
    for reading in listed.readings:
        cycle = round(reading["time"] / study.model.dt) - 1
        if cycle >= len(fields) - RECENT / study.model.dt:
            place = np.array([reading["x"], reading["y"]]) + centres[-1] - centres[cycle]
            near |= np.linalg.norm(nodes - place, axis=1) <= REACH
    return near


def readings(fields: Array, study: Study, lag: float, sd: float = 1e-3) -> Listed:
    """Return what the drone reads at the nodes nearest to its places; every node once a cycle."""
    variable, rng = study.model.space.variables[0], np.random.default_rng([study.seed, 7])
    nodes = np.asarray(variable.coordinates)
    listed, shown = [], 0.0
    for cycle, places in enumerate(route(fields, nodes, study, np.random.default_rng(study.seed))):
        found = variable.nearest(places)
        for number, node in enumerate(found):
            met = fields[cycle, node]
            shown = met + (shown - met) * np.exp(-study.model.dt / len(found) / lag) if lag else met
            if node not in found[:number]:
                value, (x, y) = shown + sd * rng.standard_normal(), nodes[node]
                at = {"x": float(x), "y": float(y), "sd": sd}
                listed.append({"time": (cycle + 1) * study.model.dt, "value": float(value), **at})
    return Listed(readings=listed)


@dataclass(frozen=True)
class Result:
    """ERR at the end in per cent, and the gas of both beliefs relative to the truth's (sums over the nodes).

    ``perfect`` is the ERR of ``amis`` if it were made right near the readings.
    """

    amis: float
    local: float
    perfect: float
    gas_amis: float
    gas_local: float


def compared(name: str, seed: int, overrides: Sequence[str]) -> Result:
    """Return the result of one truth and one seed."""
    study = study_from(study_part(compose([*BELIEF, *TRUTHS[name], *overrides, f"seed={seed}"])))
    truth, fields = truth_of(study)
    listed = readings(fields, study, LAG.get(name, 0.0))
    study.readings, near = listed, near_readings(study, fields, listed)
    study.truth, study.policy, study.observer, study.start = None, Stationary(), NoObserver(), ()
    *_, last = tqdm(study, total=study.cycles, desc=f"{name}, seed {seed}", unit="cycle", disable=None, leave=False)
    memory, belief = last.state.filter_memory or {}, last.belief
    base = Ensemble(memory["members"], belief.space, weights=memory.get("weights"))
    part = belief.space.slice(belief.space.variables[0].name)
    errors = [error_of(belief.space, truth[-1], one.mean) for one in (base, belief)]
    missed = np.where(near, 0.0, base.mean[part] - fields[-1])
    errors.append(100.0 * float(np.linalg.norm(missed) / np.linalg.norm(fields[-1])))
    gas = [float(one.mean[part].sum() / fields[-1].sum()) for one in (base, belief)]
    return Result(*errors, *gas)


def main(words: Sequence[str] | None = None) -> int:
    """Run, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mismatch", description="Local corrections and floors.")
    parser.add_argument("--truths", nargs="+", default=list(TRUTHS), choices=list(TRUTHS), help="which truths")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1000, 1001, 1002], help="seeds of route and belief")
    parser.add_argument("--no-floor", action="store_true", help="do not search for the floors")
    asked, overrides = parser.parse_known_args(words)
    print("| truth | floor | amis | with local corrections | perfect near | gas | gas, corrected |")
    print("|---|---|---|---|---|---|---|")
    for name in asked.truths:
        floor = "-"
        if not asked.no_floor:
            made = compose([*BELIEF, *TRUTHS[name], *overrides])
            floor = f"{floor_of(study_from(study_part(made))).err:.1f} %"
        found = [compared(name, seed, overrides) for seed in asked.seeds]
        columns = [
            ", ".join(f"{getattr(one, key):.1f}" for one in found) + " %" for key in ("amis", "local", "perfect")
        ]
        columns += [", ".join(f"{getattr(one, key):.2f}" for one in found) for key in ("gas_amis", "gas_local")]
        print(f"| {name} | {floor} | " + " | ".join(columns) + " |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
