"""Running a study: cycles, record, log, progress, summary and pictures, in one folder."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from dafw.core.checkpoints.checkpoint_file import FOLDER, Checkpoint
from dafw.core.checkpoints.fingerprint import described, digest, digests_of_files
from dafw.core.checkpoints.journal import FORECASTS, ROWS, entries
from dafw.core.cycle import Cycle, Parts, State, advance, start
from dafw.core.ensemble import Vehicle
from dafw.core.errors import (
    CheckpointError,
    ComputationError,
    DafwError,
    NoMoreReadingsError,
    RecordError,
    RunError,
)
from dafw.core.files import claim, write_atomically
from dafw.core.pinned import pinned_study
from dafw.core.plugin import by_plugin
from dafw.core.progress import progress
from dafw.core.record import Record
from dafw.core.runs import summary_of
from dafw.core.study import Study
from dafw.studies.advice import Advice
from dafw.studies.checkpointing import LATER, Checkpointing
from dafw.studies.forecasting import Forecasting
from dafw.studies.pictures import draw_pictures
from dafw.studies.rehearsing import rehearse
from dafw.studies.reporting import closing_line, log_domain, log_file, postfix, sentence, warn_once
from dafw.studies.resuming import (
    cleared,
    held,
    holds_run,
    is_complete,
    last_checkpoint,
    later_rows,
    restored,
    shared,
)
from dafw.studies.stopping import Interrupted, Stop, stop_signals
from dafw.studies.summary import Summary

log = logging.getLogger("dafw")
LOG_SECONDS = 0.2
SHOWN_BY_BUILDING = ("model", "truth", "free", "vehicle", "observer", "policy", "readings", "section")
"""Parts of a study's configuration whose errors may show only when a site or a mesh is built."""
SUMMARY_SECONDS = 10.0


def run_study(study: Study, folder: Path, communicator: Any = None, *, resume: bool = False) -> dict[str, Any]:
    """Run a study into ``folder`` and return its summary; on rank 0 of an MPI communicator, if there is one.

    In any case the finished cycles stay in ``run.nc``, and ``summary.json`` says how the run ended. With ``resume`` an
    unfinished run of the study in the folder goes on from its last checkpoint, and of a complete one the summary is
    returned. Raises RunError if the folder already holds a run, or one that cannot go on; DafwError if a computation
    fails; and Interrupted.
    """
    begun = perf_counter()
    goes_on = resume and holds_run(folder)
    if not goes_on:
        refuse_run(folder)
    elif is_complete(folder, study):
        if communicator is not None:  # the other ranks wait: this must not end well
            raise RunError(f"{folder}: another process has completed this run meanwhile")
        return summary_of(folder)
    elif _forgets(study):
        raise RunError(
            f"{folder}: a live run of {study.readings.label} cannot go on, because it keeps no journal of what came; "
            f"nothing was changed"
        )
    with ExitStack() as stack:
        if goes_on:  # a wrong request to go on raises before the parts are built, which may take long
            stack.enter_context(held(folder))
        before = shared(last_checkpoint(folder, study) if goes_on else None, communicator)
        told = described(study)
        if before is not None:
            study = pinned_study(study, before.told["pinned"])
        # A wrong request raises here, before anything is written. Digests come first: a file that grows meanwhile
        # must not have that of lines which were not read.
        files = digests_of_files(study)
        parts, vehicle = study.prepare(communicator)
        if not goes_on:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(held(folder))
            claim(folder / "summary.json")
        elif before is None:
            cleared(folder)
        run = _Run(study, told, files, folder, begun, communicator, before)
        return _carried_out(run, parts, vehicle)


def _carried_out(run: _Run, parts: Parts, vehicle: Vehicle) -> dict[str, Any]:
    """Run a study whose parts are built, in a folder that no other process writes to."""
    study, folder = run.study, run.folder
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
                run.end("failed", failure)
            done = run.summary.cycles
            kept = f"; {done} of {study.cycles} cycles are kept in {folder}" if done else ""
            raise type(failure)(f"{failure}{kept}") from error
        if study.pictures and not stop.asked:
            draw_pictures(folder)
        if stop.asked:
            raise Interrupted(f"all {run.summary.cycles} cycles are kept in {folder}")
    return run.summary.values()


def refuse_run(folder: Path, communicator: Any = None) -> None:
    """Raise RunError if a folder already holds a run.

    With an MPI communicator all ranks call this. Only rank 0 looks and tells the others, because it may have made the
    folder before another rank looks.
    """
    holds = communicator is None or communicator.rank == 0
    holds = holds and holds_run(folder)
    if communicator is not None:
        holds = communicator.bcast(holds, root=0)
    if holds:
        hint = ""
        if (communicator is None or communicator.rank == 0) and summary_of(folder).get("status") == "interrupted":
            hint = f"; dafw resume {folder} goes on with it"
        raise RunError(f"{folder}: holds a run already; nothing was changed{hint}")


class _Run:
    """One run in progress.

    ``told`` is its configuration, ``files`` has the digests of what it reads, ``before`` is the checkpoint from which
    it goes on.
    """

    def __init__(
        self,
        study: Study,
        told: Mapping[str, Any],
        files: Mapping[str, str],
        folder: Path,
        begun: float,
        communicator: Any,
        before: Checkpoint | None,
    ) -> None:
        self.study, self.folder, self.communicator = study, folder, communicator
        self.summary = Summary(study, begun, communicator.size if communicator else 1)
        self.record: Record | None = None
        self.forecasting: Forecasting | None = None
        self.advice: Advice | None = None
        self.checkpointing: Checkpointing | None = None
        self.before = before
        self._between: State | None = None
        """The state to which all that is written belongs; None while a cycle is being written."""
        self._writing = _Writing(folder)
        self._told = told
        self.summary.configuration, self.summary.files = digest(told), files
        if before is not None:
            try:
                self.summary.go_on(before.told["summary"])
            except (LookupError, TypeError, ValueError, AttributeError) as error:
                raise CheckpointError(f"{folder / FOLDER}: its summary cannot be read ({error})") from error
        # The status of a run that is killed before it can write another one.
        self.noted = perf_counter()
        self._write_summary()

    def cycles(self, parts: Parts, vehicle: Vehicle, stop: Stop) -> None:
        """Run all cycles; raises Interrupted between two of them."""
        study, summary = self.study, self.summary
        log.info("study '%s', seed %d, %d members", study.name, study.seed, study.members)
        parts.executor.start(parts.model, study.model_configuration)
        first = start(parts, study.members, vehicle)
        before = self.before
        state = first if before is None else restored(before, first, parts, self.folder)
        summary.begin(study)
        stop.patient = True
        log_domain(parts)
        if before is not None:
            log.info("goes on after %d of %d cycles", before.cycle, study.cycles)
        with self._writing:
            record = self._open(parts, first)
        self._between, logged = state, 0.0
        if study.readings.is_live and before is None:
            rehearse(parts, first)
        self.advice = Advice(study, parts, self.folder)
        with progress(study.cycles, "cycle", done=state.cycle) as bar:
            for done in range(state.cycle + 1, study.cycles + 1):
                try:
                    cycle = advance(parts, state, partial(self.advice.give, state))
                except NoMoreReadingsError as ended:
                    log.info("%s", ended)
                    break
                recorded, self._between = perf_counter(), None
                with self._writing:
                    scores = record.append(cycle)
                cycle.seconds["record"] = perf_counter() - recorded
                summary.add(cycle, scores)
                self._say(cycle, parts)
                state = cycle.state
                self._look_ahead(done, state, parts)
                self._between = state
                if perf_counter() - logged > LOG_SECONDS or done == study.cycles:
                    logged = perf_counter()
                    log.info("%s", sentence(cycle, scores))
                if not bar.disable:
                    bar.set_postfix_str(postfix(state, scores), refresh=False)
                bar.update()
                if perf_counter() - self.noted > SUMMARY_SECONDS:
                    with self._writing:
                        self._write_summary()
                if self.checkpointing is not None and done < study.cycles and self.checkpointing.is_due(done):
                    self._keep()
                if stop.agreed(self.communicator) and done < study.cycles:
                    raise Interrupted
        self.advice.end(state)
        summary.end(parts, state)

    def _open(self, parts: Parts, first: State) -> Record:
        """Make the files of the run, or make them anew as they were at the checkpoint; ``first`` is the first state."""
        study, before, attributes = self.study, self.before, self.summary.file_attributes()
        places = self.folder / FOLDER
        if study.checkpoint.wanted and not _forgets(study):
            self.checkpointing = Checkpointing(study, self._told, parts, self.folder, first, before)
        lengths = {} if before is None else before.told["journals"]
        self.record = record = Record(
            self.folder / "run.nc",
            parts,
            first,
            with_members=_with_members(study, parts),
            section=np.array(study.section, dtype=np.float64).reshape(-1, 2),
            attributes=attributes,
            fields=study.record_fields,
            journal=self.checkpointing.rows if self.checkpointing else None,
            before=(entries(places / ROWS, lengths[ROWS]), later_rows(before, LATER)) if before else None,
        )
        if study.forecast.every is not None:
            known = (entries(places / FORECASTS, lengths[FORECASTS]), before.told["forecasting"]) if before else None
            journal = self.checkpointing.forecasts if self.checkpointing else None
            self.forecasting = Forecasting(study.forecast, parts, first, self.folder, attributes, journal, known)
        return record

    def _keep(self) -> None:
        """Write a checkpoint of the last cycle."""
        if self.checkpointing is not None and self.record is not None and self._between is not None:
            with self._writing:
                self.checkpointing.write(self._between, self.record, self.forecasting, self.summary)

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

    def end(self, status: str, error: DafwError | None = None) -> None:
        """Close the record and say how the run ended; raises RecordError if that cannot be written.

        A run that is not complete leaves a checkpoint, so that nothing that was computed is lost.
        """
        try:
            with self._writing, ExitStack() as closing:
                for part in (self.checkpointing, self.record, self.forecasting):
                    if part is not None:
                        closing.callback(part.close)
                if self.summary.cycles < self.study.cycles and not isinstance(error, RecordError):
                    self._keep()
        except RecordError as failure:
            status, error = "failed", error or failure
            raise
        finally:
            summary = self.summary
            summary.status, summary.error = status, "" if error is None else str(error)
            if error is not None and error.phase is not None:
                summary.failed_at = {"time": error.time, "phase": error.phase}
            with self._writing:
                self._write_summary()
            log.info("%s after %d of %d cycles %s", status, summary.cycles, self.study.cycles, summary.error)
        if status == "complete":
            shutil.rmtree(self.folder / FOLDER, ignore_errors=True)

    def _write_summary(self) -> None:
        self.noted = perf_counter()
        write_atomically(self.folder / "summary.json", self.summary.text())


def _forgets(study: Study) -> bool:
    """Return whether nobody can give the study again what came after a checkpoint."""
    return study.readings.is_live and not study.readings.journal


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
