"""The wider weights with which samples are shown where the model errs, against exact answers and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from levels import CONTROLS, LEVEL, RATE, SD, VALUES, T, belief_moments, last_cycle, level_study, moments

from dafw.plugins.filters.amis import AMIS
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.persistence import widened
from dafw.plugins.filters.weights import normalized

PLACES = np.linspace(-30.0, 30.0, 6001)
TWO_SIZES = Likelihood(absolute=[0.1, 1.0])


def weights_of(log_others, fit, likelihood):
    return normalized(log_others + likelihood.averaged(fit))


def fit_with(likely, *columns):
    """Return log likelihoods (P, 2) of two sizes of the error, normal about 0; only the one ``likely`` is possible."""
    fit = np.stack(columns, axis=1)
    fit[:, 1 - likely] -= 1e3
    return fit


def test_a_power_of_one_changes_nothing():
    weights = normalized(-0.5 * PLACES**2)
    fit = np.stack([-0.5 * PLACES**2, -0.1 * PLACES**2], axis=1)
    assert widened(np.zeros(len(PLACES)), fit, weights, TWO_SIZES, 1.0) is weights


@pytest.mark.parametrize(("likely", "variance"), [(0, 1.0), (1, 4.0)])
def test_a_power_divides_the_precision_unless_the_error_is_the_smallest(likely, variance):
    fit = fit_with(likely, -0.5 * PLACES**2, -0.5 * PLACES**2)
    others = np.zeros(len(PLACES))
    found = widened(others, fit, weights_of(others, fit, TWO_SIZES), TWO_SIZES, 0.25)
    assert found.sum() == pytest.approx(1.0)
    assert found @ PLACES**2 == pytest.approx(variance, rel=1e-3)


def test_the_prior_keeps_its_power():
    """A prior N(0, 1) and a reading N(3, 1) that counts a quarter: precision 1.25, mean 0.6."""
    fit, others = fit_with(1, -0.5 * (PLACES - 3.0) ** 2, -0.5 * (PLACES - 3.0) ** 2), -0.5 * PLACES**2
    found = widened(others, fit, weights_of(others, fit, TWO_SIZES), TWO_SIZES, 0.25)
    assert found @ PLACES == pytest.approx(0.6)
    assert found @ (PLACES - 0.6) ** 2 == pytest.approx(1.0 / 1.25, rel=1e-3)


def test_sizes_have_the_shares_that_the_search_gives_them():
    """Both sizes are as likely: half a normal distribution about -2, half one of four times the variance about 2."""
    fit = np.stack([-0.5 * (PLACES + 2.0) ** 2, -0.5 * (PLACES - 2.0) ** 2], axis=1)
    others = np.zeros(len(PLACES))
    found = widened(others, fit, weights_of(others, fit, TWO_SIZES), TWO_SIZES, 0.25)
    exact = np.exp(-0.5 * (PLACES + 2.0) ** 2) + 0.5 * np.exp(-0.125 * (PLACES - 2.0) ** 2)
    np.testing.assert_allclose(found, exact / exact.sum(), atol=1e-9)


def test_an_impossible_sample_has_no_weight():
    fit = np.array([[-1.0, -1.0], [-np.inf, -np.inf], [-2.0, -1.0]])
    others = np.zeros(3)
    found = widened(others, fit, weights_of(others, fit, TWO_SIZES), TWO_SIZES, 0.25)
    assert found[1] == 0.0
    assert found.sum() == pytest.approx(1.0)


def test_the_belief_of_amis_is_as_wide_as_quadrature_says():
    likelihood, seeds = Likelihood(absolute=[0.05, 0.2]), 40
    log_rate, first = (axis.ravel() for axis in np.meshgrid(np.linspace(-5, 3, 801), np.linspace(-4, 8, 801)))
    rate = np.exp(log_rate)
    others = RATE.log_density(rate) + log_rate + LEVEL.log_density(first)
    predicted = first[:, np.newaxis] * np.exp(-np.outer(rate, np.arange(T) + 1.0))
    fit = likelihood.log_density(predicted, VALUES, np.full(T, SD**2))
    grid = np.column_stack([log_rate, first])
    sure = weights_of(others, fit, likelihood)
    expected = moments(grid, widened(others, fit, sure, likelihood, 0.05))
    filter_ = AMIS(estimate=CONTROLS, likelihood=likelihood, model_independence=0.05, steps=10**6, archive=2)
    found = np.array([belief_moments(last_cycle(level_study(filter_, seed=seed)).belief) for seed in range(seeds)])
    error = found.std(axis=0, ddof=1) / np.sqrt(seeds)
    assert (np.abs(found.mean(axis=0) - expected) < 4.0 * error).all()
    # The difference that the power makes is larger than these errors.
    assert (np.abs(moments(grid, sure) - expected) > 4.0 * error)[[2, 4]].any()
