"""The wind: the speed and the accuracy of the fast solvers.

The winds are those that a run of ``enie2d_paper`` (seed 0, reduced winds) solved, in the same order, each starting from
the member's last wind (``winds_of_a_run.csv``, written by ``record_winds.py``). The baseline is warm Newton: it starts
from the member's last wind, with a new Jacobian and factorisation in each iteration. See docs/fast-winds.md.
"""

from __future__ import annotations

import csv
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import Measurement, benchmark
from dafw.plugins.models.dispersion.mesh.generate import generate
from dafw.plugins.models.dispersion.mesh.load import load
from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import load_site
from dafw.plugins.models.dispersion.wind.options import BasisOptions, WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver
from dafw.plugins.models.dispersion.wind_solvers import wind_solver

PAPER = MeshOptions(wall_size=5.5, far_size=14.0, transition=120.0)
"""That of ``enie2d_paper``: 10,000 nodes."""
UNSEEN, SEED = 200, 20261122
"""Number of winds whose error is measured; they were not used to tune the solver."""
BANDS = (0.0, 3.0, 6.0, 12.0)
"""Ranges of the wind speed (m/s) for which errors are listed."""


def timed[**P, T](action: Callable[P, T], *given: P.args, **named: P.kwargs) -> tuple[T, float]:
    """Return an action's result and its processor time in seconds, which other load affects less than wall time."""
    begun = time.process_time()
    done = action(*given, **named)
    return done, time.process_time() - begun


@contextmanager
def cache(short: bool) -> Iterator[None]:
    """Use a temporary cache instead of the user's for short runs."""
    if not short:
        yield
        return
    kept = os.environ.get("DAFW_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DAFW_CACHE"] = folder
        try:
            yield
        finally:
            del os.environ["DAFW_CACHE"]
            if kept is not None:
                os.environ["DAFW_CACHE"] = kept


@dataclass(frozen=True)
class Case:
    """One mesh and the solvers on it."""

    tagged_mesh: TaggedMesh
    options: WindOptions

    @cached_property
    def newton(self) -> WindSolver:
        """Warm Newton."""
        return WindSolver(self.tagged_mesh, replace(self.options, keep_factorisation=False))

    @cached_property
    def accelerated(self) -> Any:
        """The accelerated solver."""
        return wind_solver(self.tagged_mesh, replace(self.options, solver="accelerated"))

    @cached_property
    def reduced(self) -> Any:
        """The reduced solver."""
        return wind_solver(self.tagged_mesh, replace(self.options, solver="reduced"))


@lru_cache
def case(short: bool) -> Case:
    """Return the paper's mesh, or for short runs a few tanks of the plant with a small basis."""
    with cache(short):
        if not short:
            made = Case(load(generate(load_site(SiteOptions()), PAPER)), WindOptions())
        else:
            site = load_site(SiteOptions(bounds=[7.995, 50.0005, 7.9975, 50.0022]))
            mesh = load(generate(site, MeshOptions(wall_size=30.0, far_size=60.0, across=1)))
            basis = BasisOptions(directions=4, levels=2, max_intensity=8.0, modes=20, tolerance=1.0)
            made = Case(mesh, WindOptions(basis=basis))
        _ = made.accelerated, made.reduced  # make both while the temporary cache exists
    return made


def re_solves(
    case: Case, every: int, count: int | None
) -> Iterator[tuple[float, float, np.ndarray | None, float, bool]]:
    """Replay the run with the accelerated solver; yield intensity, direction, start, seconds and whether to time it.

    All winds are solved, so that the solver keeps the same factorisations as in the run.
    """
    file = Path(__file__).parent / "winds_of_a_run.csv"
    with file.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))[:count]
    units: list[np.ndarray] = []
    for number, row in enumerate(rows):
        intensity, direction = float(row["intensity"]), float(row["direction"])
        start = units[int(row["start"])] if row["start"] else None
        found, seconds = timed(case.accelerated.solve, intensity, direction)
        units.append(found.unit)
        yield intensity, direction, start, seconds, start is not None and number % every == 0


def _over_newton(short: bool, cheap: str) -> Measurement:
    measured = case(short)
    times: list[tuple[float, float]] = []
    for intensity, direction, start, accelerated, counts in re_solves(
        measured, 1 if short else 4, 13 if short else None
    ):
        if not counts:
            continue
        _, warm = timed(measured.newton.solve, intensity, direction, start)
        seconds = accelerated
        if cheap == "reduced":
            _, seconds = timed(measured.reduced.solve, intensity, direction)
        times.append((warm, seconds))
    warm_times, cheap_times = np.array(times).T
    ratios = warm_times / cheap_times
    detail = {
        "re_solves": len(ratios),
        "quartiles": np.quantile(ratios, [0.25, 0.75]).round(2).tolist(),
        "ratio_of_sums": round(float(warm_times.sum() / cheap_times.sum()), 2),
        "median_ms_newton": round(1e3 * float(np.median(warm_times)), 1),
        f"median_ms_{cheap}": round(1e3 * float(np.median(cheap_times)), 2),
    }
    goal = 5.0 if cheap == "accelerated" else 110.0
    return Measurement(float(np.median(ratios)), "times warm Newton's speed", goal, detail)


@benchmark("wind.accelerated_over_newton")
def accelerated_over_newton(short: bool) -> Measurement:
    """Time of warm Newton over the accelerated solver's, to the same tolerance: median over the re-solves of a run."""
    return _over_newton(short, "accelerated")


@benchmark("wind.reduced_over_newton")
def reduced_over_newton(short: bool) -> Measurement:
    """The same for the reduced solver, including its error estimate."""
    return _over_newton(short, "reduced")


def draws(count: int, strongest: float) -> list[tuple[float, float]]:
    """Return winds with speeds from the paper's first guess, at most ``strongest``, and uniform directions."""
    from dafw.core.priors import Prior

    speeds, rng = Prior("weibull", {"mean": 2.5, "sd": 3.0}), np.random.default_rng(SEED)
    found: list[tuple[float, float]] = []
    while len(found) < count:
        speed = speeds.draw(rng)
        if speed <= strongest:
            found.append((speed, float(rng.uniform(0.0, 2.0 * np.pi))))
    return found


@dataclass(frozen=True)
class Errors:
    """Winds that are not in the basis: intensities (m/s), relative L2 errors and their estimates, (count,) each."""

    intensities: np.ndarray
    actual: np.ndarray
    estimated: np.ndarray

    def listed(self, tolerance: float, chosen: np.ndarray | slice = slice(None)) -> dict[str, Any]:
        """Return the table's figures for the chosen winds."""
        actual, estimated = self.actual[chosen], self.estimated[chosen]
        if not actual.size:
            return {"winds": 0}
        trusted = estimated <= tolerance
        return {
            "winds": actual.size,
            "not_trusted": int(np.count_nonzero(~trusted)),
            "median": float(np.median(actual)),
            "p95": float(np.quantile(actual, 0.95)),
            "largest": float(actual.max()),
            "largest_trusted": float(actual[trusted].max(initial=0.0)),
            "estimate_over_error": np.quantile(estimated / actual, [0.0, 0.5, 1.0]).round(2).tolist(),
        }


@lru_cache
def errors(short: bool) -> tuple[Errors, Errors]:
    """Return the errors of the solver, which uses as many modes as it needs, and those with all modes."""
    from dafw.plugins.models.dispersion.reduced_wind.velocity_space import VelocitySpace

    measured = case(short)
    problem, flow = measured.newton.problem, measured.reduced.flow
    mass = VelocitySpace(problem, measured.newton.boundary).mass
    solver, all_modes = [], []
    for intensity, direction in draws(4 if short else UNSEEN, measured.options.basis.max_intensity):
        full = problem.velocity(measured.accelerated.solve(intensity, direction).unit)  # to Newton's own tolerance
        for found, accepted in ((solver, measured.options.basis.tolerance), (all_modes, 0.0)):
            wind = flow.solve(measured.newton.reynolds(intensity), direction, accepted)
            error = flow.basis.velocities @ wind.coefficients - full
            found.append((intensity, np.sqrt(error @ (mass @ error) / (full @ (mass @ full))), wind.error))
    return Errors(*np.array(solver).T), Errors(*np.array(all_modes).T)


def _error(short: bool, share: float) -> Measurement:
    solver, all_modes = errors(short)
    tolerance = case(short).options.basis.tolerance
    detail = {"seed": SEED, "solver": solver.listed(tolerance), "all_modes": all_modes.listed(tolerance)}
    for least, most in pairwise(BANDS):
        within = (least <= solver.intensities) & (solver.intensities < most)
        detail[f"solver, {least:g} to {most:g} m/s"] = solver.listed(tolerance, within)
    return Measurement(float(np.quantile(solver.actual, share)), "relative L2 error of the velocity", 0.01, detail)


@benchmark("wind.reduced_error_median")
def reduced_error_median(short: bool) -> Measurement:
    """Median error of reduced winds, over 200 winds that were not used for the basis."""
    return _error(short, 0.5)


@benchmark("wind.reduced_error_p95")
def reduced_error_p95(short: bool) -> Measurement:
    """The 95 % quantile of these errors."""
    return _error(short, 0.95)
