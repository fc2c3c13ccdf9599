"""Running a study: cycles, record, log, progress, summary and pictures, in one folder."""

from __future__ import annotations

import json
import logging
import math
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from dafw.core.cycle import Parts, State, advance, start
from dafw.core.ensemble import Vehicle
from dafw.core.errors import ConfigurationError, DafwError, RecordError, RunError
from dafw.core.experiment import Study, assemble
from dafw.core.files import claim, write_whole
from dafw.core.record import Record
from dafw.studies.reporting import log_domain, log_file, postfix, progress, sentence
from dafw.studies.stopping import Interrupted, Stop, stop_signals

log = logging.getLogger("dafw")
VERSIONED = ("dafw", "numpy", "scipy", "dolfinx-solver-real", "gmsh", "netcdf4", "xarray", "hydra-core")
LOG_SECONDS = 0.2
SUMMARY_SECONDS = 10.0


def run_study(study: Study, folder: Path, communicator: Any = None) -> dict[str, Any]:
    """Run a study into ``folder`` and return its summary; on rank 0 of an MPI communicator, if there is one.

    Whatever happens, the cycles that were finished stay in ``run.nc`` and ``summary.json`` says how it ended. Raises
    RunError where the folder holds a run already, DafwError where a computation failed, Interrupted.
    """
    refuse_run(folder)
    begun = perf_counter()
    # A wrong request shows here, before anything is written.
    parts, vehicle = assemble(study, communicator)
    folder.mkdir(parents=True, exist_ok=True)
    run = _Run(study, folder, begun, communicator)
    # Bits that do not depend on the number of cores; and small matrices are quicker without threads.
    with log_file(folder / "run.log"), stop_signals() as stop, threadpool_limits(limits=1, user_api="blas"):
        try:
            with parts.executor:
                run.cycles(parts, vehicle, stop)
            run.finish("complete")
        except DafwError as error:
            run.finish("failed", str(error))
            kept = f"; {run.done} of {study.cycles} cycles are kept in {folder}" if run.done else ""
            raise type(error)(f"{error}{kept}") from error
        except (OSError, RuntimeError) as error:
            # netCDF's own errors: a full disk, say. What was synchronised may be lost with it.
            run.finish("failed", f"{type(error).__name__}: {error}")
            raise RecordError(f"{folder}: the run cannot be written ({type(error).__name__}: {error})") from error
        except (Interrupted, KeyboardInterrupt):
            run.finish("interrupted")
            raise Interrupted(f"{run.done} of {study.cycles} cycles are kept in {folder}") from None
        if study.pictures and not stop.asked:
            _draw(folder)
        if stop.asked:
            raise Interrupted(f"all {run.done} cycles are kept in {folder}")
    return run.summary


def follow_study(study: Study, communicator: Any) -> None:
    """Take part in a run of rank 0 as another rank, and leave nothing behind; raises what the run raises."""
    parts, vehicle = assemble(study, communicator)
    with stop_signals() as stop, threadpool_limits(limits=1, user_api="blas"):
        state = start(parts, study.members, vehicle)
        stop.patient = True
        for done in range(1, study.cycles + 1):
            state = advance(parts, state).state
            if stop.agreed(communicator) and done < study.cycles:
                raise Interrupted


def refuse_run(folder: Path) -> None:
    """Raise RunError where a folder holds a run already."""
    if (folder / "run.nc").exists() or (folder / "summary.json").exists():
        raise RunError(f"{folder}: holds a run already; nothing was changed")


class _Run:
    """One run on its way: what is done, what was measured."""

    def __init__(self, study: Study, folder: Path, begun: float, communicator: Any) -> None:
        self.study, self.folder, self.begun, self.communicator = study, folder, begun, communicator
        self.done = 0
        self.seconds: dict[str, float] = {}
        self.scores: dict[str, float] = {}
        self.parameters: dict[str, dict[str, float]] = {}
        self.pinned: dict[str, Mapping[str, Any]] = {}
        self.record: Record | None = None
        self.summary: dict[str, Any] = {}
        # Until it says otherwise, a run that leaves no word was cut off.
        self.noted = perf_counter()
        claim(folder / "summary.json")
        self._write_summary("interrupted")

    def cycles(self, parts: Parts, vehicle: Vehicle, stop: Stop) -> None:
        """Run all cycles; raises Interrupted between two of them."""
        log.info("study '%s', seed %d, %d members", self.study.name, self.study.seed, self.study.members)
        parts.executor.start(parts.model, self.study.model)
        state = start(parts, self.study.members, vehicle)
        self.pinned = _pinned(parts)
        self.seconds["set-up"] = perf_counter() - self.begun
        stop.patient = True
        log_domain(parts)
        self.record = Record(
            self.folder / "run.nc",
            parts,
            state,
            whole=_kept_whole(self.study, parts),
            section=np.array(self.study.section, dtype=np.float64).reshape(-1, 2),
            attributes={
                "title": f"dafw study {self.study.name}",
                "name": self.study.name,
                "seed": self.study.seed,
                "dafw_version": version("dafw"),
                **{f"{role}_pinned": json.dumps(options) for role, options in self.pinned.items()},
            },
        )
        logged = 0.0
        with progress(self.study.cycles) as bar:
            for _ in range(self.study.cycles):
                cycle = advance(parts, state)
                recorded = perf_counter()
                self.scores = self.record.append(cycle)
                cycle.seconds["record"] = perf_counter() - recorded
                for phase, seconds in cycle.seconds.items():
                    self.seconds[phase] = self.seconds.get(phase, 0.0) + seconds
                state, self.done = cycle.state, self.done + 1
                for note in cycle.route.notes:
                    log.warning("t = %g s: %s", state.belief.ensemble.time, note)
                if perf_counter() - logged > LOG_SECONDS or self.done == self.study.cycles:
                    logged = perf_counter()
                    log.info("%s", sentence(cycle, self.scores))
                bar.set_postfix_str(postfix(state, self.scores), refresh=False)
                bar.update()
                if perf_counter() - self.noted > SUMMARY_SECONDS:
                    self.noted = perf_counter()
                    self._write_summary("interrupted")
                if stop.agreed(self.communicator) and self.done < self.study.cycles:
                    raise Interrupted
        self.parameters = _parameters(parts, state)

    def finish(self, status: str, error: str = "") -> None:
        """Close the record and say how the run ended."""
        try:
            if self.record is not None:
                self.record.close()
        except (OSError, RuntimeError) as failure:
            status, error = "failed", error or f"run.nc cannot be closed: {failure}"
        self._write_summary(status, error)
        log.info("%s after %d of %d cycles %s", status, self.done, self.study.cycles, error)

    def _write_summary(self, status: str, error: str = "") -> None:
        self.summary = {
            "status": status,
            "name": self.study.name,
            "seed": self.study.seed,
            "members": self.study.members,
            "executor": self.study.executor,
            "processes": self.communicator.size if self.communicator else 1,
            "cycles": self.done,
            "cycles_wanted": self.study.cycles,
            "err_final": _finite(self.scores.get("err")),
            "err_free_final": _finite(self.scores.get("err_free")),
            "parameters_final": self.parameters,
            "wall_seconds": round(perf_counter() - self.begun, 3),
            "pinned": self.pinned,
            "phase_seconds": {phase: round(seconds, 4) for phase, seconds in self.seconds.items()},
            "versions": _versions(),
        }
        if error:
            self.summary["error"] = error
        write_whole(self.folder / "summary.json", json.dumps(self.summary, indent=2) + "\n")


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in VERSIONED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _kept_whole(study: Study, parts: Parts) -> list[str]:
    variables = parts.model.space.variables
    if study.record.members == "all":
        return [variable.name for variable in variables]
    return [variable.name for variable in variables if variable.size == 1 and study.record.members == "parameters"]


def _pinned(parts: Parts) -> dict[str, Mapping[str, Any]]:
    """Return what the models found where their options left it open, such as the newest reduced basis, by role."""
    models = {"model": parts.model, "truth": parts.truth, "free": parts.free}
    found = {role: model.pinned_options() for role, model in models.items() if model is not None}
    return {role: options for role, options in found.items() if options}


def _parameters(parts: Parts, state: State) -> dict[str, dict[str, float]]:
    """Return truth, mean and spread of every state variable that is a single number."""
    belief, truth = state.belief.ensemble, state.truth.ensemble.members[0]
    listed = {}
    for variable in parts.model.space.variables:
        if variable.size == 1:
            place = parts.model.space.slice(variable.name).start
            listed[variable.name] = {
                "truth": float(truth[place]),
                "mean": float(belief.mean[place]),
                "spread": float(np.nan_to_num(belief.spread[place])),
            }
    return listed


def _draw(folder: Path) -> None:
    from dafw.core.runs import open_run
    from dafw.views import draw_all

    try:
        with open_run(folder) as run:
            for path in draw_all(run, folder / "figures"):
                log.info("picture %s", path.name)
    except DafwError as error:
        log.warning("a picture cannot be drawn: %s", error)
        print(f"dafw: the run is complete, but a picture cannot be drawn: {error}", file=sys.stderr)


def run(overrides: list[str] | None = None) -> Any:
    """Compose, run and open a study: ``dafw.run(["filter=none", "cycles=20"])`` returns its xarray.Dataset.

    The folder of the run is the dataset's attribute ``folder``. Raises ConfigurationError for a wrong request and
    other DafwErrors where a computation fails.
    """
    from omegaconf import OmegaConf

    from dafw.core.composition import compose, study_part
    from dafw.core.experiment import study_from
    from dafw.core.runs import open_run

    if isinstance(overrides, str) or not all(isinstance(override, str) for override in overrides or []):
        raise ConfigurationError(f"overrides must be a list of strings, got {overrides!r}")
    config = compose(overrides or [])
    study = study_from(study_part(config))
    folder = Path(config.hydra.run.dir).resolve()
    run_study(study, folder)
    (folder / ".hydra").mkdir(exist_ok=True)
    write_whole(folder / ".hydra" / "config.yaml", OmegaConf.to_yaml(study_part(config)))
    write_whole(folder / ".hydra" / "overrides.yaml", OmegaConf.to_yaml(overrides or []))
    dataset = open_run(folder)
    dataset.attrs["folder"] = str(folder)
    return dataset
