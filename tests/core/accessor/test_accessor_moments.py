"""Mean, spread and quantiles of a run: those of its members, with weights, round the circle."""

import numpy as np
import pytest
import xarray
from square import NODES, TIMES, X, square

from dafw import RunError
from dafw.core.accessor import by_row
from dafw.core.ensemble import Ensemble
from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE, StateSpace, Variable

ROWS = len(TIMES)


def single(values, kind=FIELD, weights=None, truth=None):
    rows = np.tile(np.asarray(values, dtype=float), (ROWS, 1))
    return square(members={"v": (rows, kind, truth)}, weights=None if weights is None else np.tile(weights, (ROWS, 1)))


def test_an_angle_is_averaged_round_the_circle():
    run = single(np.radians([350.0, 10.0]), ANGLE).dafw
    for mean in (run.mean("v"), run.quantile("v", 0.5)):
        off = (mean.values + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(run.quantile("v", [0.0, 1.0])), [[350.0] * ROWS, [10.0] * ROWS])
    np.testing.assert_allclose(np.degrees(run.spread("v")), np.sqrt(200.0))


def test_weights_count():
    run = single([1.0, 3.0, 9.0], weights=[0.75, 0.25, 0.0]).dafw
    np.testing.assert_allclose(run.mean("v"), 1.5)
    np.testing.assert_allclose(run.spread("v"), np.sqrt((0.75 * 0.25 + 0.25 * 2.25) / (1 - 0.75**2 - 0.25**2)))
    assert run.quantile("v", [0.5, 0.8]).values.tolist() == [[1.0] * ROWS, [3.0] * ROWS]


def test_rows_from_before_there_were_weights_count_all_members_equally():
    run = single([1.0, 3.0], weights=[0.75, 0.25])
    run["weight"][0] = np.nan
    np.testing.assert_allclose(run.dafw.mean("v"), [2.0, 1.5, 1.5])


def test_the_mean_of_a_positive_variable_is_geometric():
    run = single([1.0, 100.0], POSITIVE).dafw
    np.testing.assert_allclose(run.mean("v"), 10.0)
    np.testing.assert_allclose(run.spread("v"), np.sqrt(2.0) * np.log(10.0))
    np.testing.assert_allclose(run.quantile("v", 0.5), 10.0)


@pytest.mark.parametrize("kind", [FIELD, NONNEGATIVE, POSITIVE, ANGLE])
@pytest.mark.parametrize("weighted", [False, True])
def test_fields_have_the_moments_of_their_ensembles(kind, weighted):
    rng = np.random.default_rng(5)
    values = rng.uniform(0.1, 6.0, (ROWS, 7, len(NODES)))
    weights = rng.dirichlet(np.ones(7), ROWS) if weighted else None
    run = square(members={"gas": (values, kind, None)}, weights=weights)
    space = StateSpace([Variable("gas", len(NODES), kind)])
    for row in range(ROWS):
        ensemble = Ensemble(values[row], space, weights=None if weights is None else weights[row])
        np.testing.assert_array_equal(run.dafw.mean()[row], ensemble.mean)
        np.testing.assert_array_equal(run.dafw.spread()[row], ensemble.spread)
        np.testing.assert_array_equal(run.dafw.quantile(None, 0.3)[row], ensemble.quantile(0.3))
    assert run.dafw.quantile("gas", [0.1, 0.9]).dims == ("quantile", "time", "node")
    assert run.dafw.mean().attrs["units"] == "m"


def test_without_members_the_recorded_moments_are_given():
    run = square({"gas_mean": X, "gas_spread": 0.5 * X, "gas_forecast_mean": 2 * X, "gas_forecast_spread": 3 * X})
    np.testing.assert_array_equal(run.dafw.mean()[0], X)
    np.testing.assert_array_equal(run.dafw.spread()[0], 0.5 * X)
    np.testing.assert_array_equal(run.dafw.mean(of="forecast")[0], 2 * X)
    np.testing.assert_array_equal(run.dafw.spread(of="forecast")[0], 3 * X)


def test_quantiles_without_members_say_how_to_record_them():
    run = square({"gas_mean": X, "gas_spread": X})
    run["rate_mean"] = run["rate_spread"] = ("time", np.ones(ROWS))
    with pytest.raises(RunError, match=r"quantiles of 'gas' need its members.*record\.members=all"):
        run.dafw.quantile("gas", 0.5)
    with pytest.raises(RunError, match=r"'rate'.*record\.members=parameters"):
        run.dafw.quantile("rate", 0.5)


def test_wrong_requests_are_named():
    run = single([1.0, 2.0])
    with pytest.raises(RunError, match=r"no state variable 'w' in this run \(there are: v\)"):
        run.dafw.mean("w")
    with pytest.raises(RunError, match="between 0 and 1, got 50"):
        run.dafw.quantile("v", 50)
    with pytest.raises(RunError, match="of='guess' is no estimate of 'v'"):
        run.dafw.mean("v", of="guess")
    with pytest.raises(RunError, match="no v_smoothed_mean"):
        run.dafw.mean("v", of="smoothed")
    with pytest.raises(RunError, match="'scored_variable' is missing"):
        xarray.Dataset().dafw.mean()


@pytest.mark.parametrize("chunks", [{}, {"time": 1}, {"member": 2, "node": 100}])
def test_arrays_of_dask_stay_lazy_and_give_the_same(chunks):
    values = np.random.default_rng(1).normal(size=(ROWS, 5, len(NODES)))
    weights = np.random.default_rng(2).dirichlet(np.ones(5), ROWS)
    run = square(members={"gas": (values, FIELD, values[:, 0])}, weights=weights)
    lazy = run.chunk(chunks)
    for asked in (
        lambda run: run.dafw.mean(),
        lambda run: run.dafw.quantile("gas", [0.2, 0.7]),
        lambda run: run.dafw.crps(),
        lambda run: run.dafw.rmse(),
        lambda run: run.dafw.at("gas_members", [[1.0, 1.3]]),
    ):
        assert asked(run).chunks is None and asked(lazy).chunks is not None
        xarray.testing.assert_identical(asked(lazy).load(), asked(run))


def test_large_members_are_read_in_blocks_of_rows(monkeypatch):
    values = np.random.default_rng(1).normal(size=(ROWS, 5, len(NODES)))
    run = square(members={"gas": (values, FIELD, None)})
    at_once = run.dafw.mean()
    monkeypatch.setattr(by_row, "LARGE", values.nbytes - 1)
    lazy = run.dafw.mean()
    assert at_once.chunks is None and lazy.chunks is not None
    np.testing.assert_array_equal(lazy, at_once)


def test_rows_without_a_record_are_missing_and_absent_members_do_not_count():
    run = single([1.0, 3.0, np.nan])
    run["v_members"][1] = np.nan
    np.testing.assert_array_equal(run.dafw.mean("v"), [2.0, np.nan, 2.0])
    np.testing.assert_array_equal(run.dafw.quantile("v", 1.0), [3.0, np.nan, 3.0])
