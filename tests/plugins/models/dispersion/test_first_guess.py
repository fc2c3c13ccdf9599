"""The first guess of the wind: its moments, and that one member's draw is one member's affair."""

import numpy as np
import pytest
from scipy.stats import weibull_min

from dafw.plugins.models.dispersion.first_guess import draw_direction, draw_speed, weibull_parameters


@pytest.mark.parametrize(("mean", "sd"), [(2.5, 3.0), (5.0, 0.5), (1.0, 1.0), (10.0, 30.0)])
def test_the_weibull_has_the_moments_asked_for(mean, sd):
    shape, scale = weibull_parameters(mean, sd)
    moments = weibull_min.stats(shape, scale=scale, moments="mv")
    np.testing.assert_allclose(moments, [mean, sd**2], rtol=1e-10)


def test_equal_mean_and_deviation_is_the_exponential_distribution():
    assert weibull_parameters(2.0, 2.0) == pytest.approx((1.0, 2.0))


def test_without_spread_the_first_guess_is_the_mean():
    assert draw_speed(5.0, 0.0, np.random.default_rng(0)) == 5.0
    assert draw_direction(np.pi, 0.0, np.random.default_rng(0)) == np.pi
    assert draw_direction(2 * np.pi, 0.0, np.random.default_rng(0)) == 0.0


def test_directions_are_wrapped():
    generator = np.random.default_rng(0)
    drawn = np.array([draw_direction(0.0, 2.0, generator) for _ in range(500)])
    assert drawn.min() >= 0.0 and drawn.max() < 2 * np.pi
    # the resultant length of a wrapped normal is exp(-sd^2 / 2)
    assert abs(np.exp(1j * drawn).mean()) == pytest.approx(np.exp(-2.0), abs=4 / np.sqrt(500))
