"""Carrying the gas of an ensemble through several steps, one member after the other, or some members side by side.

A member's factorised matrix stays in the processor's cache from one step to the next, and threads need no messages.
docs/fast-winds.md, "Re-runs", has the figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np

from dafw.core.ensemble import Diagnostic, Diagnostics
from dafw.core.errors import about_member
from dafw.core.space import Array
from dafw.plugins.models.dispersion.mesh.partition import Partition, Undivided


def carry(
    fields: Sequence[Array],
    winds: Sequence[Array],
    rates: Sequence[Array | None],
    diffusion: Array,
    system_of: Callable[[Array, float], Callable[[], Any]],
    nodes: Partition | Undivided,
    threads: int = 1,
    most_systems: int = 1,
) -> list[Diagnostics]:
    """Transport the concentrations of the members, and return the diagnostics of every step.

    Args:
        fields: for every step (N, nodes); the first holds the concentrations at the start. All are overwritten with the
            concentrations after the step.
        winds: for every step (N, k), a row for each member that defines its wind.
        rates: for every step what the leaks add (N, nodes), in concentration per second; None without leaks.
        diffusion: (N,) coefficients in m^2/s.
        system_of: reserves a place for the ``System`` of a step in a wind (k,) with a coefficient, and returns a
            function that makes it, if it is not there. The function may be called in another thread.
        nodes: the step between the nodes of the state and those of the transport on this rank.
        threads: how many members are carried side by side. No bit depends on it.
        most_systems: how many systems have a place at a time. If that is not enough, there is one thread.

    Errors name the member; of several, the first.
    """
    n_members = len(diffusion)
    gas, gone = np.zeros((2, len(fields), n_members))
    parts = [_same_wind(winds, member) for member in range(n_members)]

    def reserved(member: int, first: int) -> Callable[[], Any]:
        with about_member(member):
            return system_of(winds[first][member], diffusion[member])

    def carry_one(member: int, systems: Sequence[Callable[[], Any]] | None = None) -> bool:
        """Carry one member, and return whether the scheme keeps an account of the gas."""
        field, keeps_account = fields[0][member], False
        for number, (first, last) in enumerate(parts[member]):
            make = reserved(member, first) if systems is None else systems[number]
            with about_member(member):
                system = make()
                leaks = [None if rate is None else nodes.local(rate[member]) for rate in rates[first:last]]
                keeps_account = hasattr(system, "balanced_steps")
                if keeps_account:
                    found, gone[first:last, member] = system.balanced_steps(field, leaks)
                    gas[first:last, member] = [system.gas(one) for one in found]
                    for after, one in zip(fields[first:last], found, strict=True):
                        after[member] = one
                else:
                    for after, rate in zip(fields[first:last], leaks, strict=True):
                        after[member] = nodes.gather(system.step(nodes.local(field), rate))
                        field = after[member]
            field = fields[last - 1][member]
        return keeps_account

    if min(threads, n_members) > 1 and sum(map(len, parts)) <= most_systems:
        places = [[reserved(member, first) for first, _ in parts[member]] for member in range(n_members)]
        with ThreadPoolExecutor(min(threads, n_members)) as pool:
            kept_account = list(pool.map(carry_one, range(n_members), places))
    else:
        kept_account = [carry_one(member) for member in range(n_members)]
    return [_account(*step) for step in zip(gas, gone, strict=True)] if all(kept_account) else [{} for _ in fields]


def _same_wind(winds: Sequence[Array], member: int) -> list[tuple[int, int]]:
    """Return the first step of every wind of a member, and the step after its last."""
    changes = [
        step for step in range(1, len(winds)) if not np.array_equal(winds[step][member], winds[step - 1][member])
    ]
    return list(pairwise([0, *changes, len(winds)]))


def _account(gas: Array, gone: Array) -> Diagnostics:
    return {
        "gas": Diagnostic(gas, ("member",), "m2", "integral of the forecast concentration over the site"),
        "gas_gone": Diagnostic(gone, ("member",), "m2", "gas that left through the outer boundary in a step"),
    }
