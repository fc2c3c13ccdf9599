"""The floor: what constant parameters reach at best."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from dafw import Model, StateSpace, Study, Variable
from dafw.core.errors import ConfigurationError, SolverError
from dafw.core.registry import registry
from dafw.core.space import POSITIVE
from dafw.studies.floor import floor_of


@dataclass
class Pair(Model):
    """Two levels that both grow by ``rate`` a second from ``begin``; with ``bend`` the second one grows faster."""

    bend: float = 0.0
    rate: float | None = None
    limit: float = np.inf
    noise: float = 0.0
    dt: float = 1.0
    space: StateSpace = field(
        default_factory=lambda: StateSpace([Variable("level", 2), Variable("rate", 1, POSITIVE), Variable("begin", 1)])
    )

    def initial(self, n_members, rng):
        drawn = rng.standard_normal((n_members, 2))
        rates = np.exp(0.2 * drawn[:, 0]) if self.rate is None else np.full(n_members, self.rate)
        begins = drawn[:, 1] if self.rate is None else np.zeros(n_members)
        return self.settled(np.column_stack([begins, begins, rates, begins]))

    def settled(self, members):
        return np.column_stack([members[:, 3], members[:, 3], members[:, 2:]])

    def step(self, members, t, rng):
        if (members[:, 2] > self.limit).any():
            raise SolverError("it grows too fast")
        grown = members.copy()
        grown[:, :2] += members[:, 2:3] * [1.0, 1.0 + self.bend]
        if self.noise:
            grown[:, :2] += self.noise * rng.standard_normal((len(members), 2))
        return grown


def study(truth, **options):
    none = registry().create("filter", {"name": "none"})
    return Study(model=Pair(**options), truth=truth, filter=none, cycles=4)


def test_the_floor_of_a_truth_that_the_model_can_be_is_zero():
    found = floor_of(study(Pair(rate=1.3)))
    assert found.err < 0.1
    assert found.parameters["begin"] + 4.0 * found.parameters["rate"] == pytest.approx(5.2, rel=1e-3)


def test_the_floor_of_another_truth_is_its_distance_from_the_model():
    """The truth ends at (4, 8): the nearest pair of equal numbers is (6, 6)."""
    found = floor_of(study(Pair(rate=1.0, bend=1.0)))
    assert found.err == pytest.approx(100.0 * np.hypot(2.0, 2.0) / np.hypot(4.0, 8.0), abs=0.05)
    assert found.parameters["begin"] + 4.0 * found.parameters["rate"] == pytest.approx(6.0, rel=2e-2)
    assert found.runs <= 200


def test_it_finds_its_way_past_parameters_with_which_the_model_fails():
    found = floor_of(study(Pair(rate=1.0, bend=1.0), limit=1.05))
    assert found.parameters["rate"] <= 1.05
    assert found.err == pytest.approx(100.0 * np.hypot(2.0, 2.0) / np.hypot(4.0, 8.0), abs=0.2)


def test_without_a_truth_or_parameters_there_is_no_floor():
    listed = registry().create("readings", {"name": "listed"})
    none = registry().create("filter", {"name": "none"})
    with pytest.raises(ConfigurationError, match="the study has none"):
        floor_of(Study(model=Pair(), filter=none, readings=listed))
    lorenz = registry().create("model", {"name": "lorenz96"})
    with pytest.raises(ConfigurationError, match="no single numbers"):
        floor_of(Study(model=lorenz, truth=lorenz, filter=none))


def test_a_floor_for_any_seed_is_refused_where_the_truth_or_the_model_draws():
    assert floor_of(study(Pair(rate=1.3)), any_seed=True).err < 0.1
    with pytest.raises(ConfigurationError, match="the truth differs from seed to seed"):
        floor_of(study(Pair()), any_seed=True)
    with pytest.raises(ConfigurationError, match="its error differs from seed to seed"):
        floor_of(study(Pair(rate=1.3), noise=0.1), any_seed=True)


def test_it_is_the_same_whether_it_must_hold_for_any_seed():
    once, again = (floor_of(study(Pair(rate=1.0, bend=1.0)), any_seed=any_seed) for any_seed in (False, True))
    assert (once.err, once.parameters) == (again.err, again.parameters)
