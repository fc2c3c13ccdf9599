"""Running a study: cycles, record, log, progress, summary and pictures, in one folder."""

from __future__ import annotations

import logging
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from dafw.core.cycle import Cycle, Parts, State, advance, start
from dafw.core.ensemble import Vehicle
from dafw.core.errors import (
    ComputationError,
    DafwError,
    NoMoreReadingsError,
    RecordError,
    RunError,
)
from dafw.core.files import claim, write_atomically
from dafw.core.forecasts.forecast_file import FILE
from dafw.core.plugin import by_plugin
from dafw.core.progress import progress
from dafw.core.record import Record
from dafw.core.study import Study
from dafw.studies.advice import Advice
from dafw.studies.forecasting import Forecasting
from dafw.studies.reporting import closing_line, log_domain, log_file, postfix, sentence, warn_once
from dafw.studies.stopping import Interrupted, Stop, stop_signals
from dafw.studies.summary import Summary

log = logging.getLogger("dafw")
LOG_SECONDS = 0.2
SHOWN_BY_BUILDING = ("model", "truth", "free", "vehicle", "observer", "policy", "readings", "section")
"""Parts of a study's configuration whose errors may show only when a site or a mesh is built."""
SUMMARY_SECONDS = 10.0


def run_study(study: Study, folder: Path, communicator: Any = None) -> dict[str, Any]:
    """Run a study into ``folder`` and return its summary; on rank 0 of an MPI communicator, if there is one.

    In any case the finished cycles stay in ``run.nc``, and ``summary.json`` says how the run ended. Raises RunError if
    the folder already holds a run, DafwError if a computation fails, and Interrupted.
    """
    refuse_run(folder)
    begun = perf_counter()
    # A wrong request raises here, before anything is written.
    parts, vehicle = study.prepare(communicator)
    folder.mkdir(parents=True, exist_ok=True)
    run = _Run(study, folder, begun, communicator)
    # One thread: the bits then do not depend on the number of cores, and small matrices are faster.
    with log_file(folder / "run.log"), stop_signals() as stop, threadpool_limits(limits=1, user_api="blas"):
        try:
            with parts.executor:
                parts.readings.begin(folder, lambda: stop.asked)
                try:
                    run.cycles(parts, vehicle, stop)
                finally:
                    if run.advice is not None:
                        run.advice.close()
                    parts.readings.end()
            run.end("complete")
            log.info("%s", closing_line(study, run.summary.values()))
        except KeyboardInterrupt:
            run.end("interrupted")
            raise Interrupted(f"{run.summary.cycles} of {study.cycles} cycles are kept in {folder}") from None
        except (Exception, SystemExit) as error:
            # An error outside the phases of a cycle must also give a one-line message and close the record.
            failure = _named(error)
            with suppress(RecordError):  # report the first error
                run.end("failed", str(failure))
            done = run.summary.cycles
            kept = f"; {done} of {study.cycles} cycles are kept in {folder}" if done else ""
            raise type(failure)(f"{failure}{kept}") from error
        if study.pictures and not stop.asked:
            _draw(folder)
        if stop.asked:
            raise Interrupted(f"all {run.summary.cycles} cycles are kept in {folder}")
    return run.summary.values()


def refuse_run(folder: Path, communicator: Any = None) -> None:
    """Raise RunError if a folder already holds a run.

    With an MPI communicator all ranks call this. Only rank 0 looks and tells the others, because it may have made the
    folder before another rank looks.
    """
    holds = communicator is None or communicator.rank == 0
    holds = holds and ((folder / "run.nc").exists() or (folder / "summary.json").exists())
    if communicator is not None:
        holds = communicator.bcast(holds, root=0)
    if holds:
        raise RunError(f"{folder}: holds a run already; nothing was changed")


class _Run:
    """One run in progress."""

    def __init__(self, study: Study, folder: Path, begun: float, communicator: Any) -> None:
        self.study, self.folder, self.communicator = study, folder, communicator
        self.summary = Summary(study, begun, communicator.size if communicator else 1)
        self.record: Record | None = None
        self.forecasting: Forecasting | None = None
        self.advice: Advice | None = None
        self._writing = _Writing(folder)
        # The status of a run that is killed before it can write another one.
        self.noted = perf_counter()
        claim(folder / "summary.json")
        self._write_summary()

    def cycles(self, parts: Parts, vehicle: Vehicle, stop: Stop) -> None:
        """Run all cycles; raises Interrupted between two of them."""
        study, summary = self.study, self.summary
        log.info("study '%s', seed %d, %d members", study.name, study.seed, study.members)
        parts.executor.start(parts.model, study.model_configuration)
        state = start(parts, study.members, vehicle)
        summary.begin(study)
        stop.patient = True
        log_domain(parts)
        with self._writing:
            self.record = Record(
                self.folder / "run.nc",
                parts,
                state,
                with_members=_with_members(study, parts),
                section=np.array(study.section, dtype=np.float64).reshape(-1, 2),
                attributes=summary.file_attributes(),
                fields=study.record_fields,
            )
            if study.forecast.every is not None:
                self.forecasting = Forecasting(study.forecast, parts, state, self.folder, summary.file_attributes())
        logged = 0.0
        self.advice = Advice(study, parts, self.folder)
        with progress(study.cycles, "cycle") as bar:
            for done in range(1, study.cycles + 1):
                try:
                    cycle = advance(parts, state, partial(self.advice.give, state))
                except NoMoreReadingsError as ended:
                    log.info("%s", ended)
                    break
                recorded = perf_counter()
                with self._writing:
                    scores = self.record.append(cycle)
                cycle.seconds["record"] = perf_counter() - recorded
                summary.add(cycle, scores)
                self._say(cycle, parts)
                state = cycle.state
                self._look_ahead(done, state, parts)
                if perf_counter() - logged > LOG_SECONDS or done == study.cycles:
                    logged = perf_counter()
                    log.info("%s", sentence(cycle, scores))
                if not bar.disable:
                    bar.set_postfix_str(postfix(state, scores), refresh=False)
                bar.update()
                if perf_counter() - self.noted > SUMMARY_SECONDS:
                    with self._writing:
                        self._write_summary()
                if stop.agreed(self.communicator) and done < study.cycles:
                    raise Interrupted
        self.advice.end(state)
        summary.end(parts, state)

    def _say(self, cycle: Cycle, parts: Parts) -> None:
        """Log what plugins have to say about a cycle, and once each what a user must know."""
        time = cycle.state.belief.ensemble.time
        for note in cycle.notes:
            log.warning("t = %g s: %s", time, note)
        for what, text in self.summary.warnings(cycle, parts):
            warn_once(self.summary.warned, what, f"t = {time:g} s: {text}")

    def _look_ahead(self, done: int, state: State, parts: Parts) -> None:
        """Make a forecast if one is due."""
        if self.forecasting is None or not self.study.forecast.is_due(done, parts.model.dt):
            return
        with self._writing:
            warning = self.forecasting.issue(state)
        self.summary.forecasts = self.forecasting.summary()
        if warning is not None:
            warn_once(self.summary.warned, "forecast", f"t = {state.belief.ensemble.time:g} s: {warning}")

    def end(self, status: str, error: str = "") -> None:
        """Close the record and say how the run ended; raises RecordError if that cannot be written."""
        try:
            with self._writing:
                try:
                    if self.forecasting is not None:
                        self.forecasting.close()
                finally:
                    if self.record is not None:
                        self.record.close()
        except RecordError as failure:
            status, error = "failed", error or str(failure)
            raise
        finally:
            self.summary.status, self.summary.error = status, error
            with self._writing:
                self._write_summary()
            log.info("%s after %d of %d cycles %s", status, self.summary.cycles, self.study.cycles, error)

    def _write_summary(self) -> None:
        self.noted = perf_counter()
        write_atomically(self.folder / "summary.json", self.summary.text())


class _Writing:
    """Makes an error of the record say that the run cannot be written: a full disk, say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError | RuntimeError) and by_plugin(error) is None:
            raise RecordError(f"{self.folder}: the run cannot be written ({type(error).__name__}: {error})") from error


def _named(error: BaseException) -> DafwError:
    """Return an error as a DafwError, which names the plugin if one raised it."""
    if isinstance(error, DafwError):
        return error
    return by_plugin(error) or ComputationError(f"{type(error).__name__}: {error}")


def _with_members(study: Study, parts: Parts) -> list[str]:
    """Return the names of the variables for which every member is kept."""
    variables = parts.model.space.variables
    if study.record == "all":
        return [variable.name for variable in variables]
    return [variable.name for variable in variables if variable.size == 1 and study.record == "parameters"]


def _draw(folder: Path) -> None:
    from dafw.core.runs import open_run
    from dafw.views import draw_all

    try:
        with open_run(folder) as run:
            for path in draw_all(run, folder / "figures"):
                log.info("picture %s", path.name)
        if (folder / FILE).exists():
            from dafw.views.forecasts import draw_forecast

            for path in draw_forecast(folder):
                log.info("picture %s", path.name)
    except DafwError as error:
        log.warning("a picture cannot be drawn: %s", error)
        print(f"dafw: the run is complete, but a picture cannot be drawn: {error}", file=sys.stderr)
