"""Random rotations are uniform and keep the mean."""

import numpy as np
import pytest
from scipy.stats import ortho_group

from dafw.plugins.filters.rotation import uniform_orthogonal, zero_mean_basis


@pytest.mark.parametrize("size", [1, 2, 3, 23, 40])
def test_it_is_the_matrix_that_scipy_draws(size):
    found = uniform_orthogonal(size, np.random.default_rng(size))
    expected = ortho_group.rvs(size, random_state=np.random.default_rng(size))
    np.testing.assert_allclose(found, np.reshape(expected, (size, size)), atol=1e-12)


@pytest.mark.parametrize("n_members", [2, 3, 24])
def test_the_basis_is_orthonormal_and_of_zero_mean(n_members):
    basis = zero_mean_basis(n_members)
    np.testing.assert_allclose(basis.T @ basis, np.eye(n_members - 1), atol=1e-14)
    np.testing.assert_allclose(basis.sum(axis=0), 0.0, atol=1e-14)
