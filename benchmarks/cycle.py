"""Whole cycles of ``enie2d_paper``: against real time and the paper's literal algorithm, and the framework's overhead.

``BEST`` is the fastest configuration. Whole runs of the recommended study (``enie2d``) are compared with real time.
For ratios, the cycles of two runs are run alternately in one process. The first cycle, in which every member's wind is
new, is not counted.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import Measurement, benchmark
from dafw.core.composition import compose, study_part
from dafw.core.cycle import Parts, State, advance, start
from dafw.core.experiment import study_from
from dafw.core.record import Record
from dafw.studies.running import run_study

PAPER = ("experiment=enie2d_paper", "pictures=false")
SMALL = (
    "experiment=enie2d_literal",
    "pictures=false",
    "members=2",
    "model.mesh.wall_size=60",
    "model.mesh.far_size=90",
    "model.wind_speed_sd=0.2",
    "model.wind_direction_sd=0.1",
)
LITERAL = ("model.wind.solver=newton", "model.wind.keep_factorisation=false", "executor=serial")
BEST = ("model.wind.solver=reduced", "executor=serial")
TOY = ("model.wind.keep_factorisation=true", "executor=processes", "executor.workers=1")
"""Replaces ``BEST`` in short runs, which only show that the code works."""
TOY_BASIS = tuple(f"model.wind.basis.{name}" for name in ("directions=4", "levels=1", "modes=6", "tolerance=1"))
"""A basis that is quickly made, for short runs; all of its winds are accepted."""
RECOMMENDED = ("experiment=enie2d", "pictures=false")
TEN_THOUSAND = ("model.mesh.wall_size=5.5", "model.mesh.far_size=14", "model.mesh.transition=120")
"""The paper's mesh of 10,045 nodes."""
TWO_WORKERS = ("executor=processes", "executor.workers=2")


@dataclass
class Run:
    """A study that is run cycle by cycle, without recording."""

    parts: Parts
    state: State
    seconds: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    def cycle(self) -> None:
        """Run one cycle, and store its time and the belief's ERR in per cent."""
        begun = time.perf_counter()
        self.state = advance(self.parts, self.state).state
        self.seconds.append(time.perf_counter() - begun)
        part = self.parts.model.space.slice("concentration")
        belief, truth = self.state.belief.ensemble.mean[part], self.state.truth.ensemble.members[0, part]
        self.errors.append(float(100.0 * np.linalg.norm(belief - truth) / np.linalg.norm(truth)))


@contextmanager
def running(overrides: Sequence[str]) -> Iterator[Run]:
    """Set a study up."""
    study = study_from(study_part(compose(list(overrides))))
    parts, vehicle = study.prepare()
    with parts.executor, threadpool_limits(limits=1, user_api="blas"):
        parts.executor.start(parts.model, study.model_configuration)
        yield Run(parts, start(parts, study.members, vehicle))


def realtime_factor(overrides: Sequence[str], cycles: int, *, warm: bool = True, baseline: float = 1.0) -> Measurement:
    """Return simulated seconds per second of a whole run, set-up and recording included, caches warm.

    Args:
        overrides: of the study.
        cycles: how many are run.
        warm: run one cycle first, so that the caches are warm.
        baseline: the number to be reached.
    """
    study = study_from(study_part(compose([*overrides, f"cycles={cycles}"])))
    with tempfile.TemporaryDirectory() as folder:
        if warm:
            run_study(study_from(study_part(compose([*overrides, "cycles=1"]))), Path(folder) / "warming")
        summary = run_study(study, Path(folder) / "run")
    phases: Mapping[str, float] = summary["phase_seconds"]
    looping = sum(seconds for phase, seconds in phases.items() if phase != "set-up")
    simulated = cycles * study.model.dt
    detail = {
        "members": study.members,
        "without_set_up": round(simulated / looping, 3),
        "phase_seconds": dict(phases),
        "err_final": summary["err_final"],
        "overrides": list(overrides),
    }
    return Measurement(simulated / summary["wall_seconds"], "simulated seconds per second", baseline, detail)


@benchmark("cycle.realtime_factor_n10")
def realtime_factor_n10(short: bool) -> Measurement:
    """Simulated seconds per second of the paper's study with its 10 members."""
    if short:
        return realtime_factor([*SMALL, *TOY], 2, warm=False)
    return realtime_factor([*PAPER, *BEST, "members=10"], 100)


@benchmark("cycle.realtime_factor_n100")
def realtime_factor_n100(short: bool) -> Measurement:
    """Simulated seconds per second of the paper's study with 100 members."""
    if short:
        return realtime_factor([*SMALL, *TOY], 2, warm=False)
    return realtime_factor([*PAPER, *BEST, "executor=processes", "members=100"], 100)


def _recommended(short: bool, baseline: float, *overrides: str, steps: str = "filter.steps") -> Measurement:
    if short:
        coarse = [word for word in SMALL if word.startswith("model.mesh")]
        few = ["members=3", "policy.horizon=3", f"{steps}=6"]
        return realtime_factor([*RECOMMENDED, *TOY_BASIS, *overrides, *coarse, *few], 2, warm=False, baseline=baseline)
    return realtime_factor([*RECOMMENDED, *overrides], 100, baseline=baseline)


@benchmark("cycle.realtime_recommended")
def realtime_recommended(short: bool) -> Measurement:
    """Simulated seconds per second of the recommended study, with all its re-runs: 10 members, 2,715 nodes."""
    return _recommended(short, 10.0)


@benchmark("cycle.realtime_recommended_10k")
def realtime_recommended_10k(short: bool) -> Measurement:
    """The same on 10,045 nodes."""
    return _recommended(short, 3.0, *TEN_THOUSAND, *TWO_WORKERS)


@benchmark("cycle.realtime_coarse_search_10k")
def realtime_coarse_search_10k(short: bool) -> Measurement:
    """The same on 10,045 nodes, with search and plans on 2,715."""
    return _coarse_search(short, 3.0)


@benchmark("cycle.realtime_coarse_search_10k_n100")
def realtime_coarse_search_10k_n100(short: bool) -> Measurement:
    """The same with 100 members, which two processes share."""
    return _coarse_search(short, 1.0, "members=100", *TWO_WORKERS)


def _coarse_search(short: bool, baseline: float, *overrides: str) -> Measurement:
    mesh = ("wall_size=60", "far_size=120") if short else ("wall_size=16", "far_size=24", "transition=100")
    coarser = ["filter=coarse_amis", "policy.coarser=true", *(f"model.coarse_mesh.{word}" for word in mesh)]
    return _recommended(short, baseline, *overrides, *TEN_THOUSAND, *coarser, steps="+filter.base.steps")


@benchmark("cycle.realtime_recommended_10k_n100")
def realtime_recommended_10k_n100(short: bool) -> Measurement:
    """The same on 10,045 nodes with 100 members."""
    return _recommended(short, 1.0, "members=100", *TEN_THOUSAND, *TWO_WORKERS)


@benchmark("cycle.over_literal")
def over_literal(short: bool) -> Measurement:
    """Time of a cycle of the paper's literal algorithm over that of the best configuration, timed alternately."""
    size, best, cycles = (SMALL, TOY, 3) if short else (PAPER, BEST, 16)
    with ExitStack() as stack:
        literal, quick = (stack.enter_context(running([*size, *how])) for how in (LITERAL, best))
        for _ in range(cycles):
            literal.cycle()
            quick.cycle()
    slow, fast = np.array(literal.seconds), np.array(quick.seconds)
    detail = {
        "first_cycle": round(float(slow[0] / fast[0]), 2),
        "median_of_ratios": round(float(np.median(slow[1:] / fast[1:])), 2),
        "seconds_literal": slow.round(4).tolist(),
        "seconds_best": fast.round(4).tolist(),
        "err_literal": np.round(literal.errors, 2).tolist(),
        "err_best": np.round(quick.errors, 2).tolist(),
    }
    # The ratio of the sums, because winds are solved again in some cycles only, and not always in the same ones.
    return Measurement(float(slow[1:].sum() / fast[1:].sum()), "times the literal algorithm's speed", 20.0, detail)


class Stopwatch:
    """Adds up the seconds spent in some calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def on(self, owner: Any, name: str) -> None:
        """Time a method of an object."""
        object.__setattr__(owner, name, self._timed(getattr(owner, name)))

    def _timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*given: Any, **named: Any) -> Any:
            begun = time.perf_counter()
            try:
                return call(*given, **named)
            finally:
                self.seconds += time.perf_counter() - begun

        return timed

    def read(self) -> float:
        """Return the seconds since the last reading."""
        seconds, self.seconds = self.seconds, 0.0
        return seconds


def overhead(overrides: Sequence[str], cycles: int) -> Measurement:
    """Return the milliseconds of a cycle, median without the first, that are neither model step nor filter algebra.

    Recording is listed separately. Its share is the time of all rows and of closing the file, over those cycles.
    """
    watches = {name: Stopwatch() for name in ("model", "filter", "policy", "observer", "record")}
    rows: list[dict[str, float]] = []
    with running(overrides) as run, tempfile.TemporaryDirectory() as folder:
        parts = run.parts
        for model in (parts.model, parts.truth, parts.free):
            watches["model"].on(model, "step_with_memory")
        watches["filter"].on(parts.filter, "analyse_with_memory")
        watches["policy"].on(parts.policy, "decide_with_memory")
        watches["observer"].on(parts.observer, "operator")
        scalars = [variable.name for variable in parts.model.space.variables if variable.size == 1]
        path, section = Path(folder) / "run.nc", np.zeros((0, 2))
        begun = time.perf_counter()
        record = Record(path, parts, run.state, with_members=scalars, section=section, attributes={})
        opening = time.perf_counter() - begun
        watches["record"].on(record, "append")
        for _ in range(cycles):
            begun = time.perf_counter()
            cycle = advance(parts, run.state)
            seconds = time.perf_counter() - begun
            record.append(cycle)
            run.state = cycle.state
            rows.append({name: watch.read() for name, watch in watches.items()} | {"cycle": seconds})
        begun = time.perf_counter()
        record.close()
        recording = time.perf_counter() - begun + sum(row["record"] for row in rows)
    taken = {name: 1e3 * np.array([row[name] for row in rows[1:]]) for name in rows[0]}
    around = taken["cycle"] - taken["model"] - taken["filter"]
    framework = around - taken["policy"] - taken["observer"]
    detail = {f"{name}_ms": round(float(np.median(values)), 4) for name, values in taken.items()}
    detail["without_policy_and_observer_ms"] = round(float(np.median(framework)), 4)
    detail["record_share_percent"] = round(float(1e5 * recording / taken["cycle"].sum()), 2)
    detail["opening_the_record_ms"] = round(1e3 * opening, 1)
    return Measurement(float(np.median(around)), "ms a cycle", 1.0, detail)


@benchmark("cycle.overhead_ms")
def overhead_ms(short: bool) -> Measurement:
    """Median milliseconds of a cycle outside the model's step and the filter; the detail lists recording separately."""
    return overhead([*SMALL, *LITERAL], 2) if short else overhead([*PAPER, *BEST], 61)
