"""Carrying the gas of an ensemble through several steps, one member after the other.

A member's factorised matrix then stays in the processor's cache from one step to the next. docs/fast-winds.md,
"Re-runs", has the figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    system_of: Callable[[Array, float], Any],
    nodes: Partition | Undivided,
) -> list[Diagnostics]:
    """Transport the concentrations of the members, and return the diagnostics of every step.

    Args:
        fields: for every step (N, nodes); the first holds the concentrations at the start. All are overwritten with the
            concentrations after the step.
        winds: for every step (N, k), a row for each member that defines its wind.
        rates: for every step what the leaks add (N, nodes), in concentration per second; None without leaks.
        diffusion: (N,) coefficients in m^2/s.
        system_of: returns the ``System`` of a step in a wind (k,) with a coefficient.
        nodes: the step between the nodes of the state and those of the transport on this rank.

    Errors name the member.
    """
    n_members = len(diffusion)
    gas, gone = np.zeros((2, len(fields), n_members))
    keeps_account = False
    for member in range(n_members):
        with about_member(member):
            field, wind, system = fields[0][member], winds[0][member], system_of(winds[0][member], diffusion[member])
            keeps_account = hasattr(system, "balanced_step")
            for number, after in enumerate(fields):
                if not np.array_equal(wind, winds[number][member]):
                    wind = winds[number][member]
                    system = system_of(wind, diffusion[member])
                leaks = rates[number]
                rate = None if leaks is None else nodes.local(leaks[member])
                if keeps_account:
                    field, gone[number, member] = system.balanced_step(field, rate)
                    gas[number, member] = system.gas(field)
                else:
                    field = nodes.gather(system.step(nodes.local(field), rate))
                after[member] = field
    return [_account(*step) for step in zip(gas, gone, strict=True)] if keeps_account else [{} for _ in fields]


def _account(gas: Array, gone: Array) -> Diagnostics:
    return {
        "gas": Diagnostic(gas, ("member",), "m2", "integral of the forecast concentration over the site"),
        "gas_gone": Diagnostic(gone, ("member",), "m2", "gas that left through the outer boundary in a step"),
    }
