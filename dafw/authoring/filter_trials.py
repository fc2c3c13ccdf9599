"""How the checks try a filter: the problems it is given, and how two of its analyses are held against each other."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from dafw.authoring.asking import ask
from dafw.authoring.checks import ConformanceError, Factory, NotApplicable
from dafw.authoring.evidence import require_close, require_mean, state_of
from dafw.authoring.problems import Problem, linear_problem
from dafw.core.ensemble import Analysis
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Filter
from dafw.core.space import Array

SEEDS = 64
"""Seeds over which filters that draw random numbers are averaged."""
ROUNDING = 1e-8


def analysed(filter_: Filter, problem: Problem, seed: int = 0) -> Analysis:
    """Return the filter's first analysis of the problem."""
    memory = filter_.initial_memory(len(problem.forecast))
    rng = np.random.default_rng(seed)
    return ask(filter_, problem.forecast, problem.predicted, problem.observation, memory, rng)


def declines(filter_: Filter, problem: Problem) -> str:
    """Return why the filter refuses the problem by a ConfigurationError, or nothing where it does not."""
    try:
        analysed(filter_, problem)
    except ConfigurationError as error:
        return str(error)
    except Exception:
        return ""
    return ""


def accepted(factory: Factory, problem: Problem) -> Problem:
    """Return the problem; raises NotApplicable where the filter declines it."""
    if reason := declines(factory(), problem):
        raise NotApplicable(reason)
    return problem


def moments(members: Array) -> Array:
    """Return mean and covariance of members (N, n) in one row (n + n * n,)."""
    return np.concatenate([members.mean(axis=0), np.cov(members, rowvar=False).ravel()])


def draws(filter_: Filter, problem: Problem) -> bool:
    """Say whether the filter draws from the generator that it is handed."""
    rng = np.random.default_rng(0)
    before = state_of(rng)
    memory = filter_.initial_memory(len(problem.forecast))
    ask(filter_, problem.forecast, problem.predicted, problem.observation, memory, rng)
    return state_of(rng) != before


def require_equal_law(
    factory: Factory, first: Problem, second: Problem, summary: Callable[[Array, int], Array], message: str
) -> None:
    """Raise unless both problems have the same analysis: to rounding, or on average where the filter draws numbers.

    ``summary(members, which)`` turns the analysis of problem 0 or 1 into the numbers (k,) that must agree.
    """
    filter_ = factory()
    if not draws(filter_, first):
        pair = [summary(analysed(filter_, problem).members, which) for which, problem in enumerate((first, second))]
        require_close(pair[1], pair[0], ROUNDING, message)
        return
    differences = [
        summary(analysed(filter_, second, SEEDS + seed).members, 1) - summary(analysed(filter_, first, seed).members, 0)
        for seed in range(SEEDS)
    ]
    require_mean(np.array(differences), np.zeros(len(differences[0])), message)


def problems(filter_: Filter) -> Iterator[tuple[str, Problem]]:
    """Name problems of every shape: N > n, N = n, N < n, N = 2; one reading, fewer and more than numbers; full R.

    A filter may decline any of them but the first.
    """
    for n_members, n, m in ((9, 4, 3), (9, 4, 1), (9, 4, 6), (4, 4, 2), (5, 12, 3), (2, 4, 1), (1, 4, 2)):
        for full in (False, True):
            problem = linear_problem(n_members, n, m, full=full)
            if (n_members, m) == (9, 3) or (n_members >= filter_.smallest_ensemble and not declines(filter_, problem)):
                yield f"N = {n_members}, n = {n}, m = {m}, {'full' if full else 'diagonal'} R", problem


def unlocalized(filter_: Filter) -> Filter:
    """Return the filter with a localization radius without bound, where it has one."""
    if filter_.localization_option is None:
        return filter_
    if not dataclasses.is_dataclass(filter_):
        raise ConformanceError(f"{filter_.label} is no dataclass")
    copy: Filter = dataclasses.replace(filter_, **{filter_.localization_option: 1e30})
    copy.name = filter_.name
    return copy
