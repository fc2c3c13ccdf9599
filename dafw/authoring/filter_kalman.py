"""Checks of filters against the Kalman filter, with the accuracy that the filter declares."""

from __future__ import annotations

import numpy as np

from dafw.authoring.checks import ConformanceError, Factory, NotApplicable, check
from dafw.authoring.evidence import require_close, require_mean
from dafw.authoring.filter_trials import ROUNDING, SEEDS, asked, declines, moments, plain
from dafw.authoring.problems import kalman, linear_problem, prior
from dafw.authoring.small_study import after, growth
from dafw.core.interfaces import Filter

ACCURACIES = ("exact", "statistical", "none")
MANY = 200
"""Number of members in one sample of the statistical check."""


def require_accuracy(filter_: Filter, wanted: str) -> None:
    """Raise NotApplicable if the filter claims another accuracy, ConformanceError if there is no such claim."""
    if filter_.accuracy not in ACCURACIES:
        raise ConformanceError(f"accuracy must be one of {', '.join(ACCURACIES)}; got {filter_.accuracy!r}")
    if filter_.accuracy != wanted:
        raise NotApplicable(f"declares its accuracy as '{filter_.accuracy}'")


@check("filter")
def kalman_exact(factory: Factory) -> None:
    """For linear, Gaussian problems, sample mean and covariance of the analysis are the Kalman filter's, to rounding."""  # noqa: E501
    require_accuracy(factory(), "exact")
    for n_members, n, m, full in ((12, 5, 3, False), (12, 5, 3, True), (4, 8, 5, True), (3, 4, 1, False)):
        problem = linear_problem(n_members, n, m, full=full)
        if n_members < n and declines(factory, problem):
            continue
        for number, cycle in enumerate(asked(plain(factory), problem), 1):
            mean, covariance = np.split(moments(cycle.forecast), [n])
            expected = kalman(mean, covariance.reshape(n, n), cycle.observation.values, problem.operator)
            where = f"analysis {number} (N = {n_members}, n = {n}, m = {m})"
            require_close(moments(after(cycle)), expected, ROUNDING, f"{where} is not the Kalman filter's")


@check("filter")
def kalman_statistical(factory: Factory) -> None:
    """For linear, Gaussian problems, mean and covariance of the analysis are the Kalman filter's on average over samples of many members."""  # noqa: E501
    require_accuracy(factory(), "statistical")
    n, m = 4, 2
    problem, root = linear_problem(MANY, n, m, full=True, seed=0), np.linalg.cholesky(prior(n)[1])
    found = []
    for seed in range(SEEDS):
        drawn = np.random.default_rng([seed, 7]).standard_normal((MANY, n)) @ root.T
        cycles = asked(plain(factory), problem.with_members(prior(n)[0] + drawn), seed=seed)
        found.append([moments(after(cycle)) for cycle in cycles])
    mean, covariance = prior(n)
    for number, cycle in enumerate(cycles):
        mean, covariance = growth(n) @ mean, growth(n) @ covariance @ growth(n).T
        expected = kalman(mean, covariance, cycle.observation.values, problem.operator)
        mean, covariance = expected[:n], expected[n:].reshape(n, n)
        message = f"{MANY} members: analysis {number + 1} is not the Kalman filter's"
        require_mean(np.array(found)[:, number], expected, message)
