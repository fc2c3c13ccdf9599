"""Systems that are kept: found by their bits, made over when another needs the place, never stale."""

import numpy as np
import pytest

from dafw.plugins.models.dispersion.transport.kept import KeptSystems


class Maker:
    """Makes systems that are lists of the parameters they were made for, and counts them."""

    def __init__(self, limit):
        self.kept, self.made = KeptSystems(), 0
        self.kept.limit = limit

    def get(self, *parameters, fails=False):
        def make(reuse):
            self.made += reuse is None
            system = [] if reuse is None else reuse
            system.clear()
            if fails:
                raise ArithmeticError
            system.extend(parameters)
            return system

        return self.kept.place(np.array(parameters)).system(make)


def test_the_same_bits_get_the_same_system():
    maker = Maker(4)
    first = maker.get(1.0, 0.5)
    assert maker.get(1.0, 0.5) is first and first == [1.0, 0.5]
    assert maker.get(1.0, np.nextafter(0.5, 1.0)) is not first
    assert maker.get(0.0, 0.5) is not maker.get(-0.0, 0.5)
    assert len(maker.kept) == maker.made == 4


def test_the_one_not_used_for_longest_is_made_over():
    maker = Maker(2)
    one, two = maker.get(1.0), maker.get(2.0)
    assert maker.get(1.0) is one
    assert maker.get(3.0) is two and two == [3.0]
    assert maker.get(1.0) is one and one == [1.0]
    assert len(maker.kept) == maker.made == 2


def test_a_system_that_could_not_be_made_over_is_gone():
    maker = Maker(2)
    for parameter in (1.0, 2.0):
        maker.get(parameter)
    with pytest.raises(ArithmeticError):
        maker.get(3.0, fails=True)
    assert maker.get(1.0) == [1.0] and maker.get(3.0) == [3.0] and maker.get(2.0) == [2.0]


def test_a_smaller_limit_frees_what_is_too_much():
    maker = Maker(5)
    for parameter in range(5):
        maker.get(float(parameter))
    maker.kept.limit = 2
    assert maker.get(9.0) == [9.0]
    assert len(maker.kept) == 2
    assert maker.get(4.0) == [4.0] and maker.made == 5
