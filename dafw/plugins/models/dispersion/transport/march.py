"""Several flux-corrected steps in one wind with factorised matrices, in one compiled loop.

One call takes a member through a whole re-run. Calls for different members may run in different threads: the loop does
not hold Python's lock. The steps and their symbols are those of flux_corrected.py; figures are in docs/fast-winds.md,
"Re-runs".
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dafw.plugins.models.dispersion.fem.paired_lu import solve
from dafw.plugins.models.dispersion.transport.limiter import corrected


@njit(cache=True, nogil=True)
def march(
    starts: np.ndarray,
    second: np.ndarray,
    own: np.ndarray,
    between: np.ndarray,
    lumped: np.ndarray,
    fill_starts: np.ndarray,
    fill_rows: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    inverse: np.ndarray,
    places: np.ndarray,
    entries: np.ndarray,
    nodal: np.ndarray,
    free: np.ndarray,
    dt: float,
    concentration: np.ndarray,
    rates: np.ndarray,
    after: np.ndarray,
    gone: np.ndarray,
) -> int:
    """Take a concentration through steps; return how many were done: fewer if a solution is not finite.

    Args:
        starts: (n + 1,) that of ``Edges``.
        second: (e,) that of ``Edges``.
        own: (n,) entries of the mass matrix on the diagonal, over the time step.
        between: (e,) its entries between the nodes of every edge, over the time step.
        lumped: (n,) lumped mass over the time step, zero at fixed nodes.
        fill_starts: (n + 1,) ``fill_starts``, ``fill_rows``, ``lower``, ``upper``, ``inverse`` and ``places`` are those
            of ``PairedLU`` and its elimination.
        fill_rows: (f,)
        lower: (f, 2)
        upper: (f, 2)
        inverse: (n, 2)
        places: (n,)
        entries: (3, e) as for ``corrected``.
        nodal: (3, n) as for ``corrected``.
        free: (n,) as for ``corrected``.
        dt: time step in s.
        concentration: (n,) at the start.
        rates: (steps, n) what sources add in every step, in concentration per second; (0, n) without sources.
        after: (steps, n) overwritten with the concentrations at the end of the steps.
        gone: (steps,) overwritten with the gas in m^2 that left in every step.
    """
    supplied = concentration.copy()
    for step in range(after.shape[0]):
        if rates.shape[0] > 0:
            supplied += dt * rates[step]
        given, given_lumped = right_sides(starts, second, own, between, lumped, supplied)
        high, low = solve(fill_starts, fill_rows, lower, upper, inverse, places, given, given_lumped)
        if not np.isfinite(high.sum() + low.sum()):
            return step
        new, gone[step] = corrected(starts, second, entries, nodal, free, high, low, supplied)
        for i in range(new.size):  # not ``after[step] = new``: the message about shapes takes numba four seconds more
            after[step, i] = new[i]
        supplied = new
    return after.shape[0]


@njit(cache=True)
def right_sides(
    starts: np.ndarray,
    second: np.ndarray,
    own: np.ndarray,
    between: np.ndarray,
    lumped: np.ndarray,
    supplied: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the right-hand sides (n,) of Galerkin's system and of that of low order, zero at fixed nodes.

    Along the edges, since the limiter reads them as well: the mass matrix would take a part of the processor's cache,
    and a step 7 % more time. The arguments are those of ``march``; ``supplied`` (n,) is the concentration at the start
    of the step, with what the source adds.
    """
    given, given_lumped = own * supplied, lumped * supplied
    for i in range(supplied.size):
        for edge in range(starts[i], starts[i + 1]):
            j = second[edge]
            given[i] += between[edge] * supplied[j]
            given[j] += between[edge] * supplied[i]
    for i in range(supplied.size):
        if lumped[i] == 0.0:
            given[i] = 0.0
    return given, given_lumped
