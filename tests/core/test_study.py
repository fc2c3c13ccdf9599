"""Studies made of objects: wrong requests are refused at once; the two ways to write one's own loop."""

from dataclasses import dataclass

import numpy as np
import pytest
from toys import Growth, Nudge, OneNode

from dafw import ConfigurationError, Filter, OptionError, Study, advance, option
from dafw.core.executors.serial import Serial
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.observers.stations import Stations
from dafw.plugins.readings.listed import Listed


def study(**changes):
    """Return a study with a truth; the vehicle's node is read in every cycle."""
    parts = {
        "model": Growth(spread=0.5, noise=0.1),
        "truth": Growth(rate=2.0),
        "filter": Nudge(),
        "observer": OneNode(),
    }
    return Study(**(parts | {"start": [[0.0, 0.0]], "members": 5, "cycles": 3} | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": {"name": "ad"}}, "a study's model must be a model, got dict"),
        ({"observer": Nudge()}, "a study's observer must be an observer, got Nudge"),
        ({"executor": None}, "a study's executor must be an executor, got NoneType"),
        ({"filter": ETKF}, r"a study's filter must be made already: expected ETKF\(\.\.\.\), got the class"),
        ({"truth": None}, r"readings 'twin' reads a truth, and the study has none: .*\(readings=\.\.\.\)"),
        ({"members": 0}, "members must be at least 1, got 0"),
        ({"late_readings": "keep"}, "late_readings must be one of drop, use, got 'keep'"),
    ],
)
def test_parts_that_are_none_are_refused_when_the_study_is_made(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        study(**changes)


@dataclass
class Odd(Filter):
    """A filter with a field that is not an option and has no range."""

    factor: object = None
    size: int = option(1, "a size", minimum=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filter": ETKF(inflation=0.5)}, "filter 'ETKF': option 'inflation' must be at least 1.0, got 0.5"),
        ({"filter": ETKF(inflation="1.02")}, "filter 'ETKF': option 'inflation' must be of type float, got '1.02'"),
        ({"filter": Odd(size=np.int64(0))}, "filter 'Odd': option 'size' must be at least 1, got 0"),
        (
            {"model": AdvectionDiffusion(site={"bounds": [0.0, 0.0, 1.0, 1.0]})},
            r"option 'site' must be of type SiteOptions, got \{.*from_options\(\.\.\.\) makes it",
        ),
    ],
)
def test_options_of_objects_are_held_to_their_types_and_ranges(changes, message):
    with pytest.raises(OptionError, match=message):
        study(**changes)


def test_numbers_of_numpy_are_as_good_as_pythons():
    study(
        filter=ETKF(inflation=np.float64(1.02)), observer=Stations(positions=np.zeros((1, 2)), noise_sd=np.float64(0.1))
    )
    study(filter=Odd(factor=np.zeros(3), size=np.int64(2)))


def test_a_plugin_is_made_from_plain_values_as_a_configuration_does():
    model = AdvectionDiffusion.from_options(**AdvectionDiffusion.check_options())
    assert model.mesh.wall_size == 30.0 and model.release == [-6.0, -45.0]
    with pytest.raises(OptionError, match="filter 'ETKF': unknown option 'inflatoin'"):
        ETKF.from_options(inflatoin=1.02)


def test_iterating_gives_the_cycles_and_so_does_advancing_the_state():
    cycles = list(study())
    assert [cycle.belief.time for cycle in cycles] == [2.0, 4.0, 6.0]
    parts, state = study().begin()
    for cycle in cycles:
        own = advance(parts, state)
        np.testing.assert_array_equal(own.belief.members, cycle.belief.members)
        state = own.state
    assert cycles[-1].belief is cycles[-1].state.belief.ensemble


@dataclass
class Counted(Serial):
    """Counts how often it was started and closed."""

    started: int = 0
    closed: int = 0

    def start(self, model, config):
        self.started += 1

    def close(self):
        self.closed += 1


def test_the_executor_is_started_once_and_closed_even_where_the_loop_is_left():
    executor = Counted()
    for _ in study(executor=executor):
        break
    assert (executor.started, executor.closed) == (1, 1)


def test_the_executor_is_closed_where_the_first_belief_cannot_be_drawn():
    class NoGuess(Growth):
        def initial(self, n_members, rng):
            raise RuntimeError("no idea")

    executor = Counted()
    with pytest.raises(Exception, match="no idea"):
        study(model=NoGuess(), executor=executor).begin()
    assert (executor.started, executor.closed) == (1, 1)


def test_a_reading_keeps_its_own_time_although_it_is_used_at_the_end_of_the_cycle():
    readings = Listed([{"time": 0.5, "value": 1.0, "entry": 0}, {"time": 1.5, "value": 2.0, "entry": 1}])
    cycle = next(iter(study(readings=readings, filter=ETKF())))
    assert cycle.observation.time == 2.0
    np.testing.assert_array_equal(cycle.readings.times, [0.5, 1.5])
