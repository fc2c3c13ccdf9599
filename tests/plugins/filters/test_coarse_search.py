"""Filter ``coarse_search``: the base searches with a coarser model, and the model itself carries what it found."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from levels import Levels, level_study

from dafw import Model, StateSpace, Study, Variable
from dafw.core.composition import compose, study_part
from dafw.core.errors import ConfigurationError, SolverError, about_member
from dafw.core.interpolation import view
from dafw.core.observation import Interpolation, Selection
from dafw.core.options import merged
from dafw.core.priors import Prior
from dafw.core.space import NONNEGATIVE, POSITIVE
from dafw.plugins.filters.amis import AMIS
from dafw.plugins.filters.coarse_search import CoarseSearch
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.readings.listed import Listed

AMOUNT = Prior("lognormal", {"mean": 1.0, "sd": 0.5})
SPEED = Prior("lognormal", {"mean": 3.0, "sd": 0.5})
TRUE = {"amount": 1.5, "speed": 4.0}
SMALL_AMIS = {"name": "amis", "enough": 0.5, "steps": 600}


@dataclass
class Hump(Model):
    """A hump on a line that moves at a speed; the field follows from amount, speed and time alone."""

    nodes: int = 81
    coarse_nodes: int | None = 31
    dt: float = 1.0
    steps = 0

    def __post_init__(self):
        self.x = np.linspace(0.0, 80.0, self.nodes)[:, np.newaxis]
        numbers = [Variable("amount", 1, POSITIVE), Variable("speed", 1, POSITIVE)]
        # A coarser version may have its variables in another order.
        field = Variable("height", self.nodes, NONNEGATIVE, "1", self.x)
        self.space = StateSpace([field, *(numbers if self.coarse_nodes else reversed(numbers))])

    def at(self, members, t):
        members = members.copy()
        state = self.space.unpack(members)
        state["height"][:] = state["amount"] * np.exp(-(((self.x.T - 20.0 - state["speed"] * t) / 10.0) ** 2))
        return members

    def initial(self, n_members, rng):
        def one(generator):
            numbers = {"amount": AMOUNT.draw(generator), "speed": SPEED.draw(generator)}
            return self.space.pack({"height": np.zeros(self.nodes), **numbers})

        return self.settled(rng.draw(n_members, one))

    def settled(self, members):
        return self.at(members, 0.0)

    def step(self, members, t, rng):
        self.steps += len(members)
        return self.at(members, t + self.dt)

    def log_first_guess(self, members):
        state = self.space.unpack(members)
        return AMOUNT.log_density(state["amount"][:, 0]) + SPEED.log_density(state["speed"][:, 0])

    def coarser(self):
        if not hasattr(self, "_coarser"):
            self._coarser = Hump(nodes=self.coarse_nodes, coarse_nodes=None)
        return self._coarser


def hump_study(model, cycles=8, base=SMALL_AMIS, **options):
    def height(x, t):
        return TRUE["amount"] * np.exp(-(((x - 20.0 - TRUE["speed"] * t) / 10.0) ** 2))

    readings = [
        {"time": t, "entry": entry, "value": height(model.x[entry, 0], t), "sd": 0.05}
        for t in np.arange(1.0, cycles + 1.0)
        for entry in (24, 40, 52)
    ]
    filter_ = CoarseSearch(base=base, **options)
    return Study(model=model, filter=filter_, readings=Listed(readings=readings), members=10, cycles=cycles, seed=3)


def test_a_model_that_is_its_own_coarser_version_gives_the_bits_of_the_base():
    class Same(Levels):
        def coarser(self):
            return self

    alone = list(level_study(AMIS(), model=Same()))
    wrapped = list(level_study(CoarseSearch(renew=1), model=Same()))
    for one, other in zip(alone, wrapped, strict=True):
        np.testing.assert_array_equal(one.belief.members, other.belief.members)
        np.testing.assert_array_equal(one.belief.weights, other.belief.weights)


def test_the_belief_has_the_numbers_that_were_found_and_the_fields_of_the_model_itself():
    model = Hump()
    last = list(hump_study(model, renew=2))[-1]
    belief = last.belief
    np.testing.assert_array_equal(belief.members, model.at(belief.members, belief.time))
    state = belief.space.unpack(belief.members)
    for name, true in TRUE.items():
        assert abs(belief.average(state[name][:, 0]) - true) < 0.1 * true


def test_what_was_found_is_shown_though_no_reading_comes_any_more():
    """The last readings are those of the first cycle, and the belief is renewed every third."""
    study = hump_study(Hump(), renew=3)
    study.readings.readings[:] = [reading for reading in study.readings.readings if reading["time"] == 1.0]
    cycles = list(study)
    renewed = [
        float(cycle.analysis.diagnostics["renewed"].values) if cycle.analysis.diagnostics else 0.0 for cycle in cycles
    ]
    assert renewed[:2] == [0.0, 0.0] and renewed[2] > 0.0
    last = cycles[-1].state.filter_memory
    assert not last["waiting"] and not cycles[-1].analysis.diagnostics  # then it is left alone
    state = cycles[2].belief.space.unpack(cycles[2].belief.members)
    assert abs(cycles[2].belief.average(state["amount"][:, 0]) - TRUE["amount"]) < 0.3 * TRUE["amount"]


def test_between_renewals_the_model_carries_the_belief_on():
    cycles = list(hump_study(Hump(), renew=3))
    for cycle in cycles:
        renewed = cycle.state.cycle % 3 == 0
        same = np.array_equal(cycle.belief.members, cycle.forecast.members)
        assert same != renewed
        assert (cycle.analysis.diagnostics["renewed"].values > 0) == renewed


def test_only_new_members_are_run_with_the_model_itself():
    model = Hump()
    cycles = list(hump_study(model, renew=2))
    carried = 10 * len(cycles)
    run = sum(int(cycle.analysis.diagnostics["renewed"].values) * cycle.state.cycle for cycle in cycles)
    assert model.steps == carried + run
    assert model.coarser().steps > 2 * model.steps, "the search is made with the coarser version"
    late = cycles[-1].analysis.diagnostics["renewed"].values
    assert late < 10, "members that the forecast has are not run again"


# Members that the model itself cannot run ----------------------------------------------------------------------------


@dataclass
class Weak(Hump):
    """A hump that cannot be stepped at speeds above ``limit``; its coarser version can."""

    limit: float = np.inf
    names_member: bool = True

    def initial(self, n_members, rng):
        members = super().initial(n_members, rng)
        speed = self.space.slice("speed")
        members[:, speed] = np.minimum(members[:, speed], 0.9 * self.limit)
        return self.settled(members)

    def step(self, members, t, rng):
        for member in np.flatnonzero(members[:, self.space.slice("speed")][:, 0] > self.limit):
            if not self.names_member:
                raise SolverError("out of order")
            with about_member(int(member)):
                raise SolverError("the speed is too large")
        return super().step(members, t, rng)


WEIGHTED, EQUAL = SMALL_AMIS, {"name": "esmda", "estimate": ["amount", "speed"], "iterations": 1, "model_error": 0.4}


@pytest.mark.parametrize("base", [WEIGHTED, EQUAL], ids=["amis", "esmda"])
def test_a_member_that_the_model_itself_cannot_run_has_no_weight(base):
    """The belief is what was found without it, and the heaviest of the others stands in its place."""
    study, found = hump_study(Weak(limit=3.95), renew=2, base=base, cycles=4), []
    look_back = study.filter._base.look_back
    study.filter._base.look_back = lambda *given: found.append(look_back(*given)) or found[-1]
    failures = 0
    for cycle in study:
        if cycle.state.cycle % 2:
            assert cycle.analysis.diagnostics["renewals_failed"].values == 0
            continue
        numbers = found[-1].members[:, -2:]  # amount and speed in the order of the coarser version: speed, amount
        weights, shown = (np.full(10, 0.1) if one is None else one for one in (found[-1].weights, cycle.belief.weights))
        ran = numbers[:, 0] <= 3.95
        failures += np.count_nonzero(~ran)
        assert cycle.analysis.diagnostics["renewals_failed"].values == np.count_nonzero(~ran)
        expected = np.where(ran, weights, 0.0) / weights[ran].sum()
        np.testing.assert_allclose(shown, expected, rtol=1e-12)
        state = cycle.belief.space.unpack(cycle.belief.members)
        shown = np.column_stack([state["speed"], state["amount"]])
        np.testing.assert_array_equal(shown[ran], numbers[ran])
        np.testing.assert_array_equal(shown[~ran], numbers[[np.argmax(expected)] * np.count_nonzero(~ran)])
        np.testing.assert_array_equal(cycle.belief.members, Hump().at(cycle.belief.members, cycle.belief.time))
    assert failures > 0


def test_the_study_ends_if_the_model_itself_can_run_no_member_that_was_found():
    with pytest.raises(SolverError, match="the speed is too large"):
        list(hump_study(Weak(limit=2.0), renew=8))


def test_an_error_of_the_model_itself_that_is_about_no_member_ends_the_study():
    with pytest.raises(SolverError, match="out of order"):
        list(hump_study(Weak(limit=3.95, names_member=False), renew=2))


# What is refused -----------------------------------------------------------------------------------------------------


def test_a_model_without_a_coarser_version_is_refused():
    with pytest.raises(ConfigurationError, match="has no coarser version"):
        list(level_study(CoarseSearch()))
    plain = AdvectionDiffusionINS.from_options()
    with pytest.raises(ConfigurationError, match=r"give coarse_mesh\.wall_size"):
        plain.coarser()


def test_a_base_that_does_not_look_back_to_the_start_is_refused():
    for base in ({"name": "etkf"}, {"name": "enks"}):
        with pytest.raises(ConfigurationError, match="expected a base that looks back to the start"):
            CoarseSearch(base=base)


def test_operators_read_through_the_map_what_they_read_of_its_states():
    fine, coarse = Hump(), Hump().coarser()
    shown = view(coarse.space, None, fine.space, "coarser model")
    members = coarse.at(np.random.default_rng(0).random((4, coarse.space.size)), 3.0)
    select = Selection(indices=np.array([3, 40, 82]), covariance=np.ones(3))
    between = Interpolation(indices=np.array([[3, 4]]), weights=np.array([[0.3, 0.7]]), covariance=np.ones(1))
    for operator in (select, between):
        np.testing.assert_allclose(shown.through(operator).apply(members), operator.apply(shown.members(members)))
    assert shown.through(replace(select, sensors=("a", "b", "c"))).sensors == ("a", "b", "c")


def test_the_coarser_version_of_a_dispersion_model_differs_in_its_mesh_alone():
    options = {**AdvectionDiffusionINS.check_options(), "estimate": ["diffusion"], "coarse_mesh": {"far_size": 90.0}}
    model = AdvectionDiffusionINS.from_options(**options)
    coarse = model.coarser()
    assert coarse is model.coarser()
    assert coarse.mesh == replace(model.mesh, far_size=90.0)
    assert not coarse.coarse_mesh.given
    for one in fields(model):
        if one.init and one.name not in ("mesh", "coarse_mesh"):
            assert getattr(coarse, one.name) == getattr(model, one.name)
    assert 0 < coarse.space["concentration"].size < model.space["concentration"].size
    assert [one.name for one in coarse.space.variables] == [one.name for one in model.space.variables]


def test_the_recommended_amis_is_the_base_of_the_preset():
    recommended, wrapped = (study_part(compose(words))["filter"] for words in ([], ["filter=coarse_amis"]))
    assert wrapped["name"] == "coarse_search"
    assert merged(study_part(compose(["filter=amis"]))["filter"], wrapped["base"]) == recommended
