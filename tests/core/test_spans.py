"""Readings that are means over a time: what a re-run predicts for them, in a linear problem with an exact answer."""

import numpy as np
import pytest
from toys import Counting, Nudge, toy_parts

from dafw import Analysis, Selection, Vehicle
from dafw.core.cycle import advance, start
from dafw.core.errors import ConfigurationError
from dafw.core.observation import Observation, nothing, stack
from dafw.core.spans import Means, begins, cycles_of

VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0)


def reads(*indices, spans=None):
    """Return an operator that reads entries of the state, with spans in s."""
    return Selection(
        indices=np.array(indices),
        covariance=np.ones(len(indices)),
        spans=None if spans is None else np.array(spans, dtype=float),
    )


class Blind(Nudge):
    """Does not change the belief, so that a re-run can be compared with it."""

    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members)


def flown(n_cycles):
    """Return the parts of a study with dt = 2 s and model error, and the members (T + 1, N, 3) at all times."""
    parts = toy_parts(filter=Blind(), model=Counting(spread=0.5, noise=0.1))
    states = [start(parts, 5, VEHICLE)]
    for _ in range(n_cycles):
        states.append(advance(parts, states[-1]).state)
    return parts, states[0].belief, np.array([state.belief.ensemble.members for state in states])


def test_a_span_is_a_number_of_cycles():
    operator = reads(0, 0, 0, 0, 0, spans=[0.0, 1.0, 2.0, 7.2, 1e300])
    np.testing.assert_array_equal(cycles_of(operator, 2.0)[:4], [1, 1, 1, 4])
    assert cycles_of(operator, 2.0)[4] > 1e9
    np.testing.assert_array_equal(cycles_of(reads(0, 1), 2.0), [1, 1])
    assert begins({5: reads(0), 7: reads(0, 1, spans=[2.0, 6.0]), 9: nothing()}, 2.0) == 5
    assert begins({7: reads(0, 1, spans=[2.0, 8.0])}, 2.0) == 4


def test_a_rerun_predicts_means_of_what_is_read_at_the_ends_of_cycles():
    parts, first, members = flown(6)
    operators = {
        1: reads(2, 0, spans=[20.0, 2.0]),  # longer than the run so far
        3: reads(0),
        4: reads(1, 2, spans=[6.0, 4.0]),
        5: reads(1, 0, 0, spans=[8.0, 0.0, 4.0]),  # overlaps the one before
    }
    found = parts.rerun(first, 0, 6, operators=operators)
    assert list(found.predicted) == [1, 3, 4, 5]
    after = members[1:]  # at the end of cycle c
    expected = {
        1: [after[0:2, :, 2].mean(0), after[1, :, 0]],
        3: [after[3, :, 0]],
        4: [after[2:5, :, 1].mean(0), after[3:5, :, 2].mean(0)],
        5: [after[2:6, :, 1].mean(0), after[5, :, 0], after[4:6, :, 0].mean(0)],
    }
    for cycle, columns in expected.items():
        np.testing.assert_allclose(found.predicted[cycle], np.stack(columns, axis=1), rtol=1e-14)


def test_without_spans_no_bit_changes_and_nothing_more_is_applied():
    parts, first, _ = flown(3)
    operators = {0: reads(0), 2: reads(1, 2)}
    assert Means(operators, 0, 2.0).applied == operators
    spanned = {0: reads(0, spans=[2.0]), 2: reads(1, 2, spans=[0.0, 1.0])}
    plain, same = (parts.rerun(first, 0, 3, operators=one).stacked() for one in (operators, spanned))
    assert plain.tobytes() == same.tobytes()


def test_operators_are_stacked_with_their_spans():
    both = stack((reads(0), reads(1, spans=[3.0]), nothing()))
    np.testing.assert_array_equal(both.spans, [0.0, 3.0])
    assert stack((reads(0), reads(1))).spans is None
    with pytest.raises(ConfigurationError, match="2 readings must have 2 spans"):
        reads(0, 1, spans=[1.0])
    Observation(np.ones(2), both)  # as the loop merges readings of one cycle
