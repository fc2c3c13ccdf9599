"""Lorenz-96 as in Sakov and Oke (2008): the scores of the literature, and the speed of the loop against DAPPER's."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.environments import interpreter_with, worker_output
from dafw.core.composition import compose, study_part
from dafw.core.experiment import study_from
from dafw.core.runs import open_run
from dafw.studies.running import run_study

DAPPER = "dapper==1.8.1"
DIVERGED = 1.0  # an RMSE of the analysis above the readings' own error


@dataclass(frozen=True)
class Timed:
    """The wall time and the processor time of a run, and its score.

    The score is the RMSE of the analysis mean averaged over the last five sevenths of the cycles: 1000 of 1400.
    """

    seconds: float
    processor_seconds: float
    rmse: float


def timed_run(overrides: Sequence[str]) -> Timed:
    """Run a study with scores and recording on, and time all of it, set-up included."""
    study = study_from(study_part(compose([*overrides, "free=null", "pictures=false"])))
    with tempfile.TemporaryDirectory() as folder:
        begun, busy = time.perf_counter(), time.process_time()
        run_study(study, Path(folder) / "run")
        seconds, busy = time.perf_counter() - begun, time.process_time() - busy
        with open_run(Path(folder) / "run") as run:
            return Timed(seconds, busy, float(run["rmse"].values[1 + study.cycles * 2 // 7 :].mean()))


def _literature(overrides: Sequence[str], published: float, short: bool) -> Measurement:
    """Return the median score over ten seeds."""
    length = ["cycles=70"] if short else []
    scores = [timed_run([*overrides, f"seed={seed}", *length]).rmse for seed in range(2 if short else 10)]
    detail = {"scores": [round(score, 4) for score in scores], "diverged": sum(s > DIVERGED for s in scores)}
    return Measurement(float(np.median(scores)), "RMSE", published, detail)


@benchmark("l96.etkf_rmse")
def etkf_rmse(short: bool) -> Measurement:
    """ETKF, N = 24, inflation 1.013, rotation: median over ten seeds of the time-averaged RMSE."""
    return _literature(["experiment=lorenz96"], 0.18, short)


@benchmark("l96.etkf_rmse_unit_first_guess")
def etkf_rmse_unit_first_guess(short: bool) -> Measurement:
    """The same with a first guess of variance 1, from which some seeds diverge."""
    return _literature(["experiment=lorenz96", "model.first_guess_sd=1.0"], 0.18, short)


@benchmark("l96.enkf_rmse")
def enkf_rmse(short: bool) -> Measurement:
    """EnKF with perturbed observations, N = 40, inflation 1.06: median over ten seeds of the time-averaged RMSE."""
    return _literature(["experiment=lorenz96_enkf"], 0.22, short)


@benchmark("l96.etkf_over_dapper")
def etkf_over_dapper(short: bool) -> Measurement:
    """Cycles per second of the ETKF over DAPPER's in the same setting, timed alternately; downloads DAPPER once.

    The time of dafw is that of a whole run: set-up, truth, readings, scores, netCDF file and summary. The time of
    DAPPER is that of ``assimilate`` alone. DAPPER has no free run, so dafw's is off.
    """
    cycles, rounds = (70, 1) if short else (1400, 7)
    interpreter_with(DAPPER)  # made before anything is timed
    timed_run(["experiment=lorenz96", "cycles=20"])
    ours, theirs = [], []
    for seed in range(rounds):
        theirs.append(_dapper_run(cycles, seed + 1))
        ours.append(timed_run(["experiment=lorenz96", f"cycles={cycles}", f"seed={seed}"]))
    pairs = list(zip(ours, theirs, strict=True))
    ratios = [their.seconds / our.seconds for our, their in pairs]
    detail = {
        "ratios": [round(ratio, 2) for ratio in ratios],
        # Processor times are more reliable on a busy machine.
        "ratios_of_processor_time": [round(their.processor_seconds / our.processor_seconds, 2) for our, their in pairs],
        "cycles_per_second": [round(cycles / our.seconds) for our in ours],
        "cycles_per_second_dapper": [round(cycles / their.seconds) for their in theirs],
        "cycles": cycles,
    }
    return Measurement(float(np.median(ratios)), "times DAPPER's cycles per second", 5.0, detail)


def _dapper_run(cycles: int, seed: int) -> Timed:
    result = json.loads(worker_output(DAPPER, "dapper_l96.py", [str(cycles), str(seed)]))
    return Timed(result["seconds"], result["processor_seconds"], result["rmse"])
