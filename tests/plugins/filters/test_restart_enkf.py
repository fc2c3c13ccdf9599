"""The restart EnKF: state and parameters belong together, to the last bit."""

import numpy as np
import pytest
from decays import CYCLES, SILENT, Decay, decay_cycles, linear_cycles, rauch_tung_striebel, require_moments

from dafw import Study
from dafw.plugins.filters.restart_enkf import RestartEnKF
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.observers.stations import Stations


@pytest.mark.parametrize("readings", ["new", "all"])
def test_the_state_is_what_the_model_makes_of_the_parameters(readings):
    model = Decay()
    for done, cycle in enumerate(decay_cycles(RestartEnKF(readings=readings, every=2), model), 1):
        if done % 2:
            continue
        belief = cycle.state.belief
        rate = belief.ensemble.members[:, 1]
        if readings == "new":
            again = cycle.analysis.revised[0].ensemble.members
            np.testing.assert_array_equal(again[:, 1], rate)
            for t in range(done):
                again = model.step_with_memory(again, {"steps": np.zeros(len(rate))}, float(t), None).members
            np.testing.assert_array_equal(again, belief.ensemble.members)
        np.testing.assert_array_equal(belief.memory["steps"], float(done))


def test_the_cloud_is_that_of_the_release_and_the_wind_of_each_member():
    options = {**AdvectionDiffusion.check_options(), "noise": 0.0, "wind_speed": 2.0}
    model = AdvectionDiffusion.from_options(**options, estimate=["release_x", "amount"])
    study = Study(
        model=model,
        truth=AdvectionDiffusion.from_options(**options, estimate=["release_x", "amount"]),
        observer=Stations(positions=[[-6.0, -45.0], [-20.0, -40.0]], every=1.0, noise_sd=0.05),
        filter=RestartEnKF(),
        members=5,
        cycles=3,
        seed=1000,
    )
    *_, last = study
    space, belief = model.space, last.belief
    start = last.analysis.revised[0].ensemble.members
    parameters = [space.slice(name) for name in ("wind_speed", "wind_direction", "release_x", "amount")]
    for part in parameters:
        np.testing.assert_array_equal(belief.members[:, part], start[:, part])
    assert np.ptp(start[:, parameters[2]]) > 0.0
    again = model.settled(belief.members)  # the bells that belong to these parameters
    np.testing.assert_array_equal(again, start)
    for t in range(3):
        again = model.step_with_memory(again, None, float(t), None).members
    np.testing.assert_array_equal(space.retract(again, np.zeros(space.size)), belief.members)


@pytest.mark.parametrize("readings", ["new", "all"])
@pytest.mark.parametrize("every", [1, 2])
def test_a_linear_problem_has_its_exact_answer(readings, every):
    for done, cycle in enumerate(linear_cycles(RestartEnKF(readings=readings, every=every), silent=()), 1):
        if done % every == 0:
            means, covariances = rauch_tung_striebel(range(done), done)
            revised = {number: belief.ensemble for number, belief in cycle.analysis.revised.items()}
            assert sorted(revised) == (list(range(done)) if readings == "new" else [])
            for number, ensemble in {**revised, done: cycle.belief}.items():
                require_moments(ensemble, (means[number], covariances[number]))


def test_silent_cycles_and_late_readings_make_no_difference_in_the_end():
    means, covariances = rauch_tung_striebel(set(range(CYCLES)) - SILENT, CYCLES)
    last = linear_cycles(RestartEnKF(), late={0, 3, 6})[-1]
    require_moments(last.belief, (means[-1], covariances[-1]))
