"""Checks of filters: the interface, and what no filter may depend on. filter_kalman.py compares exact answers."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from dafw.authoring.checks import ConformanceError, Factory, NotApplicable, check, require
from dafw.authoring.evidence import (
    global_generators,
    no_global_draws,
    require_close,
    require_in_set,
    require_same_bits,
)
from dafw.authoring.filter_trials import (
    ROUNDING,
    accepted,
    asked,
    inflation_option,
    moments,
    plain,
    problems,
    require_equal_law,
    shares,
    takes,
    with_option,
)
from dafw.authoring.problems import Problem, bounded_problems, gas_problem, gas_space, linear_problem
from dafw.authoring.small_study import after, require_same_cycles, study_of, watched
from dafw.core.cycle import Cycle
from dafw.core.ensemble import Ensemble, Memory
from dafw.core.observation import Observation
from dafw.core.space import Array
from dafw.core.window import Window

WORTHLESS = 1e16
"""Factor on R that leaves the readings without information."""


@check("filter")
def shapes(factory: Factory) -> None:
    """An analysis has the forecast's shape and finite numbers, for few and many members, with one reading or many, with a diagonal and a full R, and with no reading at all."""  # noqa: E501
    for name, problem in problems(factory):
        try:
            asked(factory, problem)
            nothing = problem.in_order(np.empty(0, dtype=np.int64))
            *_, before, last = asked(factory, problem, problem, nothing)
            if factory().unfinished(before.state.filter_memory):
                continue  # it goes on with the readings that it had
            require_same_bits(after(last).members, last.forecast.members, "no readings, and another belief")
            require_same_bits(after(last).weights, last.forecast.weights, "no readings, and other weights")
        except Exception as error:
            raise ConformanceError(f"{name}: {' '.join(str(error).split()) or type(error).__name__}") from error


@check("filter")
def inputs_unchanged(factory: Factory) -> None:
    """An analysis does not change the forecast, predicted readings, observation or memory: they are still needed."""

    def handed(first: Ensemble | Window, *rest: Any) -> dict[str, Any]:
        if isinstance(first, Window):
            return _named(first.forecast.ensemble, first.predicted, first.observation, first.memory)
        return _named(first, *rest)

    study_of(linear_problem(8)).run(lambda: watched(factory(), handed))


def _named(forecast: Ensemble, predicted: Array, observation: Observation, memory: Memory | None) -> dict[str, Any]:
    parts: dict[str, Any] = {"the forecast's members": forecast.members, "the forecast's weights": forecast.weights}
    parts |= {"the predicted readings": predicted, "the memory": memory}
    return parts | {"the readings": observation.values, "R": observation.covariance}


@check("filter")
def determinism(factory: Factory) -> None:
    """The same inputs and the same generator give the same bits: a study can be repeated."""
    for m in (1, 3):
        problem = linear_problem(8, 5, m)
        with global_generators():
            first = asked(factory, problem)
        with global_generators():
            second = asked(factory, problem)
        require_same_cycles(first, second, f"m = {m}: two analyses of the same differ")


@check("filter")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the generator passed in, never from global ones, which any other code may advance."""
    with no_global_draws():
        asked(factory, linear_problem(6))


@check("filter")
def told_covariance(factory: Factory) -> None:
    """A filter uses only the covariance R that it is given; it does not look at the covariance that the noise was drawn from."""  # noqa: E501
    problem = linear_problem(8)
    operator = dataclasses.replace(problem.operator, noise_covariance=7.0 * problem.operator.covariance)
    other = dataclasses.replace(problem, operator=operator)
    message = "it changes with a noise that the filter is not told"
    require_same_cycles(asked(factory, problem), asked(factory, other), message)


@check("filter")
def member_order(factory: Factory) -> None:
    """Members are exchangeable: a forecast with its members in another order has the same analysis in that order, weights included."""  # noqa: E501
    order = np.array([3, 0, 5, 1, 4, 2])
    problem = linear_problem(len(order), 4)
    turned = problem.with_members(problem.forecast.members[order])
    back = (np.arange(len(order)), np.argsort(order))

    def in_order(belief: Ensemble, which: int) -> Array:
        return np.column_stack([belief.members, shares(belief)])[back[which]].ravel()

    require_equal_law(factory, problem, turned, in_order, "it depends on the order of the members")


@check("filter")
def reading_order(factory: Factory) -> None:
    """Mean and covariance of a linear-Gaussian analysis do not depend on the order in which the readings are listed."""
    for full in (False, True):
        problem = linear_problem(8, 5, 4, full=full)
        turned = problem.in_order(np.array([2, 0, 3, 1]))
        message = f"it depends on the order of the readings ({'full' if full else 'diagonal'} R)"
        require_equal_law(factory, problem, turned, lambda belief, _: moments(belief), message)


def _worthless(factory: Factory, problem: Problem) -> list[tuple[int, Cycle]]:
    """Return the number and the cycle of analyses whose readings carry no information.

    These are the first analysis, and the third after two whose readings are informative. A filter that looks back may
    use these two again, so none of its readings are informative.
    """
    nothing = problem.with_errors(WORTHLESS)
    if factory().window != 0:
        return list(enumerate(asked(factory, nothing), 1))
    return [(1, asked(factory, nothing)[0]), (3, asked(factory, problem, problem, nothing)[-1])]


@check("filter")
def prior_kept(factory: Factory) -> None:
    """Readings without information (a huge R) do not change the mean and covariance of the forecast."""
    for full in (False, True):
        for number, cycle in _worthless(plain(factory), linear_problem(8, 5, 3, full=full)):
            message = f"analysis {number}: with R -> infinity the prior has changed"
            require_close(moments(after(cycle)), moments(cycle.forecast), 1e-6, message)


@check("filter")
def inflation(factory: Factory) -> None:
    """If the readings carry no information, inflation multiplies the anomalies by its factor, for any accepted value, and keeps the mean."""  # noqa: E501
    name = inflation_option(factory())
    if name is None:
        raise NotApplicable("has no option 'inflation' and declares no other as inflation_option")
    factors = [factor for factor in (1.05, 1.5, 3.0) if takes(with_option(factory, **{name: factor}))]
    require(factors, f"the option {name} takes neither 1.05 nor 1.5 nor 3")
    for factor in factors:
        for number, cycle in _worthless(with_option(plain(factory), **{name: factor}), linear_problem(8)):
            mean = cycle.forecast.mean
            expected = moments(cycle.forecast)
            expected[len(mean) :] *= factor**2
            message = f"analysis {number}: with R -> infinity and {name} = {factor} the spread is not {factor} times"
            require_close(moments(after(cycle)), expected, 1e-6, f"{message} the forecast's")


@check("filter")
def angle_seam(factory: Factory) -> None:
    """An angle has no preferred direction: if a belief is rotated across 0 = 2 pi, its analysis is rotated by the same angle."""  # noqa: E501
    space, angle = gas_space(), gas_space().slice("wind_direction")
    problem = accepted(factory, gas_problem(np.pi))
    for turn in (np.pi, np.pi - 0.3, np.pi + 0.3):
        step = np.zeros(space.size)
        step[angle] = turn
        turned = problem.with_members(space.retract(problem.forecast.members, step))
        pairs = zip(asked(factory, problem, still=True), asked(factory, turned, still=True), strict=True)
        for number, (first, second) in enumerate(pairs, 1):
            off = space.difference(after(second).members, after(first).members + step)
            message = f"analysis {number}: a belief whose directions are turned by {turn:.3g} rad has another analysis"
            require_close(off, np.zeros_like(off), ROUNDING, message)


@check("filter")
def stays_in_set(factory: Factory) -> None:
    """Analyses keep every variable in its range: nonnegative numbers are not below zero, positive numbers are above zero, and angles lie in [0, 2 pi)."""  # noqa: E501
    for seed, problem in enumerate(bounded_problems()):
        for cycle in asked(factory, accepted(factory, problem), seed=seed, still=True):
            require_in_set(problem.forecast.space, after(cycle).members, "the analysis")


@check("filter")
def infinite_radius(factory: Factory) -> None:
    """With a huge localization radius the analysis is the global one: the places of the readings no longer matter."""
    option = factory().localization_option
    if option is None:
        raise NotApplicable("declares no localization_option")
    problem = linear_problem(8, 6, 3)
    elsewhere = problem.with_places(np.array([[290.0, 5.0], [-40.0, 80.0], [10.0, -60.0]]))
    first, second = (asked(plain(factory), each) for each in (problem, elsewhere))
    for one, other in zip(first, second, strict=True):
        message = f"with {option} -> infinity places still matter"
        require_close(after(other).members, after(one).members, ROUNDING, message)


@check("filter")
def restart(factory: Factory) -> None:
    """A run stopped after any cycle and continued from its file has the same bits: the plugin keeps nothing on itself."""  # noqa: E501
    problem = linear_problem(6)
    study = study_of(*(dataclasses.replace(problem, values=problem.values + 0.1 * cycle) for cycle in range(5)))
    study = study.remembering(error_sd=0.1)
    with global_generators():
        whole = study.run(factory)
    with global_generators():
        pieces = study.run(factory, cut=True)
    require_same_cycles(whole, pieces, "it differs in a run that was cut off before it")
