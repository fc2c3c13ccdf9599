"""Small parts of a study with simple behaviour."""

from dataclasses import dataclass, field

import numpy as np

from dafw import Domain, Filter, Model, Observer, Policy, Route, Selection, StateSpace, Step, Variable
from dafw.core.cycle import Parts
from dafw.core.ensemble import Analysis
from dafw.core.rng import Streams
from dafw.plugins.readings.twin import Twin

NODES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def toy_space():
    return StateSpace([Variable("gas", 4, coordinates=NODES), Variable("rate", 1)])


@dataclass
class Growth(Model):
    """Gas grows by the rate at every step; model error has the standard deviation ``noise``."""

    rate: float = 1.0
    spread: float = 0.0
    noise: float = 0.0
    dt: float = 2.0
    space: StateSpace = field(default_factory=toy_space)

    def initial(self, n_members, rng):
        rates = self.rate + self.spread * rng.standard_normal((n_members, 1))
        return self.space.pack({"gas": np.ones((n_members, 4)), "rate": rates})

    def step(self, members, t, rng):
        stepped = members.copy()
        stepped[:, :4] += members[:, 4:] + self.noise * rng.standard_normal((len(members), 4))
        return stepped


@dataclass
class Counting(Growth):
    """Remembers how many steps each member has taken."""

    def initial_memory(self, members):
        return {"steps": np.zeros(len(members))}

    def step_with_memory(self, members, memory, t, rng):
        return Step(self.step(members, t, rng), {"steps": memory["steps"] + 1.0})


@dataclass
class OneNode(Observer):
    """Reads the node nearest to the first vehicle."""

    def operator(self, space, route, t):
        return Selection(indices=space["gas"].nearest(route.ends[:1]), covariance=np.array([0.01]))


@dataclass
class Hop(Policy):
    """Flies one metre east, or in a random direction."""

    random: bool = False

    def decide(self, belief, vehicle, rng):
        angle = rng.uniform(0.0, 2.0 * np.pi) if self.random else 0.0
        return Route(tuple(np.array([p, p + np.array([np.cos(angle), np.sin(angle)])]) for p in vehicle.positions))


@dataclass
class Nudge(Filter):
    """Moves all members by half of the innovation."""

    def analyse(self, forecast, predicted, observation, rng):
        shift = np.zeros(forecast.space.size)
        shift[:4] = 0.5 * (observation.values[0] - predicted.mean())
        return Analysis(forecast.members + shift)


def toy_parts(seed=0, **changes):
    parts = {
        "model": Growth(spread=0.5, noise=0.1),
        "truth": Growth(rate=2.0),
        "free": Growth(),
        "observer": OneNode(),
        "policy": Hop(),
        "filter": Nudge(),
        "readings": Twin(),
        "streams": Streams(seed),
    }
    return Parts(**(parts | changes))


AIRSPACE = Domain((-50.0, -50.0, 50.0, 50.0))
