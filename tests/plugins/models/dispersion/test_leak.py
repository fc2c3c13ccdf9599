"""Place and rate of a leak are found from the exact readings of a few stations, by re-runs of the model."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import Study
from dafw.plugins.filters.amis import AMIS
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.observers.stations import Stations

NAMES = ["release_x", "release_y", "rate"]
TRUTH = np.array([62.0, 3.0, 0.08])
"""In m, m and 1/s. The belief expects 45 m, 12 m and 0.04/s; the wind carries the gas to the west."""
STATIONS = [[30.0, 0.0], [30.0, 15.0], [45.0, -10.0], [10.0, 8.0]]
CYCLES = 15


@pytest.fixture(scope="module")
def study(small_site):
    """Return a maker of studies with ten members, whose stations read the truth all but exactly."""
    common = {
        "site": small_site,
        "mesh": {"wall_size": 10.0, "far_size": 10.0},
        "transport": {"diffusion": 2.0, "scheme": "fct", "outflow": "open", "solver": "direct"},
        "release_radius": 8.0,
        "wind_speed": 3.0,
        "estimate": NAMES,
    }
    x, y, rate = TRUTH.tolist()
    truth = {"release": [x, y], "source": {"kind": "leak", "rate": rate}, "certain": True}
    belief = {
        "release": [45.0, 12.0],
        "source": {"kind": "leak", "rate": 0.04},
        "priors": {
            "release_x": {"name": "normal", "mean": 45.0, "sd": 20.0},
            "release_y": {"name": "normal", "mean": 12.0, "sd": 20.0},
            "rate": {"name": "lognormal", "mean": 0.04, "sd": 1.1},
        },
    }

    def made(seed, **options):
        return Study(
            model=AdvectionDiffusion.from_options(**common, **belief),
            truth=AdvectionDiffusion.from_options(**common, **truth),
            observer=Stations(positions=STATIONS, noise_sd=1e-5),
            filter=AMIS(**{"estimate": NAMES, "likelihood": Likelihood(absolute=[1e-4], relative=[0.01])} | options),
            cycles=CYCLES,
            seed=seed,
        )

    return made


def numbers(belief):
    """Return mean and standard deviation (3,) of place and rate."""
    state = belief.space.unpack(belief.members)
    values = np.concatenate([state[name] for name in NAMES], axis=1)
    mean = belief.average(values)
    return mean, np.sqrt(belief.average((values - mean) ** 2))


def last(study):
    """Return the last cycle."""
    for cycle in study:
        found = cycle
    return found


@pytest.mark.parametrize("seed", [1000, 1001])
def test_place_and_rate_of_a_leak_are_found_from_exact_readings(study, seed):
    found = last(study(seed))
    mean, deviation = numbers(found.belief)
    assert (np.abs(mean - TRUTH) <= [0.3, 0.3, 0.01 * TRUTH[2]]).all()
    assert (deviation <= [0.6, 0.6, 0.02 * TRUTH[2]]).all()


def test_without_runs_of_new_samples_they_are_not_found(study):
    mean, _ = numbers(last(study(1000, steps=0)).belief)
    assert (np.abs(mean - TRUTH) > [0.3, 0.3, 0.01 * TRUTH[2]]).any()


def test_the_same_seed_gives_the_same_bits(study):
    first, second, other = (last(study(seed)).belief.members for seed in (1000, 1000, 1001))
    np.testing.assert_array_equal(first, second)
    assert (first != other).any()
