"""Adaptive multiple importance sampling of the control variables, each sample run again from the start.

A sample z has the weight ::

    w(z) = p(z) L(z) / q(z),    q(z) = sum_b n_b q_b(z) / sum_b n_b

with the prior p, the likelihood L of all readings so far, and the mixture q of the proposals of all batches b so far.
So a sample stays of use for good: new readings only change its likelihood. The first batch is the first guess, with q_0
= p. A further batch is proposed where the weights are degenerate, that is, where their effective sample size is below
``enough``. If they are good, but even the best sample misses the readings by more than their errors allow
(explained.py), one batch is proposed, and more if the weights are bad then. If it needs the largest of several sizes of
the model's error, batches are proposed as long as there are steps: at that size a wrong wind explains much. In cycles
without readings this goes on. A batch is drawn from ::

    q_b = fresh p + (1 - fresh) (mean over centres c and widths h of t_5(z; c, h^2 C))

Batches take turns. For one, the centres and C are those of a step with the linearised model (linearised.py): C is about
the covariance of the posterior as soon as samples are close to it. For the next, centres are drawn from clipped
weights, and C is the covariance of the samples under them: the largest weights are made equal, so that C is never that
of one lucky sample. They are as many as there are members, and at least as many as a normal distribution of the
controls has moments, so that C has all directions. A kernel counts for all samples but its own centre: else a sample
that became a centre would lose weight. The members of the belief are drawn from w, or from weights that are wider where
the model errs (persistence.py).

Cornuet, Marin, Mira and Robert (2012), doi:10.1111/j.1467-9469.2011.00756.x; the mixture q is the deterministic one of
Veach and Guibas (1995), doi:10.1145/218380.218498. Clipping: Koblents and Miguez (2015),
doi:10.1007/s11222-013-9440-2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dafw.core.ensemble import Analysis, Diagnostic, Memory
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Filter
from dafw.core.options import option
from dafw.core.space import Array, StateSpace
from dafw.core.window import Window
from dafw.plugins.filters.candidates import (
    Candidates,
    first_candidates,
    log_prior_of,
    readings_before,
    rows,
    tried,
)
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.explained import errs_most, is_explained
from dafw.plugins.filters.kernels import Kernels
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.linearised import can_linearise, linearised
from dafw.plugins.filters.persistence import widened
from dafw.plugins.filters.shown import members_drawn
from dafw.plugins.filters.slow_sensors import as_shown, response_seen
from dafw.plugins.filters.waiting import marked, unmarked, waits
from dafw.plugins.filters.weights import clipped, effective_size, n_moments, normalized, without_repeats

HOPELESS = 30.0
"""A proposal whose log prior is this much below the best sample's has no weight and is not run."""
EQUAL = 0.9
"""Effective sample size, per sample, above which weights are as good as equal."""


@dataclass
class AMIS(Filter):
    """Weights samples of the unknown parameters, each with a run of the model since the start, and proposes better."""

    window = None  # all readings since the start: the samples are of the first guess
    weighs_first_guess = True
    accuracy = "statistical"
    past_beliefs = "first"
    inflation_option = None

    estimate: list[str] = option(
        [], "names of the control variables; none: all single numbers of the state. All that are unknown must be named"
    )
    likelihood: Likelihood = option(Likelihood, "how likely a reading is")
    model_independence: float = option(
        1.0,
        "power, on top of likelihood.independence, of readings in the belief's weights where the model's error is not "
        "the smallest of the likelihood's several sizes: such errors persist. Below 1 it makes the belief wider; with "
        "one size it has no effect",
        above=0.0,
        maximum=1.0,
    )
    every: int = option(1, "cycles from one analysis to the next", minimum=1)
    steps: int = option(
        1000, "steps of the model, summed over samples, that re-runs in one analysis may take", minimum=0
    )
    batches: int | None = option(
        None,
        "batches of samples that one analysis may add, null: as many as steps allow. Early analyses add many, because "
        "their re-runs are short; few let a live run keep up with its readings from the first cycle on",
        minimum=1,
    )
    enough: float = option(2.0, "effective sample size, per member, from which no sample is added", above=0.0)
    fresh: float = option(0.2, "share of new samples that are drawn from the first guess", minimum=0.0, maximum=1.0)
    archive: int = option(10, "samples kept from one analysis to the next, per member", minimum=1)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return few samples, so that the checks, which make thousands of analyses, take less than a minute."""
        return {"enough": 0.5, "steps": 600, "archive": 3}

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError for control variables that the state does not have."""
        Controls(space, self.estimate)

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether weights were left degenerate, or readings unexplained, or not looked at."""
        return waits(memory) or (memory is not None and bool(memory.get("unfinished", False)))

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return members drawn from the weighted samples."""
        number, ensemble = window.cycles[-1].number, window.forecast.ensemble
        if (number + 1) % self.every:
            return Analysis(ensemble.members, marked(window.memory, window), weights=ensemble.weights)
        window, size = replace(window, memory=unmarked(window.memory)), len(ensemble)
        controls = Controls(ensemble.space, self.estimate).left_open(window.first.ensemble.members)
        samples, kernels = self._known(window, controls)
        cost = size * len(window.cycles)
        batches = 0
        while True:
            log_base = samples.log_prior - samples.log_proposal - samples.log_kept
            fit = self.likelihood.averaged(samples.fit)
            weights = normalized(log_base + fit)
            # Weights that are all but equal are not degenerate, however few they are.
            enough = min(self.enough * size, EQUAL * len(samples))
            good = effective_size(weights) >= enough
            finished = good and is_explained(window, samples, self.likelihood)
            if finished or (good and batches and not errs_most(samples, self.likelihood)):
                break
            if cost * (batches + 1) > self.steps or batches == self.batches:
                break
            # At most half of the samples count equally: a few good ones among bad ones say nothing of the covariance.
            leading = clipped(log_base + fit, int(min(max(size, n_moments(len(controls))), 0.5 * len(samples))))
            by_slopes = batches % 2 == 0 and not self.likelihood.has_background and can_linearise(controls, leading)
            if by_slopes:
                response = as_shown(window, samples.predicted, samples.fit, weights, self.likelihood)
                seen = replace(samples, predicted=response)
                proposal = linearised(controls, seen, leading, weights, window, self.likelihood, size, rng.random())
            else:
                proposal = Kernels.around(controls, samples.coordinates, leading, size, rng)
            kernels = kernels.joined(proposal)
            samples = replace(samples, log_proposal=self._with_one_more(samples, proposal, size))
            found = self._batch(window, controls, proposal, size, (number, batches), rng, samples.log_prior.max())
            if found is not None:
                samples = samples.joined(replace(found, log_proposal=self._of_all(found, kernels, size)))
            batches += 1
        # The same offset and order in all analyses: a policy that saw other members in every cycle would turn to and
        # fro. The order is a random one, because samples stand in the order of their batches.
        known = window.memory or {"offset": np.array(rng.random()), "order": rng.permutation(size)}
        always = {name: np.asarray(known[name]) for name in ("offset", "order")}
        shown = widened(log_base, samples.fit, weights, self.likelihood, self.model_independence)
        drawn, shares = members_drawn(samples.now.ensemble, shown, size, float(always["offset"]))
        drawn, shares = drawn[always["order"]], shares[always["order"]]
        belief = rows(samples.now, drawn)
        members = ensemble.space.retract(belief.ensemble.members, np.zeros(ensemble.space.size))
        indices, chance = without_repeats(weights, self.archive * size, rng.random())
        kept = samples.taken(indices)
        kept = replace(kept, log_kept=kept.log_kept + np.log(chance))
        done = {"done": np.array(number + 1), "seen": np.array(readings_before(window, number + 1))}
        # In a cycle in which no batch can be afforded, nothing would be gained.
        unfinished = {"unfinished": np.array(not finished and cost + size <= self.steps)}
        memory = {**kept.to_memory(), **kernels.to_memory(), **done, **always, **unfinished}
        diagnostics = self._diagnostics(samples, weights, batches * size)
        diagnostics |= self.likelihood.seen(window, samples.predicted, samples.fit, weights)
        diagnostics |= response_seen(samples.fit, weights, self.likelihood)
        return Analysis(members, memory, diagnostics, shares, model_memory=belief.memory)

    def _known(self, window: Window, controls: Controls) -> tuple[Candidates, Kernels]:
        """Return the samples so far, carried to the present, and the proposals so far."""
        if window.memory is None:
            # Their density alone would be a factor of that of a proposal, and it is not known.
            if missing := controls.missing(window.rerun, window.first.ensemble.members):
                raise ConfigurationError(
                    f"{self.label}: estimate must list all numbers that the first guess leaves open, "
                    f"{', '.join(missing)} too; got {list(controls.names)}"
                )
            first = first_candidates(window, controls, self.likelihood)
            return replace(first, log_proposal=first.log_prior + np.log(len(first))), Kernels.none(len(controls))
        samples = Candidates.from_memory(window.memory, controls.space)
        samples = samples.carried_on(window, window.memory, self.likelihood)
        return samples, Kernels.from_memory(window.memory, controls)

    def _batch(
        self,
        window: Window,
        controls: Controls,
        proposal: Kernels,
        size: int,
        number: tuple[int, int],
        rng: np.random.Generator,
        best: float,
    ) -> Candidates | None:
        """Draw a batch and run those samples that are not hopeless; None if all are, or if the model can run none."""
        cycle, batch = number
        fresh = window.rerun.first_guess(size, f"fresh samples {batch}", cycle).members
        is_fresh = rng.random((size, 1)) < self.fresh
        drawn = np.where(is_fresh, controls.coordinates(fresh), proposal.draw(size, rng))
        starts = controls.at(window.rerun, fresh, drawn)
        coordinates = controls.coordinates(starts)
        log_prior = log_prior_of(window, controls, starts, coordinates)
        kept = log_prior > best - HOPELESS
        found = tried(window, starts[kept], coordinates[kept], log_prior[kept], self.likelihood)
        return None if found is None else found[0]

    def _log_density(self, kernels: Array, log_prior: Array) -> Array:
        """Return log q_b from the log density of the kernels and of the prior; both (..., P)."""
        with np.errstate(divide="ignore"):
            return np.logaddexp(np.log(self.fresh) + log_prior, np.log1p(-self.fresh) + kernels)

    def _with_one_more(self, samples: Candidates, proposal: Kernels, size: int) -> Array:
        """Return log sum n_b q_b (P,) of samples with one more proposal."""
        density = self._log_density(proposal.log_density(samples.coordinates)[-1], samples.log_prior)
        return np.logaddexp(samples.log_proposal, np.log(size) + density)

    def _of_all(self, found: Candidates, kernels: Kernels, size: int) -> Array:
        """Return log sum n_b q_b (M,) of new samples over all proposals, the first guess included."""
        density = self._log_density(kernels.log_density(found.coordinates), found.log_prior)
        return np.logaddexp.reduce(np.vstack([density, found.log_prior]), axis=0) + np.log(size)

    def _diagnostics(self, samples: Candidates, weights: Array, runs: int) -> dict[str, Diagnostic]:
        """Return what is recorded of an analysis."""
        absolute, relative = self.likelihood.size_of_error(samples.fit, weights)
        named: dict[str, tuple[Any, str]] = {
            "runs": (runs, "runs of the model since the start in this analysis"),
            "samples": (len(samples), "samples weighted"),
            "effective_size": (effective_size(weights), "effective sample size of all samples, in the search"),
            "model_error_absolute": (absolute, "estimated size of the model's error, in units of the readings"),
            "model_error_relative": (relative, "estimated size of the model's error, relative"),
        }
        return {name: Diagnostic(value, long_name=text) for name, (value, text) in named.items()}
