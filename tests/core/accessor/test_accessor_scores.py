"""Errors against the truth: ERR, root mean square, and CRPS compared with its definition."""

import numpy as np
import pytest
from square import NODES, TIMES, X, square

from dafw import RunError
from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE

ROWS = len(TIMES)


def distance(kind, a, b):
    if kind is ANGLE:
        off = np.abs(a - b) % (2 * np.pi)
        return np.minimum(off, 2 * np.pi - off)
    return np.abs(np.log(a) - np.log(b)) if kind is POSITIVE else np.abs(a - b)


def double_sum(kind, members, truth, weights):
    """The definition of CRPS, (n,), for members (N, n)."""
    first = sum(w * distance(kind, x, truth) for w, x in zip(weights, members, strict=True))
    pairs = [
        w * v * distance(kind, x, z)
        for w, x in zip(weights, members, strict=True)
        for v, z in zip(weights, members, strict=True)
    ]
    return first - 0.5 * sum(pairs)


@pytest.mark.parametrize("kind", [FIELD, NONNEGATIVE, POSITIVE, ANGLE])
@pytest.mark.parametrize("weighted", [False, True])
def test_crps_is_its_definition(kind, weighted):
    rng = np.random.default_rng(3)
    values, truth = rng.uniform(0.1, 6.2, (ROWS, 6, len(NODES))), rng.uniform(0.1, 6.2, (ROWS, len(NODES)))
    weights = rng.dirichlet(np.ones(6), ROWS)
    weights[1] = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    run = square(members={"gas": (values, kind, truth)}, weights=weights if weighted else None)
    each = run.dafw.crps(each=True)
    assert each.dims == ("time", "node")
    for row in range(ROWS):
        shares = weights[row] if weighted else np.full(6, 1 / 6)
        np.testing.assert_allclose(each[row], double_sum(kind, values[row], truth[row], shares), atol=1e-12)
    np.testing.assert_allclose(run.dafw.crps(), each.mean("node"))


def test_crps_of_a_single_number_and_of_a_single_member():
    pair = np.tile([[1.0, 3.0]], (ROWS, 1))
    run = square(members={"v": (pair, FIELD, np.full(ROWS, 2.0))})
    np.testing.assert_allclose(run.dafw.crps("v"), 1.0 - 0.5 * 0.5 * 2.0)
    run = square(members={"v": (pair[:, :1], FIELD, np.full(ROWS, 4.0))})
    np.testing.assert_allclose(run.dafw.crps("v"), 3.0)


def test_err_and_rmse_of_a_field():
    run = square(
        {"gas_mean": X + 1.0, "gas_spread": X, "gas_truth": X, "gas_free": 0.0 * X, "gas_forecast_mean": 2 * X}
    )
    np.testing.assert_allclose(run.dafw.rmse(), 1.0)
    np.testing.assert_allclose(run.dafw.err(), 100.0 * np.sqrt(len(X)) / np.linalg.norm(X))
    np.testing.assert_allclose(run.dafw.err(of="free"), 100.0)
    np.testing.assert_allclose(run.dafw.err(of="forecast"), 100.0)
    assert run.dafw.err().dims == ("time",) and run.dafw.err().attrs["units"] == "percent"


def test_an_error_of_an_angle_goes_the_short_way_round():
    run = square(members={"v": (np.ones((ROWS, 2)), ANGLE, np.full(ROWS, 0.1))})
    run["v_mean"][:] = 2 * np.pi - 0.1
    np.testing.assert_allclose(run.dafw.rmse("v"), 0.2)


def test_err_of_a_positive_number_is_a_share_of_the_truth():
    run = square(members={"v": (np.ones((ROWS, 2)), POSITIVE, np.full(ROWS, 0.001))})
    run["v_mean"][:] = 0.003
    np.testing.assert_allclose(run.dafw.err("v"), 200.0)
    np.testing.assert_allclose(run.dafw.rmse("v"), np.log(3.0))
    assert run.dafw.rmse("v").attrs["units"] == "1"


def test_the_recorded_err_is_given_where_it_is_recorded():
    run = square({"gas_mean": X, "gas_spread": X, "gas_truth": X})
    run["err"] = ("time", [5.0, 6.0, 7.0])
    assert run.dafw.err().values.tolist() == [5.0, 6.0, 7.0]
    assert run.assign_attrs(scored_variable="other").dafw.err("gas").values.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("score", ["err", "rmse", "crps"])
def test_without_a_truth_there_is_no_error(score):
    run = square(members={"gas": (np.ones((ROWS, 2, len(NODES))), FIELD, None)})
    with pytest.raises(RunError, match="errors of 'gas' need a truth, which this run does not have"):
        getattr(run.dafw, score)()


def test_crps_without_members_says_how_to_record_them():
    run = square({"gas_mean": X, "gas_spread": X, "gas_truth": X})
    with pytest.raises(RunError, match=r"\(CRPS\) of 'gas' need its members.*record\.members=all"):
        run.dafw.crps()


def test_the_surprise_of_a_reading():
    run = square({"gas_mean": X, "gas_spread": X})
    for name, values in {"value": 5.0, "forecast_mean": 2.0, "forecast_spread": 4.0, "variance": 9.0}.items():
        run[f"observation_{name}"] = (("time", "observation"), [[np.nan], [values], [values]])
    np.testing.assert_allclose(run.dafw.surprise(), [[np.nan], [0.6], [0.6]])
    with pytest.raises(RunError, match=r"observation_forecast_spread, .* which this run does not all hold"):
        run.drop_vars("observation_forecast_spread").dafw.surprise()
