"""Checks of filters: the interface, and what no filter may depend on. Against the exact answer: filter_kalman.py."""

from __future__ import annotations

import dataclasses

import numpy as np

from dafw.authoring.asking import ask
from dafw.authoring.checks import ConformanceError, Factory, NotApplicable, check, require
from dafw.authoring.evidence import (
    frozen,
    global_generators,
    no_global_draws,
    require_close,
    require_same_bits,
    restored,
)
from dafw.authoring.filter_trials import (
    ROUNDING,
    accepted,
    analysed,
    moments,
    problems,
    require_equal_law,
    unlocalized,
)
from dafw.authoring.problems import gas_problem, gas_space, linear_problem
from dafw.core.ensemble import Ensemble, Memory
from dafw.core.observation import Observation
from dafw.core.space import Array


@check("filter")
def shapes(factory: Factory) -> None:
    """An analysis has the forecast's shape and finite numbers, for few and many members, with one reading or many, with a diagonal and a full R, and with no reading at all."""  # noqa: E501
    for name, problem in problems(factory()):
        try:
            analysed(factory(), problem)
            nothing = problem.in_order(np.empty(0, dtype=np.int64))
            members = analysed(factory(), nothing).members
            require_same_bits(members, problem.forecast.members, "no readings, and another belief")
        except Exception as error:
            raise ConformanceError(f"{name}: {' '.join(str(error).split()) or type(error).__name__}") from error


@check("filter")
def inputs_unchanged(factory: Factory) -> None:
    """Forecast, predicted readings, observation and memory are left as they were handed in: others still need them."""
    filter_, problem = factory(), linear_problem(8)
    memory = filter_.initial_memory(len(problem.forecast))
    observation, predicted, members = problem.observation, problem.predicted, problem.forecast.members

    def now() -> dict[str, bytes]:
        parts = {"the forecast's members": members, "the predicted readings": predicted, "the memory": memory}
        parts |= {"the readings": observation.values, "R": observation.covariance}
        return {name: frozen(value) for name, value in parts.items()}

    before = now()
    for _ in range(2):
        ask(filter_, problem.forecast, predicted, observation, memory, np.random.default_rng(0))
    changed = [name for name, bits in now().items() if bits != before[name]]
    require(not changed, f"an analysis changed {', '.join(changed)}")


@check("filter")
def determinism(factory: Factory) -> None:
    """The same inputs and the same generator give the same bits: a study can be repeated."""
    for m in (1, 3):
        problem = linear_problem(8, 5, m)
        with global_generators():
            first = analysed(factory(), problem).members
        with global_generators():
            second = analysed(factory(), problem).members
        require_same_bits(first, second, f"m = {m}: two analyses of the same differ")


@check("filter")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the generator handed in: global ones are shared, and change when anything else does."""
    with no_global_draws():
        analysed(factory(), linear_problem(6))


@check("filter")
def told_covariance(factory: Factory) -> None:
    """A filter knows the errors of the readings as it is told them: how the noise was really drawn is the truth's."""
    problem = linear_problem(8)
    operator = dataclasses.replace(problem.operator, noise_covariance=7.0 * problem.operator.covariance)
    other = dataclasses.replace(problem, operator=operator)
    first, second = analysed(factory(), problem).members, analysed(factory(), other).members
    require_same_bits(first, second, "the analysis changes with a noise that the filter is not told")


@check("filter")
def member_order(factory: Factory) -> None:
    """Members are exchangeable: a forecast with its members in another order has the same analysis in that order."""
    order = np.array([3, 0, 5, 1, 4, 2])
    problem = linear_problem(len(order), 4)
    turned = problem.with_members(problem.forecast.members[order])
    message = "the analysis depends on the order of the members"
    back = (np.arange(len(order)), np.argsort(order))
    require_equal_law(factory, problem, turned, lambda members, which: members[back[which]].ravel(), message)


@check("filter")
def reading_order(factory: Factory) -> None:
    """Mean and covariance of a linear-Gaussian analysis do not depend on the order in which the readings are listed."""
    for full in (False, True):
        problem = linear_problem(8, 5, 4, full=full)
        turned = problem.in_order(np.array([2, 0, 3, 1]))
        message = f"the analysis depends on the order of the readings ({'full' if full else 'diagonal'} R)"
        require_equal_law(factory, problem, turned, lambda members, _: moments(members), message)


@check("filter")
def prior_kept(factory: Factory) -> None:
    """Readings that are worth nothing (R without bound) leave mean and covariance of the forecast as they were."""
    for full in (False, True):
        problem = linear_problem(8, 5, 3, full=full).with_errors(1e16)
        found = moments(analysed(factory(), problem).members)
        require_close(found, moments(problem.forecast.members), 1e-6, "with R -> infinity the prior has changed")


@check("filter")
def angle_seam(factory: Factory) -> None:
    """An angle has no preferred direction: a belief turned across 0 = 2 pi has the same analysis, turned as far."""
    space, angle = gas_space(), gas_space().slice("wind_direction")
    problem = accepted(factory, gas_problem(np.pi))
    for turn in (np.pi, np.pi - 0.3, np.pi + 0.3):
        step = np.zeros(space.size)
        step[angle] = turn
        turned = problem.with_members(space.retract(problem.forecast.members, step))
        first, second = analysed(factory(), problem).members, analysed(factory(), turned).members
        off = space.difference(second, first + step)
        message = f"a belief whose directions are turned by {turn:.3g} rad has another analysis"
        require_close(off, np.zeros_like(off), ROUNDING, message)


@check("filter")
def stays_in_set(factory: Factory) -> None:
    """Analyses stay where the state may be: what cannot be negative is not, and angles lie in [0, 2 pi)."""
    space = gas_space()
    for seed, direction in enumerate((0.05, 3.0, 6.25)):
        problem = accepted(factory, gas_problem(direction, seed))
        members = space.unpack(analysed(factory(), problem, seed).members)
        for name in ("concentration", "wind_speed"):
            lowest = members[name].min()
            require(lowest >= 0.0, f"'{name}' is nonnegative, the analysis holds {lowest:.3g}")
        angles = members["wind_direction"]
        outside = angles[(angles < 0.0) | (angles >= 2.0 * np.pi)]
        require(outside.size == 0, f"an angle lies in [0, 2 pi), the analysis holds {outside[:1]}")


@check("filter")
def infinite_radius(factory: Factory) -> None:
    """With a localization radius without bound the analysis is the global one: it matters no longer where readings are."""  # noqa: E501
    plain = factory()
    if plain.localization_option is None:
        raise NotApplicable("declares no localization_option")
    problem = linear_problem(8, 6, 3)
    elsewhere = problem.with_places(np.array([[290.0, 5.0], [-40.0, 80.0], [10.0, -60.0]]))
    first, second = (analysed(unlocalized(plain), each).members for each in (problem, elsewhere))
    require_close(second, first, ROUNDING, f"with {plain.localization_option} -> infinity places still matter")


@check("filter")
def restart(factory: Factory) -> None:
    """A run cut off after any cycle and continued from its file has the same bits: nothing is remembered on the plugin."""  # noqa: E501
    with global_generators():
        whole = _cycles(factory, fresh=False)
    with global_generators():
        pieces = _cycles(factory, fresh=True)
    for cycle, (first, second) in enumerate(zip(whole, pieces, strict=True), 1):
        require_same_bits(first, second, f"cycle {cycle}: the analysis differs in a run that was cut off before it")


def _cycles(factory: Factory, *, fresh: bool) -> list[Array]:
    """Run five cycles; ``fresh``: as if each were run by a new process that reads what the last one wrote."""
    filter_, problem = factory(), linear_problem(6)
    members, history = problem.forecast.members, []
    memory: Memory | None = filter_.initial_memory(len(members))
    for cycle in range(5):
        if fresh:
            filter_, memory = factory(), restored(memory)
        forecast = Ensemble(1.1 * members, problem.forecast.space, float(cycle))
        observation = Observation(problem.values + 0.1 * cycle, problem.operator, float(cycle))
        predicted = problem.operator.apply(forecast.members)
        analysis = ask(filter_, forecast, predicted, observation, memory, np.random.default_rng(cycle))
        members, memory = analysis.members, analysis.memory
        history.append(members)
    return history
