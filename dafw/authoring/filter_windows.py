"""Checks of filters that look back: their inputs, their results, and a comparison with the exact smoother."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dafw.authoring.checks import Factory, NotApplicable, check
from dafw.authoring.evidence import require_close, require_in_set
from dafw.authoring.filter_kalman import require_accuracy
from dafw.authoring.filter_trials import ROUNDING, accepted, has_option, moments, plain, takes, with_option
from dafw.authoring.problems import Problem, bounded_problems, linear_problem
from dafw.authoring.small_study import SmallStudy, growth, require_same_cycles, study_of, watched
from dafw.core.cycle import Cycle
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped, step_members
from dafw.core.interfaces import Filter, Model
from dafw.core.observation import Observation
from dafw.core.space import Array
from dafw.core.window import Window

SHORT = 2
"""Cycles of the short window that is tried if the window is an option."""


def _windows(factory: Factory) -> Iterator[Factory]:
    """Yield the filter unchanged and, if its window is an option, with a short one; raises NotApplicable."""
    filter_ = factory()
    if filter_.window == 0:
        raise NotApplicable("looks back at no earlier cycle")
    yield factory
    if has_option(filter_, "window") and filter_.window != SHORT:
        short = with_option(factory, window=SHORT)
        if takes(short):
            yield short


def _problems(n_cycles: int) -> list[Problem]:
    """Return a linear problem for each cycle, all with the same members."""
    problem = linear_problem(8, 3, 2)
    values = np.random.default_rng(5).normal(0.0, 2.0, (n_cycles, 2))
    return [replace(problem, values=problem.values + each) for each in values]


def _study(n_cycles: int, *, late: Sequence[tuple[int, int]] = (), silent: Sequence[int] = ()) -> SmallStudy:
    """Return a study without readings in ``silent`` cycles; ``late`` holds pairs of cycles: taken, and arrived."""
    study = study_of(*_problems(n_cycles))
    arrivals = [() if cycle in silent else arrived for cycle, arrived in enumerate(study.arrivals)]
    for cycle, arrived in late:
        arrivals[cycle], arrivals[arrived] = (), (*arrivals[cycle], *arrivals[arrived])
    return replace(study, arrivals=tuple(arrivals))


@check("filter")
def revised_in_set(factory: Factory) -> None:
    """Revised beliefs belong to times in the filter's window, and every variable is in its range, as in analyses."""
    for made in _windows(factory):
        for seed, problem in enumerate(bounded_problems()):
            for cycle in study_of(accepted(made, problem), still=True).run(made, seed=seed):
                for done, belief in cycle.analysis.revised.items():
                    what = f"the belief revised after {done} cycles"
                    require_in_set(problem.forecast.space, belief.ensemble.members, what)


@check("filter")
def past_unchanged(factory: Factory) -> None:
    """An analysis does not change the beliefs and readings of the window, the late readings or the model's memory."""

    def handed(window: Window) -> dict[str, Any]:
        named: dict[str, Any] = {"the model's memory of the forecast": window.forecast.memory}
        for cycle in window.cycles:
            when = f"of cycle {cycle.number}"
            if cycle.belief is not None:
                named[f"the belief {when}"] = cycle.belief.ensemble.members
                named[f"the model's memory {when}"] = cycle.belief.memory
            named[f"the readings {when}"] = cycle.observation.values
            named[f"R {when}"] = cycle.observation.covariance
        for number, observation in window.late:
            named[f"the late readings of cycle {number}"] = observation.values
        return named

    study = _study(4, late=[(1, 2)]).remembering()
    for made in _windows(factory):
        study.run(partial(_watched, made, handed))


def _watched(factory: Factory, named: Callable[..., dict[str, Any]]) -> Filter:
    return watched(factory(), named)


@check("filter")
def silent_cycles(factory: Factory) -> None:
    """Cycles without readings are in the window like others, also if it is the first cycle that has none."""
    for made in _windows(factory):
        for silent in ((0,), (1, 2)):
            _require_right(made, _study(4, silent=silent), f"cycles {silent} were silent")


@check("filter")
def late_readings(factory: Factory) -> None:
    """A late reading is used whether or not others arrive with it; an exact filter then has the same belief as if the reading had been on time."""  # noqa: E501
    for made in _windows(factory):
        for silent in ((), (2,)):
            study = _study(4, late=[(1, 2)], silent=silent)
            _require_right(made, study, "a reading of cycle 1 arrived in cycle 2" + " alone" * bool(silent))


@check("filter")
def any_executor(factory: Factory) -> None:
    """The bits of a re-run do not depend on the executor: operators can be sent to workers, and results are in member order."""  # noqa: E501
    for made in _windows(factory):
        study = _study(4).remembering(error_sd=0.1)
        message = "it depends on who steps the members"
        require_same_cycles(study.run(made), study.run(made, executor=Elsewhere()), message)


@check("filter")
def smoother_exact(factory: Factory) -> None:
    """For linear, Gaussian problems, revised beliefs have mean and covariance of the Rauch-Tung-Striebel smoother, to rounding."""  # noqa: E501
    revised = False
    for made in _windows(factory):
        require_accuracy(factory(), "exact")
        cycles = _require_right(made, _study(5), "all readings came in time")
        revised |= any(cycle.analysis.revised for cycle in cycles)
    if not revised:
        raise NotApplicable("revises no belief")


def _require_right(factory: Factory, study: SmallStudy, message: str) -> list[Cycle]:
    """Run the study and return its cycles; raise if an exact filter's beliefs differ from the exact smoother's."""
    cycles = study.run(plain(factory))
    if factory().accuracy != "exact":
        return cycles
    known: list[Observation] = []
    for cycle, arrived in zip(cycles, study.arrivals, strict=True):
        known += arrived
        now = cycle.state.cycle
        expected = rauch_tung_striebel(study, known, now)
        for done, belief in {**cycle.analysis.revised, now: cycle.state.belief}.items():
            where = f"{message}: the belief after {done} of {now} cycles is not the Rauch-Tung-Striebel smoother's"
            require_close(moments(belief.ensemble), expected[done], ROUNDING, where)
    return cycles


def rauch_tung_striebel(study: SmallStudy, known: Sequence[Observation], n_cycles: int) -> list[Array]:
    """Return mean and covariance (n + n * n,) of the states after 0 ... ``n_cycles`` cycles, given the ``known``.

    Rauch, Tung and Striebel (1965), doi:10.2514/3.3166, computed by filterpy.
    """
    from filterpy.kalman import KalmanFilter, rts_smoother

    first, n = study.model.members, study.model.space.size
    engine = KalmanFilter(dim_x=n, dim_z=1)
    engine.x, engine.P = first.mean(axis=0)[:, np.newaxis], np.cov(first, rowvar=False)
    engine.F, engine.Q = growth(n), np.zeros((n, n))
    means, covariances = [engine.x.copy()], [engine.P.copy()]
    for cycle in range(n_cycles):
        engine.predict()
        for observation in known:
            if observation.time == cycle + study.model.dt:
                operator: Any = observation.operator
                engine.update(observation.values[:, np.newaxis], R=np.diag(observation.covariance), H=operator.matrix)
        means.append(engine.x.copy())
        covariances.append(engine.P.copy())
    size = len(means)
    smoothed, spreads, *_ = rts_smoother(
        np.array(means), np.array(covariances), np.array([engine.F] * size), np.array([engine.Q] * size)
    )
    return [np.concatenate([mean[:, 0], spread.ravel()]) for mean, spread in zip(smoothed, spreads, strict=True)]


@dataclass
class Elsewhere(Executor):
    """Imitates workers: steps pickled copies with a pickled model, in small batches, the last batch first."""

    def width(self) -> int:
        """Return the number of batches."""
        return 3

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Copy everything; step it when the result is fetched."""
        sent = pickle.dumps((model, list(batches)))

        def wait() -> Sequence[Stepped]:
            theirs, copies = pickle.loads(sent)
            stepped = [step_members(theirs, batch) for batch in reversed(copies)]
            back: list[Stepped] = pickle.loads(pickle.dumps(stepped[::-1]))
            return back

        return wait
