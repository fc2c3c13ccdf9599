"""Continuation of a solution from Stokes flow to a wanted Reynolds number, in steps that adapt."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dafw.plugins.models.dispersion.newton import Iterate

FIRST_RATIO = 4.0
SMALLEST_RATIO = 1.05
"""Where even a step by this factor fails, there is no way on."""


def climb(
    newton: Callable[[np.ndarray, float], Iterate], lift: np.ndarray, reynolds: float, max_steps: int
) -> tuple[Iterate, int]:
    """Return the iterate at ``reynolds``, or the one that failed, and the factorisations of the whole way.

    ``newton(start, reynolds)`` is one Newton iteration and ``lift`` (n,) holds the boundary values. From the Stokes
    flow the first attempt goes all the way; a step is a factor on the Reynolds number, its root after a failure, its
    power 3/2 after a success. The caller must look at ``converged``: it is false after ``max_steps`` attempts and
    where steps became too small.
    """
    here = trial = newton(lift, 0.0)
    count, at, goal, ratio = here.factorisations, 0.0, reynolds, FIRST_RATIO
    if not here.converged or reynolds == 0.0:
        return here, count
    for _ in range(max_steps):
        trial = newton(here.unknowns, goal)
        count += trial.factorisations
        if trial.converged and goal == reynolds:
            break
        if trial.converged:
            here, at, ratio = trial, goal, ratio**1.5
        elif at > 0.0:
            ratio = (goal / at) ** 0.5
            if ratio < SMALLEST_RATIO:
                break
        goal = min(reynolds, at * ratio) if at > 0.0 else goal / FIRST_RATIO
    return trial, count
