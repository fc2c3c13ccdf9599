"""Checks of filters against the Kalman filter, as closely as they declare themselves to agree with it."""

from __future__ import annotations

import numpy as np

from dafw.authoring.checks import ConformanceError, Factory, NotApplicable, check
from dafw.authoring.evidence import require_close, require_mean
from dafw.authoring.filter_trials import ROUNDING, SEEDS, analysed, declines, moments, unlocalized
from dafw.authoring.problems import kalman, linear_problem, prior
from dafw.core.interfaces import Filter

ACCURACIES = ("exact", "statistical", "none")
MANY = 400
"""Members of one sample where agreement is statistical."""


def _require_accuracy(filter_: Filter, wanted: str) -> None:
    if filter_.accuracy not in ACCURACIES:
        raise ConformanceError(f"accuracy must be one of {', '.join(ACCURACIES)}; got {filter_.accuracy!r}")
    if filter_.accuracy != wanted:
        raise NotApplicable(f"declares its accuracy as '{filter_.accuracy}'")


@check("filter")
def kalman_exact(factory: Factory) -> None:
    """Where all is linear and Gaussian, sample mean and covariance of the analysis are the Kalman filter's, to rounding."""  # noqa: E501
    _require_accuracy(factory(), "exact")
    for n_members, n, m, full in ((12, 5, 3, False), (12, 5, 3, True), (4, 8, 5, True), (3, 4, 1, False)):
        problem = linear_problem(n_members, n, m, full=full)
        if n_members < n and declines(factory(), problem):
            continue
        members = problem.forecast.members
        mean, covariance = kalman(members.mean(axis=0), np.cov(members, rowvar=False), problem)
        found = moments(analysed(unlocalized(factory()), problem).members)
        message = f"N = {n_members}, n = {n}, m = {m}: the analysis is not the Kalman filter's"
        require_close(found, np.concatenate([mean, covariance.ravel()]), ROUNDING, message)


@check("filter")
def kalman_statistical(factory: Factory) -> None:
    """Where all is linear and Gaussian, mean and covariance of the analysis are the Kalman filter's on average over samples of many members."""  # noqa: E501
    _require_accuracy(factory(), "statistical")
    filter_ = unlocalized(factory())
    n, m = 4, 2
    problems = [linear_problem(MANY, n, m, full=True, seed=0)]
    roots = np.linalg.cholesky(prior(n)[1])
    for seed in range(1, SEEDS):
        drawn = np.random.default_rng([seed, 7]).standard_normal((MANY, n)) @ roots.T
        problems.append(problems[0].with_members(prior(n)[0] + drawn))
    mean, covariance = kalman(*prior(n), problems[0])
    found = [moments(analysed(filter_, problem, seed).members) for seed, problem in enumerate(problems)]
    expected = np.concatenate([mean, covariance.ravel()])
    require_mean(np.array(found), expected, f"{MANY} members: the analysis is not the Kalman filter's")
