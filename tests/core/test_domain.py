"""The domain: what is free to fly."""

import numpy as np
import pytest

from dafw import Domain

SQUARE = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
DOMAIN = Domain((0.0, 0.0, 10.0, 10.0), (SQUARE,), ("hall",))


@pytest.mark.parametrize(
    ("start", "end", "free"),
    [
        ((1, 1), (9, 1), True),
        ((1, 5), (9, 5), False),
        ((1, 5), (4, 5), False),
        ((1, 5), (3.999, 5), True),
        ((5, 5), (5, 5), False),
        ((1, 1), (1, 1), True),
        ((1, 1), (-1, 1), False),
        ((0, 0), (10, 0), True),
    ],
)
def test_a_leg_is_free_when_it_stays_inside_and_touches_nothing(start, end, free):
    start, end = np.array(start, float), np.array(end, float)
    assert DOMAIN.is_free(start, end) is free
    assert DOMAIN.is_free(end, start) is free


def test_without_obstacles_only_the_rim_counts():
    assert Domain((0.0, 0.0, 1.0, 1.0)).is_free(np.array([0.1, 0.1]), np.array([0.9, 0.9]))
