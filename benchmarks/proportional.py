"""The share of the wind in a run with the proportional closure, whose unit wind depends on the direction alone."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.cycle import PAPER, SMALL
from benchmarks.wind import SEED, cache, case
from dafw.core.composition import compose, study_part
from dafw.core.experiment import study_from
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver
from dafw.studies.running import run_study

PROPORTIONAL = ("model.wind.closure=proportional", "executor=serial")
TOY = ("model.wind.basis.directions=4", "model.wind.basis.modes=20", "model.wind.basis.tolerance=1")


@contextmanager
def wind_calls() -> Iterator[list[float]]:
    """Collect the seconds of every solve of a wind in this process."""
    seconds: list[float] = []
    solve = WindSolver.solve

    def timed(*given: Any, **named: Any) -> Any:
        begun = time.perf_counter()
        try:
            return solve(*given, **named)
        finally:
            seconds.append(time.perf_counter() - begun)

    with patch.object(WindSolver, "solve", timed):
        yield seconds


def run(overrides: list[str], cycles: int) -> dict[str, float]:
    """Return the wall time in seconds of a run after its set-up, and that of its winds."""
    study = study_from(study_part(compose([*overrides, f"cycles={cycles}"])))
    with tempfile.TemporaryDirectory() as folder, wind_calls() as winds:
        summary = run_study(study, Path(folder) / "run")
    phases = summary["phase_seconds"]
    looping = sum(seconds for phase, seconds in phases.items() if phase != "set-up")
    return {
        "cycles": cycles,
        "winds": len(winds),
        "seconds": round(looping, 3),
        "seconds_in_winds": round(sum(winds), 3),
        "share": round(sum(winds) / looping, 4),
        "set_up_seconds": phases["set-up"],
        "err_final": summary["err_final"],
    }


def _share(short: bool, solver: str) -> Measurement:
    size, cycles = ([*SMALL, *TOY], 2) if short else (list(PAPER), 100)
    overrides = [*size, *PROPORTIONAL, f"model.wind.solver={solver}"]
    with cache(short):
        run(overrides, 1)  # so that the basis exists
        cheap = run(overrides, cycles)
        newton = run([*size, *PROPORTIONAL, "model.wind.solver=newton"], min(cycles, 10))
    return Measurement(cheap["share"], "of the run's time in winds", 0.05, {solver: cheap, "newton": newton})


@benchmark("wind.proportional_share_reduced")
def share_reduced(short: bool) -> Measurement:
    """Share of a run's time, without set-up, that reduced winds take with the proportional closure."""
    return _share(short, "reduced")


@benchmark("wind.proportional_share_accelerated")
def share_accelerated(short: bool) -> Measurement:
    """The same for accelerated winds."""
    return _share(short, "accelerated")


@benchmark("wind.proportional_directions")
def directions(short: bool) -> Measurement:
    """Fewest directions of the basis with which unseen winds have at most 1 % error, actual and estimated."""
    from dafw.plugins.models.dispersion.reduced_wind.choice import build
    from dafw.plugins.models.dispersion.reduced_wind.flow import ReducedFlow
    from dafw.plugins.models.dispersion.reduced_wind.velocity_space import VelocitySpace

    measured = case(short)
    options = WindOptions(closure="proportional")
    solver = WindSolver(measured.tagged_mesh, options)
    mass = VelocitySpace(solver.problem, solver.boundary).mass
    unseen = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, 3 if short else 50)
    full = [solver.problem.velocity(solver.solve(options.reference_intensity, direction).unit) for direction in unseen]
    reynolds, detail, fewest = solver.reynolds(options.reference_intensity), {}, 0
    for count in (4,) if short else (4, 8, 12, 16, 24, 32):
        basis = build(measured.tagged_mesh, replace(options, basis=replace(options.basis, directions=count)))
        flow, found = ReducedFlow(basis), []
        for direction, wanted in zip(unseen, full, strict=True):
            wind = flow.solve(reynolds, direction)
            error = basis.velocities @ wind.coefficients - wanted
            found.append((np.sqrt(error @ (mass @ error) / (wanted @ (mass @ wanted))), wind.error))
        actual, estimated = np.array(found).T
        trusted = int(np.count_nonzero(estimated <= options.basis.tolerance))
        detail[f"{count} directions"] = {
            "modes": basis.quadratic.shape[0],
            "median": float(np.median(actual)),
            "largest": float(actual.max()),
            "trusted": trusted,
        }
        if not fewest and actual.max() <= 0.01 and trusted == len(unseen):
            fewest = count
    return Measurement(float(fewest), "directions", float(options.basis.directions), {"unseen": len(unseen), **detail})
