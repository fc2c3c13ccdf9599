"""Candidates and what is done with weights: re-runs, draws without repeats, systematic draws, clipping."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from levels import CONTROLS, LIKELIHOOD, Levels, T, fit_of, last_cycle, level_study

from dafw import Filter
from dafw.core.ensemble import Analysis
from dafw.core.errors import ComputationError, ContractError, SolverError
from dafw.plugins.filters.amis import AMIS
from dafw.plugins.filters.candidates import (
    Candidates,
    evaluated,
    first_candidates,
    log_prior_of,
    readings_before,
    tried,
)
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.smc import SMC
from dafw.plugins.filters.weights import clipped, effective_size, n_moments, normalized, systematic, without_repeats


@dataclass
class Watching(Filter):
    """Changes nothing, and keeps the windows that it is given."""

    window = None
    past_beliefs = "first"
    windows: list = field(default_factory=list)

    def analyse_window(self, window, rng):
        self.windows.append(window)
        return Analysis(window.forecast.ensemble.members, window.memory)


def watched(model=None, **options):
    """Return the windows of a study that changes nothing, and its controls."""
    filter_ = Watching()
    last_cycle(level_study(filter_, model=model, members=6, **options))
    return filter_.windows, Controls(Levels().space, CONTROLS)


def require_same(one, other):
    """Require two sets of candidates with the same bits."""
    one, other = one.to_memory(), other.to_memory()
    assert set(one) == set(other)
    for name, array in one.items():
        assert np.asarray(array).tobytes() == np.asarray(other[name]).tobytes(), name


# Runs ----------------------------------------------------------------------------------------------------------------


def test_candidates_have_their_fit_their_prior_and_their_state():
    windows, controls = watched()
    found = first_candidates(windows[-1], controls, LIKELIHOOD)
    rate, first = found.starts[:, 1], found.starts[:, 2]
    np.testing.assert_allclose(LIKELIHOOD.averaged(found.fit), fit_of(rate, first), rtol=1e-12)
    np.testing.assert_allclose(found.now.ensemble.members[:, 0], first * np.exp(-T * rate), rtol=1e-12)
    np.testing.assert_array_equal(found.coordinates, np.column_stack([np.log(rate), first]))
    expected = Levels().log_first_guess(found.starts) + np.log(rate)
    np.testing.assert_allclose(found.log_prior, expected, rtol=1e-12)


def test_carried_on_cycle_by_cycle_they_have_the_bits_of_a_run_from_the_start():
    windows, controls = watched(silent={3})
    candidates = first_candidates(windows[0], controls, LIKELIHOOD)
    done = windows[0].cycles[-1].number + 1
    for window in windows[1:]:
        memory = {"done": np.array(done), "seen": np.array(readings_before(window, done))}
        candidates = candidates.carried_on(window, memory, LIKELIHOOD)
        done = window.cycles[-1].number + 1
    require_same(candidates, first_candidates(windows[-1], controls, LIKELIHOOD))


def test_after_a_late_reading_they_have_the_bits_of_a_run_from_the_start():
    windows, controls = watched(late={1})
    before, now = windows[-2:]
    candidates = first_candidates(before, controls, LIKELIHOOD)
    memory = {"done": np.array(T - 1), "seen": np.array(readings_before(before, T - 1))}
    assert memory["seen"] == T - 2
    require_same(candidates.carried_on(now, memory, LIKELIHOOD), first_candidates(now, controls, LIKELIHOOD))


def test_readings_that_are_means_over_cycles_before_are_predicted_as_such():
    """The carried candidates are run again from the start, because a new reading is about earlier cycles, too."""
    windows, controls = watched(span=3.0)
    before, now = windows[-2:]
    memory = {"done": np.array(T - 1), "seen": np.array(readings_before(before, T - 1))}
    found = first_candidates(before, controls, LIKELIHOOD).carried_on(now, memory, LIKELIHOOD)
    require_same(found, first_candidates(now, controls, LIKELIHOOD))
    rate, first = found.starts[:, 1, np.newaxis], found.starts[:, 2, np.newaxis]
    levels = first * np.exp(-rate * np.arange(1, T + 1))
    means = [levels[:, max(0, end - 3) : end].mean(axis=1) for end in range(1, T + 1)]
    np.testing.assert_allclose(found.predicted, np.stack(means, axis=1), rtol=1e-12)


def test_candidates_survive_as_arrays_are_joined_and_taken():
    windows, controls = watched()
    candidates = first_candidates(windows[-1], controls, LIKELIHOOD)
    require_same(Candidates.from_memory(candidates.to_memory(), controls.space), candidates)
    first, rest = candidates.taken(np.array([0, 1])), candidates.taken(np.array([2, 3, 4, 5]))
    require_same(first.joined(rest), candidates)
    np.testing.assert_array_equal(rest.now.memory["steps"], candidates.now.memory["steps"][2:])


class Unsure(Levels):
    """Calls its own slowest first guess impossible, or does not know how likely it is."""

    said = -np.inf

    def log_first_guess(self, members):
        density = super().log_first_guess(members)
        return np.where(members[:, 1] == members[:, 1].min(), self.said, density)


@pytest.mark.parametrize(
    ("said", "message"),
    [(-np.inf, "calls 1 of 20 first guesses impossible that"), (np.nan, "must return numbers below infinity, got")],
)
@pytest.mark.parametrize("filter_", [AMIS(estimate=CONTROLS), SMC(estimate=CONTROLS)], ids=["amis", "smc"])
def test_a_model_that_calls_its_own_first_guess_impossible_is_named(filter_, said, message):
    model = Unsure()
    model.said = said
    with pytest.raises(ContractError, match=f"model 'Unsure': log_first_guess {message}"):
        last_cycle(level_study(filter_, model=model))


@pytest.mark.parametrize("fault", ["solver", "divergence"])
def test_those_that_cannot_be_run_are_left_out(fault):
    model = Levels(fault=fault)
    windows, controls = watched(model)
    window = windows[-1]
    starts = window.first.ensemble.members
    prior = log_prior_of(window, controls, starts, controls.coordinates(starts))
    model.limit = float(np.sort(starts[:, 1])[2])
    found, kept = tried(window, starts, controls.coordinates(starts), prior, LIKELIHOOD)
    np.testing.assert_array_equal(kept, np.flatnonzero(starts[:, 1] <= model.limit))
    assert model.faults == 3 == len(kept)
    model.limit = 1e9
    require_same(found, evaluated(window, starts, controls.coordinates(starts), prior, LIKELIHOOD)[0].taken(kept))


def test_if_none_can_be_run_there_is_none_and_other_errors_are_passed_on():
    model = Levels()
    windows, controls = watched(model)
    starts = windows[-1].first.ensemble.members
    arguments = windows[-1], starts, controls.coordinates(starts), np.zeros(6), LIKELIHOOD
    assert tried(windows[-1], starts[:0], controls.coordinates(starts[:0]), np.zeros(0), LIKELIHOOD) is None
    model.limit = 0.0
    assert tried(*arguments) is None
    with pytest.raises(SolverError, match="too large"):
        evaluated(*arguments)
    model.fault = "nobody's"
    with pytest.raises(SolverError, match="out of order"):
        tried(*arguments)


# Weights -------------------------------------------------------------------------------------------------------------

SHARES = np.array([0.4, 0.02, 0.0, 0.13, 0.05, 0.25, 0.1, 0.05])
OFFSETS = (np.arange(4000) + 0.5) / 4000


def test_weights_are_normalized_without_overflow():
    np.testing.assert_allclose(normalized(np.log([1.0, 3.0]) + 1e5), [0.25, 0.75], rtol=1e-9)
    np.testing.assert_array_equal(normalized(np.array([-np.inf, 0.0])), [0.0, 1.0])
    np.testing.assert_array_equal(normalized(np.full(4, -np.inf)), np.full(4, 0.25))
    assert effective_size(np.full(5, 0.2)) == pytest.approx(5.0)
    assert effective_size(np.array([0.0, 1.0])) == 1.0


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_no_weights_are_made_of_what_is_no_number(wrong):
    with pytest.raises(ComputationError, match="weights of samples: 1 of 3 log weights are NaN or infinity"):
        normalized(np.array([0.0, wrong, -np.inf]))


@pytest.mark.parametrize("size", [1, 3, 5])
def test_without_repeats_the_chances_are_exact_and_averages_keep_their_expectation(size):
    values = np.array([3.0, -1.0, 9.0, 0.5, 2.0, -4.0, 1.0, 7.0])
    drawn_how_often, average = np.zeros(8), 0.0
    for offset in OFFSETS:
        drawn, chance = without_repeats(SHARES, size, offset)
        assert len(drawn) == size and (np.diff(drawn) > 0).all()
        drawn_how_often[drawn] += 1.0 / len(OFFSETS)
        average += (SHARES[drawn] / chance) @ values[drawn] / len(OFFSETS)
    # One factor for all whose chance is not one.
    some = drawn_how_often < 1.0 - 1e-9
    factor = drawn_how_often[some].sum() / SHARES[some].sum()
    np.testing.assert_allclose(drawn_how_often[some], factor * SHARES[some], atol=5e-4)
    assert (factor * SHARES[~some] >= 1.0).all()
    assert drawn_how_often.sum() == pytest.approx(size)
    assert average == pytest.approx(SHARES @ values, abs=2e-3)


def test_without_repeats_all_are_taken_if_there_are_no_more():
    for size in (8, 9):
        drawn, chance = without_repeats(SHARES, size, 0.3)
        assert drawn.tolist() == list(range(8)) and chance.tolist() == [1.0] * 8


@pytest.mark.parametrize("size", [1, 5, 40])
def test_systematic_draws_are_within_one_of_the_expected_number(size):
    counts = np.zeros(8)
    for offset in OFFSETS[::4]:
        copies = np.bincount(systematic(SHARES, size, offset), minlength=8)
        assert copies.sum() == size and (np.abs(copies - size * SHARES) < 1.0).all()
        counts += copies / len(OFFSETS[::4])
    np.testing.assert_allclose(counts, size * SHARES, atol=2e-3)
    assert systematic(np.full(3, 1.0 / 3.0), 3, 1.0 - 1e-16).max() == 2


@pytest.mark.parametrize("count", [1, 3, 20])
def test_the_largest_weights_are_made_equal_and_the_rest_keep_their_ratios(count):
    log_weights = 50.0 * np.random.default_rng(6).normal(size=20)
    weights, order = clipped(log_weights, count), np.argsort(-log_weights)
    np.testing.assert_allclose(weights[order[:count]], weights.max())
    np.testing.assert_allclose(
        weights[order[count - 1 :]], normalized(log_weights[order[count - 1 :]]) * weights[order[count - 1 :]].sum()
    )
    assert effective_size(weights) >= count * (1.0 - 1e-12)


@pytest.mark.parametrize("k", [1, 2, 3, 6])
def test_moments_are_the_integral_the_mean_and_the_different_entries_of_the_covariance(k):
    assert n_moments(k) == 1 + k + len(np.triu_indices(k)[0])
