"""Priors: draws have the stated density."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from dafw import ANGLE, FIELD, NONNEGATIVE, POSITIVE, ConfigurationError
from dafw.core.priors import Prior, weibull_parameters

PRIORS = [
    Prior("normal", {"mean": 2.0, "sd": 0.5}),
    Prior("uniform", {"low": -1.0, "high": 3.0}),
    Prior("lognormal", {"mean": 0.4, "sd": 0.8}),
    Prior("weibull", {"mean": 2.5, "sd": 3.0}),
    Prior("angle", {"mean": 6.0, "sd": 0.7}),
]


def limits(prior):
    return (0.0, 2.0 * np.pi) if prior.name == "angle" else (1e-12 if prior.name in ("weibull",) else -40.0, 60.0)


@pytest.mark.parametrize("prior", PRIORS, ids=lambda prior: prior.name)
def test_densities_add_up_to_one(prior):
    low, high = limits(prior)
    total, _ = quad(lambda x: float(np.exp(prior.log_density(x))), low, high, limit=400, points=[-1.0, 0.4, 3.0])
    assert total == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("prior", PRIORS, ids=lambda prior: prior.name)
def test_draws_follow_the_density(prior):
    rng = np.random.default_rng(2)
    draws = np.array([prior.draw(rng) for _ in range(4000)])
    low, high = limits(prior)
    edges = np.quantile(draws, np.linspace(0.0, 1.0, 9)[1:-1])
    grid = np.linspace(max(low, draws.min() - 1.0), min(high, draws.max() + 1.0), 200_001)
    cumulative = np.cumsum(np.exp(prior.log_density(grid))) * (grid[1] - grid[0])
    expected = np.interp(edges, grid, cumulative)
    # the largest distance of two distribution functions; Kolmogorov's bound at one in a million
    assert np.abs(expected - np.linspace(0.0, 1.0, 9)[1:-1]).max() < np.sqrt(np.log(2e6) / (2 * 4000)) + 2e-3


def test_the_weibull_has_the_moments_that_are_asked_for():
    shape, scale = weibull_parameters(2.5, 3.0)
    frozen = stats.weibull_min(shape, scale=scale)
    assert (frozen.mean(), frozen.std()) == pytest.approx((2.5, 3.0))


def test_a_point_is_known():
    prior = Prior("point", {"mean": 0.8})
    assert prior.draw(np.random.default_rng(0)) == 0.8 and prior.log_density(np.array([0.8])).tolist() == [0.0]


def test_what_cannot_be_has_no_density():
    assert Prior("lognormal", {"mean": 1.0, "sd": 1.0}).log_density(np.array([-1.0, 0.0])).tolist() == [-np.inf] * 2
    assert Prior("uniform", {"low": 0.0, "high": 1.0}).log_density(np.array([1.1])).tolist() == [-np.inf]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"name": "gaussian", "mean": 1.0}, "diffusion: there is no prior 'gaussian' .there are: point, normal"),
        ({"mean": 1.0}, "there is no prior ''"),
        ({"name": "normal", "mean": 1.0}, "prior 'normal' takes mean and sd, got mean"),
        ({"name": "normal", "mean": 1.0, "sd": 0.0}, "sd must be above 0, got 0.0; 'point' has none"),
        ({"name": "normal", "mean": float("nan"), "sd": 1.0}, "mean must be a finite number, got nan"),
        ({"name": "normal", "mean": "x", "sd": 1.0}, "mean must be a finite number, got 'x'"),
        ({"name": "uniform", "low": 2.0, "high": 1.0}, "low must be below high"),
        ({"name": "weibull", "mean": 0.0, "sd": 1.0}, "mean must be above 0"),
    ],
)
def test_a_wrong_prior_is_refused(config, message):
    with pytest.raises(ConfigurationError, match=message):
        Prior.of(config, "diffusion")


# Kinds ---------------------------------------------------------------------------------------------------------------

BELOW = [
    ({"name": "normal", "mean": 9.0, "sd": 0.1}, "-inf"),
    ({"name": "uniform", "low": -0.5, "high": 1.0}, "-0.5"),
    ({"name": "point", "mean": -2.0}, "-2"),
]
ABOVE = [
    {"name": "uniform", "low": 0.0, "high": 1.0},
    {"name": "lognormal", "mean": 1.0, "sd": 2.0},
    {"name": "weibull", "mean": 1.0, "sd": 2.0},
    {"name": "weibull", "mean": 1.0, "sd": 2.0, "high": 3.0},
    {"name": "point", "mean": 0.1},
]


@pytest.mark.parametrize(("kind", "expected"), [(POSITIVE, "above 0"), (NONNEGATIVE, "of at least 0")])
@pytest.mark.parametrize(("config", "lowest"), BELOW, ids=lambda part: part["name"] if isinstance(part, dict) else "")
def test_a_prior_that_goes_below_zero_is_none_of_a_number_that_does_not(config, lowest, kind, expected):
    message = f"amount: prior '{config['name']}' with .* of a {kind.value} number: it goes down to {lowest}, "
    with pytest.raises(ConfigurationError, match=f"{message}expected numbers {expected}"):
        Prior.of(config, "amount", kind)
    assert Prior.of(config, "place", FIELD).name == config["name"]


def test_a_number_that_is_known_to_be_zero_is_not_positive():
    zero = {"name": "point", "mean": 0.0}
    assert Prior.of(zero, "speed", NONNEGATIVE).lowest == 0.0
    with pytest.raises(ConfigurationError, match="rate: prior 'point' with mean 0 is not one of a positive number"):
        Prior.of(zero, "rate", POSITIVE)


class Least:
    """A generator of the least numbers that there are."""

    def random(self):
        return 0.0


@pytest.mark.parametrize("config", ABOVE, ids=lambda config: "-".join(str(value) for value in config.values()))
def test_what_the_prior_of_a_positive_number_draws_is_positive_and_possible(config):
    prior = Prior.of(config, "rate", POSITIVE)
    drawn = [prior.draw(np.random.default_rng(seed)) for seed in range(100)]
    if "high" in config:  # made from a uniform draw
        drawn.append(prior.draw(Least()))
    assert min(drawn) > 0.0 and np.isfinite(prior.log_density(np.array(drawn))).all()


# Angles --------------------------------------------------------------------------------------------------------------

ANGLES = [
    {"name": "uniform", "low": -1.0, "high": 1.0},
    {"name": "uniform", "low": 6.0, "high": 9.0},
    {"name": "uniform", "low": -4.0, "high": 11.0},
    {"name": "normal", "mean": 0.1, "sd": 0.5},
    {"name": "normal", "mean": -40.0, "sd": 3.0},
    {"name": "lognormal", "mean": 6.0, "sd": 0.4},
    {"name": "weibull", "mean": 5.0, "sd": 3.0},
    {"name": "angle", "mean": 0.1, "sd": 0.7},
]


@pytest.mark.parametrize("config", ANGLES, ids=lambda config: "-".join(str(value) for value in config.values()))
def test_the_prior_of_an_angle_has_its_draws_and_its_density_within_one_turn(config):
    prior, rng = Prior.of(config, "direction", ANGLE), np.random.default_rng(3)
    draws = np.array([prior.draw(rng) for _ in range(4000)])
    assert draws.min() >= 0.0 and draws.max() < 2.0 * np.pi
    assert np.isfinite(prior.log_density(draws)).all()
    grid = (np.arange(100_000) + 0.5) / 100_000 * 2.0 * np.pi
    cumulative = np.cumsum(np.exp(prior.log_density(grid))) * (grid[1] - grid[0])
    assert cumulative[-1] == pytest.approx(1.0, abs=1e-4)
    eighths = np.linspace(0.0, 1.0, 9)[1:-1]
    expected = np.interp(np.quantile(draws, eighths), grid, cumulative)
    # Kolmogorov's bound at one in a million, as above
    assert np.abs(expected - eighths).max() < np.sqrt(np.log(2e6) / (2 * 4000)) + 2e-3


def test_the_density_of_an_angle_is_the_same_after_a_turn():
    prior = Prior.of({"name": "uniform", "low": -1.0, "high": 1.0}, "direction", ANGLE)
    angles = np.array([[-0.5, 0.5], [2.0, 6.0]])
    np.testing.assert_allclose(np.exp(prior.log_density(angles)), [[0.5, 0.5], [0.0, 0.5]])
    np.testing.assert_allclose(prior.log_density(angles + 2.0 * np.pi), prior.log_density(angles))


def test_an_angle_that_is_known_is_drawn_within_one_turn():
    prior = Prior.of({"name": "point", "mean": -1.0}, "direction", ANGLE)
    assert prior.draw(np.random.default_rng(0)) == pytest.approx(2.0 * np.pi - 1.0)
    assert prior.log_density(np.array([1.0])).tolist() == [0.0]


def test_an_angle_that_goes_around_countless_times_is_refused():
    with pytest.raises(ConfigurationError, match=r"direction: prior 'normal' of an angle goes 2\.86e\+06 times around"):
        Prior.of({"name": "normal", "mean": 0.0, "sd": 1e6}, "direction", ANGLE)
