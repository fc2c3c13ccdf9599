"""Filter ``local``: corrections near the readings, and nothing else."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from dafw import Domain, Model, StateSpace, Study, Variable
from dafw.authoring.problems import linear_problem
from dafw.authoring.small_study import study_of
from dafw.core.composition import compose, study_part
from dafw.core.errors import ConfigurationError, PluginError
from dafw.core.options import merged
from dafw.core.registry import registry
from dafw.core.space import NONNEGATIVE, POSITIVE
from dafw.plugins.filters.local import Local
from dafw.plugins.filters.localization import gaspari_cohn, not_negative
from dafw.plugins.readings.listed import Listed

X, Y = np.meshgrid(np.arange(0.0, 101.0, 5.0), np.arange(0.0, 61.0, 5.0))
NODES = np.stack([X.ravel(), Y.ravel()], axis=1)
WALL = np.array([[48.0, 2.0], [52.0, 2.0], [52.0, 60.0], [48.0, 60.0]])
BOUNDS = (-1.0, -1.0, 101.0, 61.0)
CLOUD = np.where(NODES[:, 0] < 80.0, np.exp(-((NODES[:, 1] - 30.0) ** 2) / 800.0), 0.0)
FACTORS = np.array([0.8, 0.9, 1.0, 1.1, 1.2])


@dataclass
class Still(Model):
    """A cloud that stays, or that moves by ``shift`` columns of nodes in a step; members differ by a factor."""

    walls: tuple = ()
    shift: int = 0
    dt: float = 1.0
    space: StateSpace = field(
        default_factory=lambda: StateSpace([Variable("concentration", len(NODES), NONNEGATIVE, "1", NODES)])
    )

    def __post_init__(self):
        self.domain = Domain(BOUNDS, self.walls)

    def initial(self, n_members, rng):
        return FACTORS[:n_members, np.newaxis] * CLOUD

    def step(self, members, t, rng):
        moved = np.roll(members.reshape(-1, *X.shape), self.shift, axis=2)
        return moved.reshape(members.shape)


def test_the_base_goes_on_in_cycles_without_readings_if_it_wants_to():
    filter_ = Local(base={"name": "amis"})
    assert filter_.unfinished({"base unfinished": np.array(True)})
    assert not filter_.unfinished({"base unfinished": np.array(False)}) and not filter_.unfinished(None)


def test_a_mean_over_several_cycles_is_left_to_the_base():
    """It is no value at the end of its span, so what it misses there says nothing of the model's error."""
    readings = [{"time": float(time), "x": 40.0, "y": 30.0, "value": 2.0} for time in (1, 2, 3)]
    moved = []
    for span in (3.0, 1.0):
        listed = Listed(readings=[{**reading, "span": span} for reading in readings])
        study = Study(model=Still(), filter=Local(base={"name": "none"}), readings=listed, members=5, cycles=3)
        moved.append(any(cycle.belief.members.tobytes() != cycle.forecast.members.tobytes() for cycle in study))
    assert moved == [False, True]


def node(x, y):
    return int(np.argmin(np.abs(NODES - [x, y]).sum(axis=1)))


def cycles_of(filter_, values, place=(40.0, 30.0), model=None, seconds=None):
    """Return the cycles with a reading of ``place`` in each; ``values`` are relative to the cloud there."""
    at = dict(zip(("x", "y"), place, strict=True))
    there = CLOUD[node(*place)]
    readings = Listed(readings=[{"time": k + 1.0, "value": float(v * there), **at} for k, v in enumerate(values)])
    study = Study(model=model or Still(), filter=filter_, readings=readings, members=5, cycles=seconds or len(values))
    return list(study)


def local(**options):
    return Local(base={"name": "none"}, radius=30.0, **options)


LOW = [2.0, 2.0, 2.0]
"""Readings of twice what is believed: far outside of the members."""


def test_beyond_the_radius_nothing_changes_and_within_the_belief_comes_nearer():
    last = cycles_of(local(), LOW)[-1].belief
    distance = np.linalg.norm(NODES - [40.0, 30.0], axis=1)
    before = FACTORS[:, np.newaxis] * CLOUD
    np.testing.assert_array_equal(last.members[:, distance >= 30.0], before[:, distance >= 30.0])
    assert (last.members[:, distance < 25.0] > before[:, distance < 25.0]).all()
    there = node(40.0, 30.0)
    assert 1.2 * CLOUD[there] < last.mean[there] < 2.0 * CLOUD[there]


def test_a_wall_blocks_and_its_end_can_be_walked_around():
    behind, before = node(60.0, 30.0), node(40.0, 30.0)
    place = (40.0, 30.0)
    open_, walled = (cycles_of(local(), LOW, place, Still(walls))[-1].belief.members for walls in ((), (WALL,)))
    assert (open_[:, behind] > FACTORS * CLOUD[behind]).all()
    np.testing.assert_array_equal(walled[:, behind], FACTORS * CLOUD[behind])
    np.testing.assert_array_equal(walled[:, before], open_[:, before])
    # Near the end of the wall the way around it is short.
    near_end = cycles_of(local(), LOW, (45.0, 0.0), Still((WALL,)))[-1].belief.members
    assert (near_end[:, node(55.0, 0.0)] > FACTORS * CLOUD[node(55.0, 0.0)]).all()


def test_readings_that_agree_change_nothing():
    base = FACTORS[:, np.newaxis] * CLOUD
    for cycle in cycles_of(local(), [1.0, 1.02, 0.97, 1.0]):
        np.testing.assert_array_equal(cycle.belief.members, base)
        assert cycle.analysis.diagnostics["local_factor"].values == 0.0


def test_no_gas_where_no_member_has_any_and_none_below_zero():
    empty = CLOUD == 0.0
    for values in (LOW, [0.0, 0.0, 0.0, 0.0, 0.0]):
        members = cycles_of(local(largest=100.0), values, (75.0, 30.0))[-1].belief.members
        assert (members >= 0.0).all()
        np.testing.assert_array_equal(members[:, empty], 0.0)
        assert not np.array_equal(members, FACTORS[:, np.newaxis] * CLOUD)


@pytest.mark.parametrize("values", [LOW, [0.0, 0.0, 0.0], [3.0, 0.2, 5.0]])
@pytest.mark.parametrize("place", [(40.0, 30.0), (40.0, 60.0)])
def test_the_field_changes_by_no_more_than_the_readings_say(values, place):
    # At (40, 60) the cloud is a third of what it is at (40, 30), so a gain alone would change the latter by more.
    near = gaspari_cohn(np.linalg.norm(NODES - place, axis=1) / 15.0)
    before, there = FACTORS[:, np.newaxis] * CLOUD, CLOUD[node(*place)]
    said = 0.0
    for cycle, value in zip(cycles_of(local(), values, place), values, strict=True):
        # What is left of the past correction lies between all of it and nothing.
        said += max(abs(value * there - cycle.predicted.mean()), abs(value * there - there))
        change = np.abs(cycle.belief.members - before)
        assert (change <= said * near + 1e-15).all()
        assert change.sum(axis=1).max() <= said * near.sum() + 1e-12
    assert change.any()


def test_a_correction_that_readings_contradict_is_dropped():
    cycles = cycles_of(local(), [*LOW, 1.0])
    there = node(40.0, 30.0)
    assert cycles[2].belief.mean[there] > 1.2 * CLOUD[there]
    assert cycles[3].belief.mean[there] < 1.05 * CLOUD[there]
    shares = [float(cycle.analysis.diagnostics["local_confirmed"].values) for cycle in cycles]
    # 1 + sum(wanted x added / r) over 1 + sum(added^2 / r), with nothing wanted
    added = cycles[2].belief.mean[there] - CLOUD[there]
    r = 1e-6 + 0.002**2 + (0.1 * CLOUD[there]) ** 2
    assert shares == pytest.approx([1.0, 1.0, 1.0, 1.0 / (1.0 + added**2 / r)])


def test_a_correction_travels_with_the_gas():
    model = Still(shift=1)
    cycles = cycles_of(local(), LOW, (30.0, 30.0), model, seconds=6)
    with_it = cycles[2].belief.members - np.roll(CLOUD.reshape(X.shape), 3, axis=1).ravel() * FACTORS[:, np.newaxis]
    later = cycles[5].belief.members - np.roll(CLOUD.reshape(X.shape), 6, axis=1).ravel() * FACTORS[:, np.newaxis]
    assert with_it.any()
    moved = np.roll(with_it.reshape(-1, *X.shape), 3, axis=2).reshape(with_it.shape)
    np.testing.assert_allclose(later, moved, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "base", [{"name": "enkf"}, {"name": "amis", "enough": 0.5, "steps": 300}, {"name": "restart_enkf", "every": 2}]
)
def test_the_base_never_sees_a_correction(base):
    """Its members and memory have the bits that they have without the wrapper."""
    problems = [linear_problem(8, 5, 3, seed=seed) for seed in range(4)]
    far = [replace(problem, values=problem.values + 20.0) for problem in problems]
    study = study_of(*far).remembering(error_sd=0.1)
    alone = study.run(lambda: registry().create("filter", base))
    wrapped = study.run(lambda: Local(base=base, radius=200.0, largest=50.0))
    corrected = False
    for one, other in zip(alone, wrapped, strict=True):
        memory = other.state.filter_memory
        np.testing.assert_array_equal(memory["members"], one.belief.members)
        for name, array in (one.state.filter_memory or {}).items():
            np.testing.assert_array_equal(memory[f"base {name}"], array)
        corrected |= not np.array_equal(other.belief.members, one.belief.members)
    assert corrected


def test_readings_without_a_place_are_the_bases_alone():
    readings = Listed(readings=[{"time": k + 1.0, "value": 3.0, "entry": node(40.0, 30.0)} for k in range(3)])
    last = list(Study(model=Still(), filter=local(), readings=readings, members=5, cycles=3))[-1].belief.members
    np.testing.assert_array_equal(last, FACTORS[:, np.newaxis] * CLOUD)


def test_bases_and_variables_that_cannot_be_corrected_are_refused():
    with pytest.raises(ConfigurationError, match="needs past beliefs"):
        Local(base={"name": "enks", "window": 3})
    with pytest.raises(PluginError, match="there is no filter 'amiss'"):
        Local(base={"name": "amiss"})
    space = StateSpace([Variable("rate", 2, POSITIVE, coordinates=np.zeros((2, 2))), Variable("speed", 3)])
    with pytest.raises(ConfigurationError, match=r"'rate' \(positive\), 'speed' \(field\)"):
        local().suit(space, 5)


def test_the_function_of_gaspari_and_cohn():
    np.testing.assert_allclose(gaspari_cohn(np.array([0.0, 1.0, 2.0, np.inf])), [1.0, 5.0 / 24.0, 0.0, 0.0], atol=1e-15)
    r = np.linspace(0.0, 2.0, 400)
    assert (np.diff(gaspari_cohn(r)) <= 0.0).all()
    # On a line its matrix is a covariance: no eigenvalue is negative.
    matrix = gaspari_cohn(np.abs(np.subtract.outer(4.0 * r, 4.0 * r)))
    assert np.linalg.eigvalsh(matrix).min() > -1e-10


def test_the_recommended_amis_is_the_base_of_the_preset():
    recommended, corrected = (study_part(compose(words))["filter"] for words in ([], ["filter=local_amis"]))
    base = corrected["base"]
    assert corrected["name"] == "local" and base["name"] == recommended["name"] == "amis"
    whole = merged(study_part(compose(["filter=amis"]))["filter"], base)
    assert whole == recommended


def test_a_matrix_loses_its_negative_eigenvalues_alone():
    turned = np.array([[0.6, 0.8], [-0.8, 0.6]])
    np.testing.assert_allclose(
        not_negative(turned.T @ np.diag([2.0, -0.5]) @ turned), turned.T @ np.diag([2.0, 0.0]) @ turned, atol=1e-15
    )
