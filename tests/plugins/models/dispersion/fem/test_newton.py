"""The line search of Newton's method."""

import numpy as np

from dafw.plugins.models.dispersion.fem.newton import best_length


def test_line_search_finds_the_least_norm():
    rng = np.random.default_rng(1)
    lengths = np.linspace(1e-4, 1.0, 10_000)
    for scale in (0.1, 1.0, 10.0, 1000.0):
        force, quadratic = rng.normal(size=(2, 4))
        quadratic *= scale
        norms = np.linalg.norm(np.outer(1 - lengths, force) + np.outer(lengths**2, quadratic), axis=1)
        found = best_length(force, quadratic)
        reached = np.linalg.norm((1 - found) * force + found**2 * quadratic)
        assert 0 < found <= 1
        assert reached <= norms.min() + 1e-9 or (found == 1.0 and reached <= 0.5 * np.linalg.norm(force))
