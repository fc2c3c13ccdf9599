"""Taking part in the run of another MPI rank, which alone writes files."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from dafw.core.cycle import advance, start
from dafw.core.errors import DivergenceError, SolverError
from dafw.core.forecasts.ahead import run_ahead
from dafw.core.forecasts.areas import places_of
from dafw.core.pinned import pinned_study
from dafw.core.study import Study
from dafw.studies.resuming import restored, shared
from dafw.studies.stopping import Interrupted, stop_signals


def follow_study(study: Study, communicator: Any) -> None:
    """Take part in rank 0's run as another rank, without writing any file; raises the errors of the run."""
    before = shared(None, communicator)
    if before is not None:
        study = pinned_study(study, before.told["pinned"])
    parts, vehicle = study.prepare(communicator)
    with stop_signals() as stop, threadpool_limits(limits=1, user_api="blas"):
        state = start(parts, study.members, vehicle)
        if before is not None:
            state = restored(before, state, parts, Path(study.name))
        stop.patient = True
        plan = study.forecast
        places = None if plan.every is None else places_of(plan, parts.model.space.variables[0], parts.model.domain)
        for done in range(state.cycle + 1, study.cycles + 1):
            state = advance(parts, state).state
            if places is not None and plan.is_due(done, parts.model.dt):
                with suppress(SolverError, DivergenceError):  # rank 0 says so
                    run_ahead(parts, state, plan, places)
            if stop.agreed(communicator) and done < study.cycles:
                raise Interrupted
