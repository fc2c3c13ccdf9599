"""Sequential Monte Carlo of the control variables: the members are reweighted, tempered, resampled and moved.

The members are weighted samples z of the posterior of the control variables, each with its run of the model since the
start. They were last moved for the target p L^b, with the prior p and the likelihood L of the readings at that time.
Since then new readings have changed L, and the weights are ::

    w(z) = p(z) L(z) / q(z),    q(z) = p(z) L_then(z)^b

If their effective sample size falls below a share ``enough`` of the members, then until it does not (and once, every
``refresh`` cycles, unless they are as good as equal, so that members that agree with each other do not stay where they
are for ever):

1. *Temper.* The next target is p L^b with the largest power b <= 1 for which the weights p L^b / q have the wanted
   effective size; or, if none has, the power with the largest.
2. *Resample* with these weights.
3. *Move* by Metropolis steps that leave p L^b as it is. Every proposal is run again from the start and judged on all
   readings. A share ``fresh`` of the proposals are draws from the first guess, so that another mode can be found. The
   others are steps along the difference of two other members, times a lognormal number, and a little noise. One half of
   the members moves along differences within the other half, so that the moves are exact however few the members are.

The likelihood of all readings is tempered, that of past ones too: where a new reading contradicts the belief, the
belief becomes as broad as the reading asks for before it narrows again. If the budget of ``steps`` ends before b = 1,
the weights are as unequal as they are, and the next analysis goes on from there.

Del Moral, Doucet and Jasra (2006), doi:10.1111/j.1467-9868.2006.00553.x; Chopin (2002), doi:10.1093/biomet/89.3.539;
steps along differences: ter Braak (2006), doi:10.1007/s11222-006-8769-1; halves: Foreman-Mackey et al. (2013),
doi:10.1086/670067.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dafw.core.ensemble import Analysis, Diagnostic, Memory
from dafw.core.interfaces import Filter
from dafw.core.options import option
from dafw.core.space import Array, IntArray, StateSpace
from dafw.core.window import Window
from dafw.plugins.filters.candidates import Candidates, first_candidates, log_prior_of, readings_before, tried
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.slow_sensors import response_seen
from dafw.plugins.filters.waiting import marked, unmarked, waits
from dafw.plugins.filters.weights import effective_size, normalized, systematic

POWERS = np.append(0.0, np.geomspace(1e-6, 1.0, 200))
"""Powers of the likelihood that are considered; from one to the next the effective size hardly changes."""
EQUAL = 0.999
"""Effective sample size, per member, above which weights are as good as equal: nothing has been learnt."""
NOISE = 0.1
"""Standard deviation of a step's noise, relative to the members': differences alone may span too few directions."""


@dataclass
class SMC(Filter):
    """Members are weighted; where the weights are degenerate they are resampled and moved, each with a new run."""

    weighs_first_guess = True
    accuracy = "statistical"
    window = None
    past_beliefs = "first"
    inflation_option = None
    smallest_ensemble = 4

    estimate: list[str] = option([], "names of the control variables; none: all single numbers of the state")
    likelihood: Likelihood = option(Likelihood, "how likely a reading is")
    every: int = option(1, "cycles from one analysis to the next", minimum=1)
    steps: int = option(
        2000, "steps of the model, summed over members, that re-runs in one analysis may take", minimum=0
    )
    enough: float = option(
        0.5, "effective sample size, per member, below which members are moved", above=0.0, maximum=1.0
    )
    refresh: int | None = option(
        2, "cycles after which members are moved if their weights differ at all; null: never", minimum=1
    )
    sweeps: int = option(3, "Metropolis steps of every member at each power of the likelihood", minimum=1)
    fresh: float = option(0.3, "share of proposals that are drawn from the first guess", minimum=0.0, maximum=1.0)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return few moves, so that the checks, which make thousands of analyses, take less than a minute."""
        return {"steps": 600}

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError for control variables that the state does not have."""
        Controls(space, self.estimate)

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether readings wait for the next analysis."""
        return waits(memory)

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the members with weights, moved where the weights are degenerate."""
        number, ensemble = window.cycles[-1].number, window.forecast.ensemble
        if (number + 1) % self.every:
            return Analysis(ensemble.members, marked(window.memory, window), weights=ensemble.weights)
        window = replace(window, memory=unmarked(window.memory))
        size, n_cycles = len(ensemble), len(window.cycles)
        moves = Moves(self, window, rng)
        members = self._known(window, moves.controls, size, rng)
        moved = number + 1 if window.memory is None else int(window.memory["moved"])
        power, is_due = 1.0, self.refresh is not None and number + 1 - moved >= self.refresh
        while True:
            log_base = members.log_prior - members.log_proposal
            fit = self.likelihood.averaged(members.fit)
            weights = normalized(log_base + fit)
            effective = effective_size(weights)
            is_degenerate = effective < self.enough * size or (is_due and effective < EQUAL * size)
            if not is_degenerate or moves.left < n_cycles:
                break
            power = next_power(log_base, fit, self.enough * size)
            members = moves.made(members, normalized(log_base + power * fit), power)
            moved, is_due = number + 1, False
        still = np.zeros(ensemble.space.size)
        belief = ensemble.space.retract(members.now.ensemble.members, still)
        done = {"done": np.array(number + 1), "seen": np.array(readings_before(window, number + 1))}
        done |= {"moved": np.array(moved)}
        absolute, relative = self.likelihood.size_of_error(members.fit, weights)
        named: dict[str, tuple[Any, str]] = {
            "runs": (moves.runs, "runs of the model since the start in this analysis"),
            "accepted": (moves.accepted, "members that moved, counted once for each move"),
            "power": (power, "power of the likelihood for which members were last moved in this analysis"),
            "effective_size": (effective_size(weights), "effective sample size of the members"),
            "model_error_absolute": (absolute, "estimated size of the model's error, in units of the readings"),
            "model_error_relative": (relative, "estimated size of the model's error, relative"),
        }
        diagnostics = {name: Diagnostic(value, long_name=text) for name, (value, text) in named.items()}
        diagnostics |= self.likelihood.seen(window, members.predicted, members.fit, weights)
        diagnostics |= response_seen(members.fit, weights, self.likelihood)
        memory = {**members.to_memory(), **done}
        return Analysis(belief, memory, diagnostics, weights, model_memory=members.now.memory)

    def _known(self, window: Window, controls: Controls, size: int, rng: np.random.Generator) -> Candidates:
        """Return the members so far, carried to the present; those that the model cannot run are replaced by others."""
        if window.memory is None:
            first = first_candidates(window, controls, self.likelihood)
            members = replace(first, log_proposal=first.log_prior)
        else:
            members = Candidates.from_memory(window.memory, controls.space)
            members = members.carried_on(window, window.memory, self.likelihood)
        if len(members) == size:
            return members
        # How often a member is taken is its weight in q: q itself is unchanged.
        return members.taken(systematic(np.full(len(members), 1.0 / len(members)), size, rng.random()))


def next_power(log_base: Array, fit: Array, wanted: float) -> float:
    """Return the largest of ``POWERS`` for which the weights base L^power have the wanted effective size.

    ``log_base`` and ``fit``, log L, are (N,). If none of the powers has it, the one with the largest is returned.
    """
    sizes = []
    for power in POWERS[::-1]:
        sizes.append(effective_size(normalized(log_base + power * fit)))
        if sizes[-1] >= wanted:
            return float(power)
    return float(POWERS[np.argmax(sizes[::-1])])


def resampled(weights: Array, rng: np.random.Generator) -> IntArray:
    """Return which member (N,) is taken in each place, drawn from weights (N,); those that survive keep their place."""
    size = len(weights)
    order = rng.permutation(size)
    copies = np.bincount(order[systematic(weights[order], size, rng.random())], minlength=size)
    indices = np.arange(size)
    indices[copies == 0] = rng.permutation(np.repeat(indices, np.maximum(copies - 1, 0)))
    return indices


class Moves:
    """The moves of one analysis.

    Attributes:
        controls: the control variables.
        left: steps of the model that may still be taken.
        runs, accepted: how many proposals were run, and how many of them became members.
    """

    def __init__(self, options: SMC, window: Window, rng: np.random.Generator) -> None:
        self.controls = Controls(window.first.ensemble.space, options.estimate)
        self.left, self.runs, self.accepted = options.steps, 0, 0
        self._options, self._window, self._rng, self._batches = options, window, rng, 0

    def made(self, members: Candidates, weights: Array, power: float) -> Candidates:
        """Return members resampled with ``weights`` (N,) and moved for p L^power, as far as the budget goes."""
        size = len(members)
        offset = self.controls.offset(members.coordinates, members.coordinates[np.argmax(weights)])
        spread = np.sqrt(weights @ (offset - weights @ offset) ** 2)
        members = members.taken(resampled(weights, self._rng))
        for _ in range(self._options.sweeps):
            order = self._rng.permutation(size)
            halves = order[: size // 2], order[size // 2 :]
            for moving, others in (halves, halves[::-1]):
                affordable = moving[: self.left // len(self._window.cycles)]
                if len(affordable):
                    members = self._half(members, affordable, others, spread, power)
        fit = self._options.likelihood.averaged(members.fit)
        return replace(members, log_proposal=members.log_prior + power * fit)

    def _half(self, members: Candidates, moving: IntArray, others: IntArray, spread: Array, power: float) -> Candidates:
        """Return the members after a Metropolis step of those that are ``moving``, along differences of ``others``."""
        window, rng, m, likelihood = self._window, self._rng, len(moving), self._options.likelihood
        fresh = window.rerun.first_guess(m, f"fresh members {self._batches}", window.cycles[-1].number).members
        self._batches += 1
        is_fresh = rng.random(m) < self._options.fresh
        walked = members.coordinates[moving] + self._steps(members.coordinates[others], m, spread)
        settle = not self.controls.has_fields
        walked_to = self.controls.at(window.rerun, members.starts[moving], walked, settle=settle)
        starts = np.where(is_fresh[:, np.newaxis], fresh, walked_to)
        coordinates = self.controls.coordinates(starts)
        log_prior = log_prior_of(window, self.controls, starts, coordinates)
        dice = np.log(rng.random(m))
        possible = np.flatnonzero(log_prior > -np.inf)
        self.left -= len(possible) * len(window.cycles)
        self.runs += len(possible)
        found = tried(window, starts[possible], coordinates[possible], log_prior[possible], likelihood)
        if found is None:
            return members
        proposed, ran = found[0], possible[found[1]]
        before = members.taken(moving[ran])
        log_ratio = power * (likelihood.averaged(proposed.fit) - likelihood.averaged(before.fit))
        # A draw from the first guess is proposed with the density p, so that p cancels.
        log_ratio += np.where(is_fresh[ran], 0.0, proposed.log_prior - before.log_prior)
        taken = np.flatnonzero(dice[ran] < log_ratio)
        self.accepted += len(taken)
        indices = np.arange(len(members))
        indices[moving[ran[taken]]] = len(members) + taken
        return members.joined(proposed).taken(indices)

    def _steps(self, others: Array, m: int, spread: Array) -> Array:
        """Return ``m`` steps (m, k) along differences of other members (M, k), as long as suits k dimensions."""
        rng, (n_others, k) = self._rng, others.shape
        first = rng.integers(n_others, size=m)
        second = (first + rng.integers(1, n_others, size=m)) % n_others
        along = self.controls.offset(others[first], others[second]) / np.sqrt(2.0)
        scale = 2.38 / np.sqrt(k) * np.exp(rng.standard_normal(m))
        return np.asarray(scale[:, np.newaxis] * (along + NOISE * spread * rng.standard_normal((m, k))))
