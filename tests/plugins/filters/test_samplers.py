"""The filters that sample the control variables, amis and smc, against quadrature and exact solutions."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from levels import (
    CONTROLS,
    LIKELIHOOD,
    Levels,
    T,
    belief_moments,
    fit_of,
    last_cycle,
    level_study,
    posterior,
)

from dafw import ConfigurationError, Model, StateSpace, Study, Variable
from dafw.authoring.filter_windows import Elsewhere
from dafw.core.errors import OptionError, SolverError
from dafw.core.executors.processes import Processes
from dafw.core.options import require_options
from dafw.plugins.filters.amis import AMIS
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.kernels import Kernels
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.smc import POWERS, SMC, next_power, resampled
from dafw.plugins.filters.weights import effective_size, normalized
from dafw.plugins.readings.listed import Listed
from dafw.testing import CHECKS, run_check

SEEDS = 40
LIMIT, RUNS = 0.7, 12
"""A limit of the rate, and a seed with which the first guess of 20 members stays below it."""


def amis(**options):
    return AMIS(estimate=CONTROLS, likelihood=LIKELIHOOD, **{"steps": 10**6, "archive": 2} | options)


def smc(**options):
    return SMC(estimate=CONTROLS, likelihood=LIKELIHOOD, **{"steps": 10**6, "enough": 0.9} | options)


SAMPLERS = pytest.mark.parametrize("make", [amis, smc])


def diagnosed(cycle, name):
    return float(cycle.analysis.diagnostics[name].values)


# The posterior -------------------------------------------------------------------------------------------------------


def require_posterior(filter_, expected, seeds=SEEDS, **options):
    """Require moments (5,) of the belief at the end, on average over seeds, within four standard errors."""
    found = np.array(
        [belief_moments(last_cycle(level_study(filter_, seed=seed, **options)).belief) for seed in range(seeds)]
    )
    error = found.std(axis=0, ddof=1) / np.sqrt(seeds)
    assert (np.abs(found.mean(axis=0) - expected) < 4.0 * error).all()
    # The errors are small enough for the comparison to mean something.
    first, both, last = expected[2:]
    assert (error < 0.25 * np.sqrt([first, last, first**2, first * last + both**2, last**2])).all()


@pytest.mark.parametrize(("filter_", "members"), [(amis(), 20), (smc(), 60)], ids=["amis", "smc"])
def test_mean_and_covariance_are_those_of_quadrature(filter_, members):
    require_posterior(filter_, posterior(), members=members)


@SAMPLERS
def test_impossible_numbers_have_no_weight(make):
    """A third of the first guess without it, and nearly all of the posterior, lie above the highest rate."""
    require_posterior(make(), posterior(highest=0.4), seeds=20, model=Levels(highest=0.4), members=30)


# Members that the model cannot run -----------------------------------------------------------------------------------


@SAMPLERS
@pytest.mark.parametrize("fault", ["solver", "divergence"])
def test_proposals_that_the_model_cannot_run_are_left_out(make, fault):
    model = Levels(limit=LIMIT, fault=fault)
    cycles = list(level_study(make(), model=model, seed=RUNS))
    assert model.faults > 5
    for cycle in cycles:
        assert len(cycle.belief) == 20 and cycle.belief.members[:, 1].max() <= LIMIT
    require_all_judged(cycles[-1], range(T))


@SAMPLERS
def test_the_study_goes_on_if_no_proposal_can_be_run(make):
    model, cycles = Levels(), []
    for cycle in level_study(make(steps=500), model=model):
        cycles.append(cycle)
        model.limit = 0.0
    assert model.faults > 20 and len(cycles) == T
    require_all_judged(cycles[-1], range(T))


@SAMPLERS
def test_members_that_cannot_be_run_again_for_a_late_reading_are_left_out(make):
    model, last = Levels(), None
    for cycle in level_study(make(steps=0), model=model, late={1}):
        if cycle.state.cycle == T - 1:
            assert cycle.state.filter_memory["starts"][:, 1].max() > 0.3 > cycle.belief.members[:, 1].min()
            model.limit = 0.3
        last = cycle
    assert model.faults > 0 and len(last.belief) == 20
    assert last.state.filter_memory["starts"][:, 1].max() <= 0.3 and last.belief.members[:, 1].max() <= 0.3
    require_all_judged(last, range(T))


@SAMPLERS
def test_the_study_ends_if_no_member_can_be_run_again(make):
    model = Levels()
    with pytest.raises(SolverError, match="the rate is too large"):
        for _ in level_study(make(steps=0), model=model, late={1}):
            model.limit = 0.0


@SAMPLERS
def test_an_error_that_is_about_no_member_ends_the_study(make):
    model = Levels()
    with pytest.raises(SolverError, match="out of order"):
        for _ in level_study(make(), model=model):
            model.limit, model.fault = 0.0, "nobody's"


# Which readings ------------------------------------------------------------------------------------------------------


def require_all_judged(last, seen):
    """Require that every sample in the filter's memory was judged on exactly the readings of the cycles ``seen``."""
    memory = last.state.filter_memory
    rate, first = memory["starts"][:, 1], memory["starts"][:, 2]
    expected = fit_of(rate, first, seen)
    np.testing.assert_allclose(LIKELIHOOD.averaged(memory["fit"]), expected, rtol=1e-12, atol=1e-9)
    assert np.ptp(expected) > 0.1
    # Their runs have come as far as the study has.
    np.testing.assert_allclose(memory["members"][:, 0], first * np.exp(-T * rate), rtol=1e-12)
    np.testing.assert_array_equal(memory["model steps"], float(T))


@SAMPLERS
@pytest.mark.parametrize("every", [1, 4])
def test_late_readings_and_silent_cycles(make, every):
    on_time = last_cycle(level_study(make(every=every), silent={1, 4}))
    late = last_cycle(level_study(make(every=every), silent={1, 4}, late={0, 5}))
    for last in (on_time, late):
        require_all_judged(last, [0, 2, 3, 5, 6, 7])


@SAMPLERS
def test_a_reading_that_comes_late_between_two_analyses_is_used_in_the_next(make):
    study = level_study(make(every=4))
    study.readings.readings[1]["arrives"] = 6.0  # taken in the second cycle; the analyses are in the fourth and eighth
    require_all_judged(last_cycle(study), range(T))


@SAMPLERS
@pytest.mark.parametrize(("every", "seen"), [(2, [0, 2, 4, 6]), (4, [0, 5])], ids=str)
def test_readings_are_used_though_nothing_is_read_in_the_cycles_of_analyses(make, every, seen):
    """Those of observers come at the ends of cycles 0, S, 2 S, ...; analyses are due in cycles S - 1, 2 S - 1, ..."""
    last = last_cycle(level_study(make(every=every), silent=set(range(T)) - set(seen)))
    require_all_judged(last, seen)


@SAMPLERS
def test_a_first_reading_that_comes_late_and_between_analyses_is_used(make):
    study = level_study(make(every=4), silent={1, 2, 3, 4, 6, 7})
    study.readings.readings[0]["arrives"] = 2.0
    third, fourth, *_, last = list(study)[2:]
    assert not third.analysis.diagnostics and fourth.analysis.diagnostics
    require_all_judged(last, [0, 5])


@pytest.mark.parametrize("kind", [AMIS, SMC])
def test_a_run_that_is_cut_off_while_readings_wait_goes_on_with_the_same_bits(kind):
    outcome = run_check(CHECKS["filter"]["restart"], lambda: kind(**kind.check_options(), every=3))
    assert outcome.status == "passed", outcome.detail


@SAMPLERS
def test_with_one_analysis_late_readings_are_as_good_as_if_they_had_come_in_time(make):
    beliefs = [last_cycle(level_study(make(every=T), late=late)).belief for late in (set(), {0, 3, 5})]
    assert beliefs[0].members.tobytes() == beliefs[1].members.tobytes()
    assert beliefs[0].weights.tobytes() == beliefs[1].weights.tobytes()


@SAMPLERS
def test_between_analyses_the_forecast_is_kept(make):
    cycles = list(level_study(make(every=3)))
    for number, cycle in enumerate(cycles, 1):
        kept = cycle.belief.members.tobytes() == cycle.forecast.members.tobytes()
        assert kept == (number % 3 > 0)
    assert cycles[3].belief.weights.tobytes() == cycles[2].belief.weights.tobytes()


# Budget, bits, options -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [amis, lambda **options: smc(refresh=1, **options)], ids=["amis", "smc"])
@pytest.mark.parametrize("steps", [0, 50, 500])
def test_the_budget_is_kept_and_used(make, steps):
    runs = [diagnosed(cycle, "runs") * number for number, cycle in enumerate(level_study(make(steps=steps)), 1)]
    assert max(runs) <= steps
    assert (max(runs) > 0) == (steps > 0)


def test_an_analysis_of_amis_adds_at_most_so_many_batches():
    free, bound = (
        [diagnosed(cycle, "runs") / len(cycle.belief) for cycle in level_study(amis(batches=most))]
        for most in (None, 1)
    )
    assert max(free) > 1 and max(bound) == 1


@SAMPLERS
def test_the_same_bits_wherever_members_are_stepped(make):
    model = Levels(limit=LIMIT)
    here, there = (
        last_cycle(level_study(make(), model=model, seed=RUNS, **options))
        for options in ({}, {"executor": Elsewhere()})
    )
    assert model.faults > 0
    assert here.belief.members.tobytes() == there.belief.members.tobytes()
    assert here.belief.weights.tobytes() == there.belief.weights.tobytes()
    for name, array in here.state.filter_memory.items():
        assert np.asarray(array).tobytes() == np.asarray(there.state.filter_memory[name]).tobytes()


def test_the_same_bits_in_worker_processes(tmp_path, monkeypatch):
    package = tmp_path / "levels-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: levels\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[dafw]\nlevels = levels\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    model = Levels()
    model.name = "levels"
    here, there = (
        last_cycle(level_study(smc(), model=model, members=8, **options))
        for options in ({}, {"executor": Processes(workers=2), "configuration": {"model": {"name": "levels"}}})
    )
    assert here.belief.members.tobytes() == there.belief.members.tobytes()
    assert here.belief.weights.tobytes() == there.belief.weights.tobytes()


@pytest.mark.parametrize("kind", [AMIS, SMC])
@pytest.mark.parametrize(
    "options",
    [{"every": 0}, {"steps": -1}, {"enough": 0.0}, {"fresh": 1.5}, {"fresh": -0.1}, {"estimate": "rate"}],
    ids=str,
)
def test_nonsense_is_refused(kind, options):
    with pytest.raises(OptionError, match=next(iter(options))):
        require_options(kind(**options), "filter")


@pytest.mark.parametrize("options", [{"sweeps": 0}, {"refresh": 0}, {"enough": 1.1}], ids=str)
def test_smc_refuses_nonsense(options):
    with pytest.raises(OptionError, match=next(iter(options))):
        require_options(SMC(**options), "filter")


@SAMPLERS
def test_a_control_that_is_no_variable_is_refused_before_the_run(make):
    filter_ = make()
    filter_.estimate = ["rate", "colour"]
    with pytest.raises(ConfigurationError, match="colour"):
        level_study(filter_).begin()


# amis ----------------------------------------------------------------------------------------------------------------


def test_in_cycles_without_readings_the_search_goes_on_until_weights_are_good():
    """One reading, and a batch a cycle: what the first analysis could not finish, later ones do."""
    silent = set(range(1, T))
    cycles = list(level_study(amis(batches=1, enough=2.5, archive=10), members=20, silent=silent))
    runs = [diagnosed(cycle, "runs") if cycle.analysis.diagnostics else 0.0 for cycle in cycles]
    last = max(number for number, count in enumerate(runs) if count)
    assert 0 < last < T - 1 and min(runs[: last + 1]) == 20.0  # then it is finished, and the forecast is kept
    assert bool(cycles[last - 1].state.filter_memory["unfinished"])
    after = cycles[-1]
    assert not after.state.filter_memory["unfinished"]
    assert after.belief.members.tobytes() == after.forecast.members.tobytes()
    # Nothing is affordable any more: the memory stays as it is, though the weights are bad.
    (poor, *rest) = list(level_study(amis(steps=20, batches=1, enough=1.0), members=20, silent=silent))
    assert not poor.state.filter_memory["unfinished"] and all(not cycle.analysis.diagnostics for cycle in rest)


@dataclass
class Threshold(Model):
    """Shows by how much a number x is above 3, else nothing; the first guess of x is a standard normal one."""

    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("shown", 1), Variable("x", 1)]))

    def initial(self, n_members, rng):
        return self.settled(np.repeat(rng.draw(n_members, lambda one: one.standard_normal(1)), 2, axis=1))

    def step(self, members, t, rng):
        return members

    def settled(self, members):
        return np.column_stack([np.maximum(members[:, 1] - 3.0, 0.0), members[:, 1]])

    def log_first_guess(self, members):
        return -0.5 * members[:, 1] ** 2


def test_samples_that_are_all_equally_bad_are_not_taken_for_good_ones():
    """None of the first guess shows anything, so all have the same weight; but something was read."""
    filter_ = AMIS(estimate=["x"], likelihood=Likelihood(absolute=[0.05]), steps=1000)
    readings = Listed([{"time": 1.0, "value": 0.5, "entry": 0, "sd": 0.05}])
    cycles = list(Study(model=Threshold(), filter=filter_, readings=readings, members=10, cycles=20))
    assert cycles[0].forecast.members[:, 0].max() == 0.0
    last = cycles[-1].belief
    # The product of the two normal densities: that of the reading has the variance R + 0.05^2.
    variance = 1.0 / (1.0 + 1.0 / 0.005)
    assert last.mean[1] == pytest.approx(variance * 3.5 / 0.005, abs=3.0 * np.sqrt(variance))
    # Readings of nothing, which all explain, ask for no search.
    nothing = Listed([{"time": 1.0, "value": 0.0, "entry": 0, "sd": 0.05}])
    first = next(iter(Study(model=Threshold(), filter=filter_, readings=nothing, members=10, cycles=1)))
    assert diagnosed(first, "runs") == 0.0


@dataclass
class Sum(Model):
    """The sum of two numbers is seen; the first is N(0, 1) beforehand, the second is known, or N(2, second_sd^2)."""

    second_sd: float = 0.0
    dt: float = 1.0
    space: StateSpace = field(
        default_factory=lambda: StateSpace([Variable("sum", 1), Variable("first", 1), Variable("second", 1)])
    )

    def initial(self, n_members, rng):
        drawn = rng.draw(n_members, lambda generator: generator.standard_normal(2))
        return self.settled(np.column_stack([drawn[:, 0], drawn[:, 0], 2.0 + self.second_sd * drawn[:, 1]]))

    def settled(self, members):
        return np.column_stack([members[:, 1] + members[:, 2], members[:, 1:]])

    def step(self, members, t, rng):
        return members

    def log_first_guess(self, members):
        return -0.5 * members[:, 1] ** 2 - 0.5 * ((members[:, 2] - 2.0) / (self.second_sd or 1.0)) ** 2


def test_a_known_number_stays_what_it_is():
    readings = Listed([{"time": time, "value": 3.5, "entry": 0, "sd": 0.5} for time in range(1, 11)])
    filter_ = AMIS(estimate=["first", "second"], steps=4000)
    last = list(Study(model=Sum(), filter=filter_, readings=readings, members=20, cycles=10))[-1].belief
    assert (last.members[:, 2] == 2.0).all()
    assert last.mean[1] == pytest.approx(1.5 / (1.0 + 0.025), abs=0.15)


def test_an_unknown_number_that_amis_is_not_told_to_estimate_is_refused():
    readings = Listed([{"time": 1.0, "value": 3.5, "entry": 0, "sd": 0.5}])
    study = Study(model=Sum(second_sd=1.0), filter=AMIS(estimate=["first"]), readings=readings, members=20, cycles=1)
    with pytest.raises(ConfigurationError, match=r"AMIS.*: estimate must list .*, second too"):
        list(study)


def test_the_posterior_of_an_early_reading_is_found_in_silent_cycles():
    require_posterior(amis(batches=1), posterior(seen=[0, 1]), members=20, seeds=20, silent=set(range(2, T)))


def test_amis_knows_the_density_that_each_sample_was_drawn_from():
    """Batch by batch, sum_b n_b q_b has become what it is from all proposals at once, the first guess included."""
    filter_, members = amis(archive=100, fresh=0.25), 16
    memory = last_cycle(level_study(filter_, members=members)).state.filter_memory
    kernels = Kernels.from_memory(memory, Controls(Levels().space, CONTROLS))
    prior = np.exp(memory["log_prior"])
    batches = 0.25 * prior + 0.75 * np.exp(kernels.log_density(memory["coordinates"]))
    assert len(batches) > 3
    expected = np.log(members) + np.log(prior + batches.sum(axis=0))
    np.testing.assert_allclose(memory["log_proposal"], expected, rtol=1e-10)


# smc -----------------------------------------------------------------------------------------------------------------


def test_smc_weighs_with_the_likelihood_since_the_last_move():
    """Without moves it is importance sampling from the first guess."""
    last = last_cycle(level_study(smc(steps=0), members=50))
    memory = last.state.filter_memory
    expected = normalized(fit_of(memory["starts"][:, 1], memory["starts"][:, 2]))
    np.testing.assert_allclose(last.belief.weights, expected, rtol=1e-9)


def test_smc_moves_members_only_where_they_are_degenerate_or_due():
    cycles = list(level_study(smc(enough=0.3, refresh=None), members=30))
    for cycle in cycles:
        assert effective_size(cycle.belief.weights) >= 0.3 * 30
    moved = [diagnosed(cycle, "runs") > 0 for cycle in cycles]
    assert any(moved) and not all(moved)
    moved = [diagnosed(cycle, "runs") > 0 for cycle in level_study(smc(enough=1e-3, refresh=3), members=30)]
    assert np.diff(np.flatnonzero([True, *moved])).tolist() == [4, 3]


def test_a_budget_that_ends_before_the_power_is_one_is_made_up_for_later():
    cycles = list(level_study(smc(enough=0.9, refresh=None, steps=30), members=20))
    powers = [diagnosed(cycle, "power") for cycle in cycles if diagnosed(cycle, "runs") > 0]
    assert min(powers) < 1.0
    assert min(effective_size(cycle.belief.weights) for cycle in cycles) < 0.9 * 20


def test_the_next_power_is_the_largest_with_the_wanted_effective_size():
    fit = np.array([0.0, -1.0, -5.0, -20.0, -400.0])
    last = 0.0
    for wanted in (4.5, 4.0, 3.0, 2.0):
        power = next_power(np.zeros(5), fit, wanted)
        later = POWERS[np.searchsorted(POWERS, power) + 1]
        assert effective_size(normalized(power * fit)) >= wanted > effective_size(normalized(later * fit))
        assert power > last
        last = power
    assert next_power(np.zeros(5), np.zeros(5), 4.999) == 1.0
    # Members of the target with the power 0.1: every other power makes their weights less equal.
    assert next_power(-0.1 * fit, fit, 6.0) == pytest.approx(0.1, rel=0.04)


def test_resampled_members_keep_their_places_and_have_their_shares():
    weights = np.array([0.02, 0.3, 0.0, 0.18, 0.5])
    rng, counts, n = np.random.default_rng(1), np.zeros((5, 5)), 4000
    for _ in range(n):
        indices = resampled(weights, rng)
        copies = np.bincount(indices, minlength=5)
        assert (np.abs(copies - 5 * weights) < 1.0).all()
        assert (indices[copies > 0] == np.flatnonzero(copies > 0)).all()
        counts[np.arange(5), indices] += 1
    error = np.sqrt(5 * weights * (1 - np.minimum(weights, 1.0)) / n) + 1e-12
    assert (np.abs(counts.sum(axis=0) / n - 5 * weights) < 4 * error).all()
