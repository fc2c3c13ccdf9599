"""Trials of filters for the checks: the problems that a filter is given, and the comparison of its analyses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dafw.authoring.checks import ConformanceError, Factory, NotApplicable
from dafw.authoring.evidence import require_close, require_mean
from dafw.authoring.problems import Problem, linear_problem
from dafw.authoring.small_study import after, study_of
from dafw.core.cycle import Cycle
from dafw.core.ensemble import Ensemble
from dafw.core.errors import ConfigurationError, OptionError
from dafw.core.interfaces import Filter
from dafw.core.options import require_options
from dafw.core.space import Array

SEEDS = 64
"""Seeds over which filters that draw random numbers are averaged."""
ROUNDING = 1e-8


def asked(factory: Factory, problem: Problem, *later: Problem, seed: int = 0, still: bool = False) -> list[Cycle]:
    """Return the cycles of a small study of the problem: three analyses unless later problems are given."""
    return study_of(problem, *later, still=still).run(factory, seed=seed)


def declines(factory: Factory, problem: Problem, *, still: bool = False) -> str:
    """Return the text of the ConfigurationError by which a filter refuses the problem; '' if it accepts it."""
    try:
        asked(factory, problem, still=still)
    except ConfigurationError as error:
        return str(error)
    except Exception:  # no refusal: the check that runs the filter on this problem finds it
        return ""
    return ""


def accepted(factory: Factory, problem: Problem) -> Problem:
    """Return the problem if the filter accepts it in a study that does not move; otherwise raise NotApplicable."""
    if reason := declines(factory, problem, still=True):
        raise NotApplicable(reason)
    return problem


def moments(ensemble: Ensemble) -> Array:
    """Return mean and covariance in one row (n + n * n,), weighted if the members have weights.

    The covariance is unbiased for independent members; with weights w the divisor is 1 - sum w^2.
    """
    anomalies, weights = ensemble.anomalies, ensemble.weights
    if weights is None:
        covariance = anomalies.T @ anomalies / (len(ensemble) - 1)
    else:
        covariance = (weights[:, np.newaxis] * anomalies).T @ anomalies / (1.0 - weights @ weights)
    return np.concatenate([ensemble.mean, covariance.ravel()])


def shares(ensemble: Ensemble) -> Array:
    """Return the weight of each member times N, (N,)."""
    return np.ones(len(ensemble)) if ensemble.weights is None else len(ensemble) * ensemble.weights


def require_equal_law(
    factory: Factory, first: Problem, second: Problem, summary: Callable[[Ensemble, int], Array], message: str
) -> None:
    """Raise unless both problems have the same analyses: to rounding, or on average if the filter draws numbers.

    ``summary(belief, which)`` turns a belief after an analysis of problem 0 or 1 into the numbers (k,) that must agree.
    """

    def summaries(which: int, seed: int) -> Array:
        cycles = asked(factory, (first, second)[which], seed=seed)
        return np.stack([summary(after(cycle), which) for cycle in cycles])

    pair = summaries(0, 0), summaries(1, 0)
    if np.array_equal(pair[0], summaries(0, 1)):  # the filter draws no random numbers
        for number, (one, other) in enumerate(zip(*pair, strict=True), 1):
            require_close(other, one, ROUNDING, f"analysis {number}: {message}")
        return
    differences = np.array([summaries(1, SEEDS + seed) - summaries(0, seed) for seed in range(SEEDS)])
    for number in range(differences.shape[1]):
        of_one = differences[:, number]
        require_mean(of_one, np.zeros(of_one.shape[1]), f"analysis {number + 1}: {message}")


def problems(factory: Factory) -> Iterator[tuple[str, Problem]]:
    """Yield named problems: N > n, N = n, N < n, N = 2; one reading, fewer and more readings than n; full R.

    A filter may decline any of them but the first.
    """
    smallest = factory().smallest_ensemble
    for n_members, n, m in ((9, 4, 3), (9, 4, 1), (9, 4, 6), (4, 4, 2), (5, 12, 3), (2, 4, 1), (1, 4, 2)):
        for full in (False, True):
            problem = linear_problem(n_members, n, m, full=full)
            if (n_members, m) == (9, 3) or (n_members >= smallest and not declines(factory, problem)):
                yield f"N = {n_members}, n = {n}, m = {m}, {'full' if full else 'diagonal'} R", problem


def with_option(factory: Factory, **options: Any) -> Factory:
    """Return a factory of the same filters with some options set."""

    def make() -> Filter:
        filter_: Any = factory()
        if not dataclasses.is_dataclass(type(filter_)):
            raise ConformanceError(f"{type(filter_).__name__} is no dataclass")
        copy: Filter = dataclasses.replace(filter_, **options)
        copy.name = filter_.name
        return copy

    return make


def takes(factory: Factory) -> bool:
    """Return whether the options that the factory sets are in their ranges."""
    try:
        require_options(factory(), "")
    except OptionError:
        return False
    return True


def has_option(filter_: Filter, name: str) -> bool:
    """Return whether the filter has an option of that name."""
    return dataclasses.is_dataclass(filter_) and any(f.name == name and f.init for f in dataclasses.fields(filter_))


def inflation_option(filter_: Filter) -> str | None:
    """Return the name of the option that inflates the anomalies; None where there is none."""
    name = filter_.inflation_option
    return name if name is not None and has_option(filter_, name) else None


def plain(factory: Factory) -> Factory:
    """Return a factory of the same filters without localization and without inflation."""
    options: dict[str, float] = {}
    if (radius := factory().localization_option) is not None:
        options[radius] = 1e30
    if (inflation := inflation_option(factory())) is not None:
        options[inflation] = 1.0
    return with_option(factory, **options) if options else factory
