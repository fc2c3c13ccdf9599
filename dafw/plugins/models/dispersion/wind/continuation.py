"""Continuation of a solution from Stokes flow to a wanted Reynolds number, in adaptive steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dafw.plugins.models.dispersion.fem.iterate import Iterate

FIRST_RATIO = 4.0
"""The first step by which the Reynolds number grows, as a factor."""
SMALLEST_RATIO = 1.05
"""The continuation gives up if a step by a factor smaller than this would be needed."""


def climb(
    solve: Callable[[np.ndarray, float], Iterate], lift: np.ndarray, reynolds: float, max_steps: int
) -> tuple[Iterate, int]:
    """Return the iterate at ``reynolds``, or the one that failed, and the factorisations made on the way.

    The first attempt goes from Stokes flow directly to ``reynolds``. A step multiplies the Reynolds number by a ratio.
    The ratio becomes its square root after a failure and its power 3/2 after a success. Look at ``converged`` of the
    iterate: it is false after ``max_steps`` attempts and if the steps became too small.

    Args:
        solve: ``solve(start, reynolds)`` is one Newton iteration from ``start`` (n,).
        lift: (n,) the boundary values, zero elsewhere.
        reynolds: wanted unit Reynolds number in 1/m.
        max_steps: largest number of attempts.
    """
    here = trial = solve(lift, 0.0)
    count, at, goal, ratio = here.factorisations, 0.0, reynolds, FIRST_RATIO
    if not here.converged or reynolds == 0.0:
        return here, count
    for _ in range(max_steps):
        trial = solve(here.unknowns, goal)
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
