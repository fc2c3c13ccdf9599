"""Carrying members side by side: the same bits and the same errors as one after the other."""

from threading import Barrier, current_thread, main_thread

import numpy as np
import pytest

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.mesh.partition import Undivided
from dafw.plugins.models.dispersion.transport.carry import carry

MEMBERS, NODES, STEPS = 5, 4, 6


class Shrinks:
    """A system whose gas shrinks by a factor in every step; the factor is the wind."""

    def __init__(self, factor, meet):
        self.factor, self.meet = factor, meet

    def balanced_steps(self, concentration, sources):
        self.meet()
        if self.factor < 0.0:
            raise SolverError(f"factor {self.factor}")
        after = concentration * self.factor ** np.arange(1, len(sources) + 1)[:, np.newaxis]
        return after, -np.diff(after.sum(axis=1), prepend=concentration.sum())

    def gas(self, concentration):
        return concentration.sum()


def carried(factors, threads, most_systems=100, meet=lambda: None):
    """Carry members through steps with factors (steps, N); return their fields and the diagnostics of the steps."""
    fields = [np.arange(1.0, 1.0 + MEMBERS * NODES).reshape(MEMBERS, NODES) for _ in range(STEPS)]
    winds = [step[:, np.newaxis] for step in factors]

    def system_of(wind, diffusion):
        return lambda: Shrinks(wind[0], meet)

    added = carry(fields, winds, [None] * STEPS, np.ones(MEMBERS), system_of, Undivided(NODES), threads, most_systems)
    return fields, added


def factors(changing):
    drawn = np.random.default_rng(3).uniform(0.5, 1.0, (STEPS, MEMBERS))
    return drawn if changing else np.broadcast_to(drawn[0], drawn.shape)


@pytest.mark.parametrize("changing", [False, True], ids=["one wind", "changing wind"])
def test_threads_change_no_bit(changing):
    one, two = (carried(factors(changing), threads) for threads in (1, 3))
    start = np.arange(1.0, 1.0 + MEMBERS * NODES).reshape(MEMBERS, NODES)
    np.testing.assert_allclose(one[0][-1], start * factors(changing).prod(axis=0)[:, np.newaxis], rtol=1e-14)
    for fields, others in zip(one[0], two[0], strict=True):
        np.testing.assert_array_equal(fields, others)
    for step, other in zip(one[1], two[1], strict=True):
        assert step.keys() == other.keys() == {"gas", "gas_gone"}
        for name in step:
            np.testing.assert_array_equal(step[name].values, other[name].values)


def test_members_are_carried_at_the_same_time():
    meeting = Barrier(MEMBERS, timeout=60.0)  # broken, which raises, unless all members wait at once
    carried(factors(False), MEMBERS, meet=meeting.wait)


def test_without_places_for_all_systems_there_is_one_thread():
    def meet():
        assert current_thread() is main_thread()

    carried(factors(True), 3, most_systems=STEPS * MEMBERS - 1, meet=meet)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_error_is_that_of_the_first_member(threads):
    wrong = factors(False).copy()
    wrong[:, [2, 4]] = -1.0
    with pytest.raises(SolverError, match="factor -1") as failed:
        carried(wrong, threads)
    assert failed.value.member == 2
