"""The likelihood of readings against scipy's distributions and numerical quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, t

from dafw import ConfigurationError
from dafw.core.errors import OptionError
from dafw.core.observation import below_limit
from dafw.core.options import require_options
from dafw.plugins.filters.likelihood import Likelihood

RNG = np.random.default_rng(4)
PREDICTED = RNG.normal(0.0, 1.0, (5, 3))
VALUES = np.array([0.4, -1.2, 2.0])
R = np.array([0.04, 0.09, 0.25])


def scales(absolute, relative):
    """Return the standard deviation (5, 3) of every misfit."""
    return np.sqrt(R + absolute**2 + (relative * np.maximum(abs(PREDICTED), abs(VALUES))) ** 2)


@pytest.mark.parametrize("degrees", [None, 1.0, 4.0])
@pytest.mark.parametrize("independence", [1.0, 0.3])
def test_it_is_the_density_of_scipy_for_every_size(degrees, independence):
    likelihood = Likelihood([0.0, 0.3], [0.0, 0.2, 1.0], degrees, independence)
    found = likelihood.log_density(PREDICTED, VALUES, R)
    assert found.shape == (5, 6)
    for column, (absolute, relative) in zip(found.T, likelihood.sizes, strict=True):
        errors = norm if degrees is None else t(degrees)
        expected = errors.logpdf((VALUES - PREDICTED) / scales(absolute, relative)) - np.log(scales(absolute, relative))
        np.testing.assert_allclose(column, independence * expected.sum(axis=1), rtol=1e-12)


def test_correlated_readings_have_the_density_of_scipy():
    root = RNG.normal(size=(3, 3))
    full = root @ root.T
    found = Likelihood([0.2], [0.5]).log_density(PREDICTED, VALUES, full)[:, 0]
    for one, predicted in zip(found, PREDICTED, strict=True):
        added = 0.2**2 + (0.5 * np.maximum(abs(predicted), abs(VALUES))) ** 2
        assert one == pytest.approx(multivariate_normal(predicted, full + np.diag(added)).logpdf(VALUES), rel=1e-12)


@pytest.mark.parametrize("degrees", [None, 3.0])
def test_a_full_diagonal_covariance_is_the_same_as_its_diagonal(degrees):
    likelihood = Likelihood([0.1, 0.4], [0.3], degrees)
    one, other = (likelihood.log_density(PREDICTED, VALUES, each) for each in (R, np.diag(R)))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_the_size_is_averaged_over_all_readings_not_for_each():
    likelihood = Likelihood([0.1, 1.0], [0.0, 0.5], 4.0)
    first, second = (likelihood.log_density(PREDICTED[:, k], VALUES[k], R[k]) for k in ([0, 1], [2]))
    expected = 0.0
    for absolute, relative in likelihood.sizes:
        expected += np.prod(
            t(4.0).pdf((VALUES - PREDICTED) / scales(absolute, relative)) / scales(absolute, relative), 1
        )
    np.testing.assert_allclose(np.exp(likelihood.averaged(first + second)), expected / 4.0, rtol=1e-12)


@pytest.mark.parametrize("degrees", [None, 4.0])
def test_the_density_of_a_reading_integrates_to_one(degrees):
    """Without a relative size, whose scale depends on the reading."""
    likelihood = Likelihood([0.05, 0.5], [0.0], degrees)

    def density(y):
        return float(np.exp(likelihood.averaged(likelihood.log_density(np.array([[0.3]]), np.array([y]), R[:1])))[0])

    assert quad(density, -np.inf, np.inf)[0] == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("degrees", [None, 4.0])
def test_a_reading_below_the_limit_says_only_that_it_is_below(degrees):
    likelihood = Likelihood([0.1], [0.3], degrees, 0.5, detection_limit=0.5)
    sd = np.sqrt(R + 0.1**2 + (0.3 * np.maximum(abs(PREDICTED), [0.5, 0.5, 2.0])) ** 2)
    errors = norm if degrees is None else t(degrees)
    found = likelihood.log_density(PREDICTED, VALUES, R)[:, 0]
    expected = errors.logcdf((0.5 - PREDICTED[:, :2]) / sd[:, :2]).sum(axis=1)
    expected = expected + errors.logpdf((2.0 - PREDICTED[:, 2]) / sd[:, 2]) - np.log(sd[:, 2])
    np.testing.assert_allclose(found, 0.5 * expected, rtol=1e-10)
    other = likelihood.log_density(PREDICTED, np.array([-7.0, 0.49, 2.0]), R)[:, 0]
    np.testing.assert_array_equal(found, other)


@pytest.mark.parametrize("degrees", [None, 4.0])
def test_a_reading_may_have_a_limit_of_its_own(degrees):
    """The first and the last reading are below a limit of their own, the middle one is below that of all."""
    limits = np.array([0.8, np.nan, 3.0])
    middle, variances = below_limit(limits, R)
    values = np.where(np.isnan(limits), VALUES, middle)
    likelihood = Likelihood([0.1], [0.2], degrees, detection_limit=-0.5)
    found = likelihood.log_density(PREDICTED, values, np.where(np.isnan(limits), R, variances), limits)[:, 0]
    ends = np.array([0.8, -0.5, 3.0])
    sd = np.sqrt(R + 0.1**2 + (0.2 * np.maximum(abs(PREDICTED), abs(ends))) ** 2)
    errors = norm if degrees is None else t(degrees)
    expected = errors.logcdf((ends - PREDICTED) / sd).sum(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    # What counts is how far the limit is from the sensor's zero, wherever that is, as with degrees.
    absolute = Likelihood([0.1], [0.0], degrees, detection_limit=-0.5)
    shifted = replace(absolute, detection_limit=272.65)
    np.testing.assert_allclose(
        absolute.log_density(PREDICTED, values, variances, limits),
        shifted.log_density(PREDICTED + 273.15, values + 273.15, variances, limits + 273.15),
        rtol=1e-9,
    )


def test_a_hopeless_prediction_below_the_limit_stays_finite():
    far = np.array([[1e6]])
    for degrees in (None, 40.0):
        assert np.isfinite(Likelihood([0.1], [0.0], degrees, detection_limit=0.5).log_density(far, VALUES[:1], R[:1]))


def test_a_limit_needs_independent_errors():
    with pytest.raises(ConfigurationError, match=r"a detection limit needs .*not correlated"):
        Likelihood(detection_limit=1.0).log_density(PREDICTED, VALUES, np.diag(R))


@pytest.mark.parametrize("name", ["absolute", "relative"])
@pytest.mark.parametrize("sizes", [[], [-0.1], [0.1, np.nan], [True]], ids=str)
def test_sizes_that_make_no_sense_are_refused(name, sizes):
    with pytest.raises(ConfigurationError, match=rf"likelihood\.{name} must list"):
        Likelihood(**{name: sizes})


@pytest.mark.parametrize(
    "options", [{"degrees_of_freedom": 0.0}, {"independence": 0.0}, {"independence": 1.5}], ids=str
)
def test_other_options_that_make_no_sense_are_refused(options):
    with pytest.raises(OptionError, match=next(iter(options))):
        require_options(Likelihood(**options), "likelihood")
