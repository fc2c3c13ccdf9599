"""A level that decays, with a prior: its posterior given readings is known by numerical quadrature."""

from dataclasses import dataclass, field

import numpy as np
from decays import listed
from scipy.stats import norm

from dafw import Model, StateSpace, Step, Study, Variable, hookimpl
from dafw.core.errors import DivergenceError, SolverError, about_member
from dafw.core.hookspecs import PluginSpec
from dafw.core.options import option
from dafw.core.priors import Prior
from dafw.core.space import POSITIVE
from dafw.plugins.filters.likelihood import Likelihood

RATE = Prior("lognormal", {"mean": 0.3, "sd": 0.8})
LEVEL = Prior("normal", {"mean": 2.0, "sd": 1.0})
CONTROLS = ["rate", "first"]
T, SD = 8, 0.2
VALUES = 1.5 * np.exp(-0.5 * np.arange(1, T + 1)) + SD * np.random.default_rng(0).standard_normal(T)
LIKELIHOOD = Likelihood(absolute=[0.05, 0.2], relative=[0.1], degrees_of_freedom=4.0)


@dataclass
class Levels(Model):
    """The level decays at a rate, from a first level; the model remembers how many steps a member has taken.

    Rates above ``highest`` are impossible. A member whose rate is above ``limit`` cannot take its first step;
    ``faults`` counts how often that has happened.
    """

    highest: float = option(1e9, "largest rate that is possible")
    limit: float = option(1e9, "largest rate that can be started with")
    fault: str = option("solver", "which error is raised", choices=("solver", "divergence", "nobody's"))
    dt: float = option(1.0, "time step in s")
    space: StateSpace = field(
        default_factory=lambda: StateSpace([Variable("level", 1), Variable("rate", 1, POSITIVE), Variable("first", 1)]),
        init=False,
    )

    faults = 0

    def initial(self, n_members, rng):
        def one(generator):
            first, rate = LEVEL.draw(generator), RATE.draw(generator)
            while rate > self.highest:
                rate = RATE.draw(generator)
            return np.array([first, rate, first])

        return rng.draw(n_members, one)

    def initial_memory(self, members):
        return {"steps": np.zeros(len(members))}

    def step_with_memory(self, members, memory, t, rng):
        for member in np.flatnonzero((members[:, 1] > self.limit) & (t == 0.0)):
            self.faults += 1
            if self.fault == "nobody's":
                raise SolverError("out of order")
            with about_member(int(member)):
                raise (SolverError if self.fault == "solver" else DivergenceError)("the rate is too large")
        stepped = members.copy()
        stepped[:, 0] *= np.exp(-members[:, 1])
        return Step(stepped, {"steps": memory["steps"] + 1.0})

    def settled(self, members):
        settled = members.copy()
        settled[:, 0] = members[:, 2]
        return settled

    def log_first_guess(self, members):
        share = norm.cdf(np.log(self.highest / RATE["mean"]) / RATE["sd"])
        log_rate = np.where(members[:, 1] <= self.highest, RATE.log_density(members[:, 1]) - np.log(share), -np.inf)
        return log_rate + LEVEL.log_density(members[:, 2])


@hookimpl
def dafw_plugins():
    return [PluginSpec("model", "levels", "levels:Levels", "a level that decays")]


def level_study(filter_, *, model=None, members=20, seed=0, silent=(), late=(), span=0.0, **options):
    """Return a study of the T readings, means over ``span`` seconds; those that are late arrive with the last one."""
    readings = listed(VALUES, SD, silent, late, span)
    model = Levels() if model is None else model
    return Study(model=model, filter=filter_, readings=readings, members=members, cycles=T, seed=seed, **options)


def last_cycle(study):
    """Run a study and return its last cycle."""
    *_, last = study
    return last


def fit_of(rate, first, seen=range(T), likelihood=LIKELIHOOD):
    """Return the log likelihood (P,) of the readings of the cycles ``seen``, from the exact solution."""
    seen = np.array(list(seen))
    predicted = first[:, np.newaxis] * np.exp(-np.outer(rate, seen + 1.0))
    return likelihood.averaged(likelihood.log_density(predicted, VALUES[seen], np.full(len(seen), SD**2)))


def moments(coordinates, weights):
    """Return the means of log rate and first level, and the three numbers of their covariance, in one row (5,)."""
    mean = weights @ coordinates
    anomalies = coordinates - mean
    covariance = (weights[:, np.newaxis] * anomalies).T @ anomalies
    return np.concatenate([mean, covariance[np.triu_indices(2)]])


def belief_moments(belief):
    """Return ``moments`` of an ensemble; its covariance is the one that is unbiased for independent members."""
    coordinates = np.column_stack([np.log(belief.members[:, 1]), belief.members[:, 2]])
    found = moments(coordinates, belief.weights)
    found[2:] /= 1.0 - belief.weights @ belief.weights
    return found


def posterior(highest=np.inf, seen=range(T)):
    """Return ``moments`` of the posterior by quadrature on a grid of log rate and first level."""
    log_rate, first = (axis.ravel() for axis in np.meshgrid(np.linspace(-5, 3, 801), np.linspace(-4, 8, 801)))
    rate = np.exp(log_rate)
    density = fit_of(rate, first, seen) + RATE.log_density(rate) + log_rate + LEVEL.log_density(first)
    weights = np.where(rate <= highest, np.exp(density - density.max()), 0.0)
    return moments(np.column_stack([log_rate, first]), weights / weights.sum())
