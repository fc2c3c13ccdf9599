"""Proposals of Student t kernels: their density against scipy's, and their draws against their density."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from dafw import ANGLE, StateSpace, Variable
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.kernels import DEGREES, WIDTHS, Kernels
from dafw.plugins.filters.weights import effective_size

PLANE = Controls(StateSpace([Variable("x", 1), Variable("y", 1)]))
CIRCLE = Controls(StateSpace([Variable("direction", 1, ANGLE)]))
POINTS = np.random.default_rng(2).normal([1.0, -3.0], [0.5, 2.0], (30, 2))


def around(points=POINTS, controls=PLANE, n_centres=6, seed=0):
    return Kernels.around(
        controls, points, np.full(len(points), 1.0 / len(points)), n_centres, np.random.default_rng(seed)
    )


def densities(kernels, points):
    """Return the density (P, c) of every kernel about a centre, by scipy."""
    shape = kernels.factors[-1] @ kernels.factors[-1].T
    parts = [
        [multivariate_t(centre, h**2 * shape, DEGREES).pdf(points) for h in WIDTHS] for centre in kernels.centres[-1]
    ]
    return np.mean(parts, axis=1).T


def test_the_density_is_the_mean_over_centres_and_widths():
    kernels, points = around(), np.random.default_rng(5).normal(0.0, 3.0, (20, 2))
    np.testing.assert_allclose(np.exp(kernels.log_density(points)), densities(kernels, points).mean(axis=1)[np.newaxis])


def test_a_kernel_leaves_out_its_own_centre():
    kernels = around()
    centres = kernels.centres[-1]
    parts = densities(kernels, centres)
    others = (parts.sum(axis=1) - np.diag(parts)) / (len(centres) - 1)
    assert len(np.unique(centres, axis=0)) == len(centres)
    np.testing.assert_allclose(np.exp(kernels.log_density(centres))[0], others)


def test_a_single_centre_counts_for_itself():
    kernels = around(n_centres=1)
    np.testing.assert_allclose(
        np.exp(kernels.log_density(kernels.centres[-1]))[0], densities(kernels, kernels.centres[-1])[0]
    )


def test_scale_and_centres_are_those_of_the_weighted_samples():
    weights = np.random.default_rng(3).dirichlet(np.full(30, 0.4))
    kernels = Kernels.around(PLANE, POINTS, weights, 30, np.random.default_rng(0))
    size = effective_size(weights)
    silverman = (4.0 / (size * 4.0)) ** (1.0 / 6.0)
    found = kernels.factors[0] @ kernels.factors[0].T
    np.testing.assert_allclose(found, silverman**2 * np.cov(POINTS.T, aweights=weights, ddof=1), rtol=1e-6)
    copies = [(kernels.centres[0] == point).all(axis=1).sum() for point in POINTS]
    assert (np.abs(copies - 30.0 * weights) < 1.0).all()


def test_samples_that_are_all_the_same_still_give_a_proposal():
    kernels = around(np.ones((5, 2)))
    assert np.isfinite(kernels.log_density(np.array([[1.0, 1.0], [2.0, 2.0]]))).all()


def test_draws_follow_the_density():
    """The mean over draws of p / q is one for every density p that vanishes where q does."""
    kernels, rng, n = around(), np.random.default_rng(8), 20000
    drawn = np.concatenate([kernels.draw(6, rng) for _ in range(n // 6)])
    q = np.exp(kernels.log_density(drawn)[0])
    for mean, sd in (([1.0, -3.0], [0.4, 1.5]), ([0.7, -2.0], [0.3, 1.0])):
        z = (drawn - mean) / sd
        ratio = np.exp(-0.5 * (z**2).sum(axis=1)) / (2.0 * np.pi * np.prod(sd)) / q
        assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / np.sqrt(len(drawn))
        assert ratio.std() / np.sqrt(len(drawn)) < 0.03


@pytest.mark.parametrize("sd", [0.2, 1.0, 2.0])
def test_on_the_circle_the_density_is_periodic_and_integrates_to_one(sd):
    points = np.mod(np.random.default_rng(1).normal(0.0, sd, (12, 1)), 2.0 * np.pi)
    kernels = around(points, CIRCLE)
    grid = 1e-4 + np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)[:, np.newaxis]
    density = np.exp(kernels.log_density(grid)[0])
    assert 2.0 * np.pi * density.mean() == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(np.exp(kernels.log_density(grid - 2.0 * np.pi)[0]), density, rtol=1e-9)


def test_a_cloud_of_angles_across_north_is_as_wide_as_elsewhere():
    points = np.random.default_rng(1).normal(0.0, 0.2, (12, 1))
    across, elsewhere = around(np.mod(points, 2.0 * np.pi), CIRCLE), around(points + 2.0, CIRCLE)
    np.testing.assert_allclose(across.factors, elsewhere.factors, rtol=1e-9)


def test_proposals_are_joined_in_order_and_survive_as_arrays():
    first, second = around(seed=0), around(POINTS + 5.0, seed=1)
    both = Kernels.none(2).joined(first).joined(second)
    again = Kernels.from_memory(both.to_memory(), PLANE)
    points = POINTS[:4] + 0.1
    expected = np.concatenate([first.log_density(points), second.log_density(points)])
    np.testing.assert_array_equal(both.log_density(points), again.log_density(points))
    np.testing.assert_allclose(both.log_density(points), expected, rtol=1e-12)
    assert Kernels.none(2).log_density(points).shape == (0, 4)
