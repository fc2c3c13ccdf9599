"""The numbers of a study against numbers found by hand."""

import json
import math

import numpy as np
import pytest
import xarray
from made_runs import made_study, make_run
from scipy.stats import binomtest, bootstrap

from dafw.studies.outcomes import gather, write_study
from dafw.studies.results import write_results
from dafw.studies.study_statistics import bootstrap_interval, exact_interval, summarised
from dafw.studies.study_table import table

RADIANS = {"units": "rad", "comment": "angle in [0, 2 pi)"}


def wind(speed, degrees, speed_spread=0.1, direction_spread=0.1):
    """Return a last belief about a wind that truly is 5 m/s towards 0 degrees."""
    direction = (math.radians(degrees), direction_spread, 0.0, RADIANS)
    return {"wind_speed": (speed, speed_spread, 5.0, {"units": "m s-1"}), "wind_direction": direction}


@pytest.fixture
def folder(tmp_path):
    """Four runs: two that succeed, one that does not, one that fails at t = 1 s; none with seed 5."""
    runs = tmp_path / "runs" / "a"
    make_run(
        runs / "seed=1",
        [90, 40, 60, 40, 30],
        free=100,
        scalars=wind(5.05, 359.0),
        field=([1, 1, 1, 1], [2, 2, 2, 2]),
        model_seconds=100.0,
    )
    make_run(
        runs / "seed=2",
        [40, 30, 20, 15, 10],
        free=40,
        scalars=wind(4.8, 4.0, direction_spread=0.01),
        field=([1, 0, 0, 0], [0, 1, 0, 0]),
        model_seconds=300.0,
    )
    make_run(runs / "seed=3", [90, 80, 70, 49, 80], free=50, scalars=wind(8.0, 1.0), field=([3, 3, 3, 3], [1, 1, 1, 1]))
    make_run(runs / "seed=4", [90, 1], status="failed", error="the pump failed")
    return tmp_path


def test_every_number_of_a_summary_is_that_found_by_hand(folder):
    summary = summarised(gather(made_study(), folder))
    (one,) = summary["configurations"]
    assert (one["name"], one["n_seeds"], one["n_failed"], one["n_missing"]) == ("a", 4, 1, 0)
    assert one["success_rate"] == 0.5  # 30 and 10, not 80, not the one that failed
    assert one["better_than_free"] == 0.5  # 30 < 100 and 10 < 40
    assert one["median_err"] == (30 + 80) / 2  # of 10, 30, 80 and no end
    assert one["worst_err"] is None  # that of the failed run
    assert one["median_err_ratio"] == pytest.approx((0.3 + 1.6) / 2)  # of 0.25, 0.3, 1.6 and no end
    assert one["wind_found_rate"] == 0.5  # 1 % and 1 degree the short way round; 4 % and 4 degrees
    assert one["wind_found_rate_2"] == 0.25
    assert one["median_time_to_50"] is None  # 3 s, 0 s, never, never
    assert one["coverage_wind_speed"] == pytest.approx(1 / 3)  # 0.05 off with 0.1, 0.2 with 0.1, 3 with 0.1
    assert one["coverage_wind_direction"] == pytest.approx(2 / 3)  # 0.017 and 0.07 rad off with 0.1, 0.01, 0.1
    # 0.5 for half of everything; a corner in two triangles against one in one: 2 to 1; 3
    assert one["median_amount_ratio"] == pytest.approx(2.0) and one["worst_amount_off"] == pytest.approx(2.0)
    assert (one["seconds_per_run"], one["model_seconds"], one["real_time_factor"]) == (3.0, 200.0, 2.0)
    assert (one["best_seed"], one["worst_seed"]) == (2, 3)
    assert (summary["status"], summary["n_runs"], summary["n_complete"], summary["n_failed"]) == ("complete", 4, 3, 1)
    (failed,) = summary["failed"]
    assert (failed["configuration"], failed["seed"], failed["error"]) == ("a", 4, "the pump failed")
    assert one["exact_intervals"]["success_rate"] == exact_interval(2, 4)
    assert set(one["intervals"]) >= {"success_rate", "median_err", "wind_found_rate", "seconds_per_run"}
    json.dumps(summary, allow_nan=False)


def test_the_time_of_success_is_the_last_at_which_the_error_comes_below(folder):
    results = gather(made_study(), folder)
    np.testing.assert_array_equal(results["time_to_success"][0], [3.0, 0.0, np.inf, np.inf])
    np.testing.assert_array_equal(gather(made_study(success=85), folder)["time_to_success"][0], [1.0, 0.0, 1.0, np.inf])
    assert summarised(gather(made_study(success=85), folder))["configurations"][0]["median_time_to_50"] == 1.0


def test_runs_that_are_missing_are_counted_and_nothing_else(folder):
    make_run(folder / "runs" / "a" / "seed=6", [9, 9], status="interrupted")
    few, many = (summarised(gather(made_study(seeds=seeds), folder)) for seeds in ("1-4", "1-6"))
    assert few["status"] == "complete" and many["status"] == "interrupted"
    few_one, many_one = few["configurations"][0], many["configurations"][0]
    assert many_one.pop("n_missing") == 2 and few_one.pop("n_missing") == 0
    assert few_one == many_one


def test_where_all_runs_failed_nothing_succeeded(tmp_path):
    make_run(tmp_path / "runs" / "a" / "seed=1", [90, 1], status="failed", error="no")
    (one,) = summarised(gather(made_study(seeds=1), tmp_path))["configurations"]
    assert (one["success_rate"], one["median_err"], one["n_failed"]) == (0.0, None, 1)


def test_what_runs_do_not_have_is_null(tmp_path):
    for seed in (1, 2):
        make_run(tmp_path / "runs" / "a" / f"seed={seed}", [np.nan, np.nan])
    summary = summarised(gather(made_study(seeds="1-2"), tmp_path))
    (one,) = summary["configurations"]
    names = (
        "success_rate",
        "better_than_free",
        "median_err",
        "wind_found_rate",
        "median_time_to_50",
        "worst_amount_off",
    )
    assert [one[name] for name in names] == [None] * len(names) and one["seconds_per_run"] == 3.0
    assert "success" not in table(summary) and "| a " in table(summary)


def test_a_positive_parameter_is_compared_in_its_logarithm(tmp_path):
    notes = {"units": "m2 s-1", "comment": "positive: means are geometric, spreads are of the natural logarithm"}
    for seed, mean in ((1, 0.8 * math.exp(0.16)), (2, 0.8 * math.exp(-0.17))):
        make_run(tmp_path / "runs" / "a" / f"seed={seed}", [1], scalars={"diffusion": (mean, 0.1, 0.8, notes)})
    results = gather(made_study(seeds="1-2"), tmp_path)
    np.testing.assert_allclose(results["final_diffusion_off"][0], [0.16, -0.17])
    np.testing.assert_array_equal(results["final_diffusion_inside"][0], [1.0, 0.0])


def test_the_file_is_tidy_and_opens_without_dafw(folder):
    make_run(folder / "runs" / "b" / "seed=1", [50, 20], free=40)
    study = made_study(configurations={"a": [], "b": ["members=3"]})
    write_study(gather(study, folder), folder / "study.nc")
    with xarray.open_dataset(folder / "study.nc") as results:
        assert dict(results.sizes) == {"configuration": 2, "seed": 4, "time": 5}
        assert results["configuration"].values.tolist() == ["a", "b"] and results["seed"].values.tolist() == [
            1,
            2,
            3,
            4,
        ]
        assert results["status"].sel(configuration="a").values.tolist() == ["complete"] * 3 + ["failed"]
        assert results["status"].sel(configuration="b", seed=2).item() == "missing"
        assert results["error"].sel(configuration="a", seed=4).item() == "the pump failed"
        np.testing.assert_array_equal(results["err"].sel(configuration="b", seed=1), [50, 20, np.nan, np.nan, np.nan])
        np.testing.assert_array_equal(results["err"].sel(configuration="a", seed=4)[:3], [90, 1, np.nan])
        np.testing.assert_array_equal(results["err_final"], [[30, 10, 80, np.nan], [20, np.nan, np.nan, np.nan]])
        assert results["final_wind_speed"].dims == ("configuration", "seed")
        assert results["final_wind_speed_truth"].sel(configuration="a", seed=1).item() == 5.0


def test_runs_with_other_time_steps_keep_their_own_times(tmp_path):
    make_run(tmp_path / "runs" / "a" / "seed=1", [60, 40, 30])
    make_run(tmp_path / "runs" / "b" / "seed=1", [60, 60, 30], dt=0.5)
    results = gather(made_study(configurations={"a": [], "b": []}, seeds=1), tmp_path)
    np.testing.assert_array_equal(results["time_to_success"], [[1.0], [1.0]])
    np.testing.assert_array_equal(results["row_time"][1, 0], [0.0, 0.5, 1.0])


def test_places_on_an_axis_are_numbers_where_they_can_be(tmp_path):
    axes = {"members": [10, 20], "filter.rotation": [True, False], "inflation": [1, 1.5]}
    results = gather(made_study(configurations={}, axes=axes, seeds=1), tmp_path)
    assert results["members"].values.tolist() == [10] * 4 + [20] * 4 and results["members"].dtype == np.int64
    assert results["inflation"].values.tolist() == [1.0, 1.5] * 4
    assert set(results["filter.rotation"].values.tolist()) == {"true", "false"}


def test_an_interval_is_the_same_each_time_and_its_own_for_each_configuration():
    values = np.random.default_rng(3).exponential(size=40)
    once, again = (bootstrap_interval(values, np.median, "a median_err") for _ in range(2))
    assert once == again
    assert once != bootstrap_interval(values, np.median, "b median_err")


@pytest.mark.parametrize("statistic", [np.mean, np.median])
def test_an_interval_is_that_of_scipy(statistic):
    values = np.random.default_rng(4).exponential(size=60)
    theirs = bootstrap(
        (values,), statistic, n_resamples=20_000, method="percentile", rng=np.random.default_rng(5)
    ).confidence_interval
    # Both estimate the ends of the same distribution, each with its own 4,000 and 20,000 draws.
    width = theirs.high - theirs.low
    np.testing.assert_allclose(bootstrap_interval(values, statistic, "it"), theirs, atol=0.05 * width)


def test_an_interval_of_runs_that_never_succeed_has_no_end():
    never = np.array([1.0, 2.0, np.inf, np.inf, np.inf])
    low, high = bootstrap_interval(never, np.median, "time")
    assert low in (1.0, 2.0) and high is None


@pytest.mark.parametrize(("successes", "runs"), [(0, 20), (3, 20), (19, 20), (20, 20), (0, 1), (1, 1)])
def test_the_interval_of_a_rate_is_the_exact_one(successes, runs):
    theirs = binomtest(successes, runs).proportion_ci(0.95, method="exact")
    np.testing.assert_allclose(exact_interval(successes, runs), theirs, rtol=1e-12, atol=1e-15)


def test_the_results_are_written_and_the_table_says_the_same(folder):
    summary = write_results(made_study(), folder, pictures=False)
    assert json.loads((folder / "summary.json").read_text()) == {k: v for k, v in summary.items() if k != "table"}
    text = (folder / "table.md").read_text()
    assert text == summary["table"]
    heading, _, row = (line.split("|")[1:-1] for line in text.splitlines())
    cells = dict(zip(map(str.strip, heading), map(str.strip, row), strict=True))
    assert cells["seeds"] == "4 (1 failed)" and cells["median ERR"].startswith("55.0 % (10.0 to ")
    assert cells["success"] == "50 % (7 to 93)" and cells["wind found"] == "50 % (7 to 93)"
    assert not {"worst ERR", "time to success"} & set(cells)  # no configuration has one
