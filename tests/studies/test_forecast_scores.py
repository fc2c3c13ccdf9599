"""Scores of forecasts: exact answers on small files, and properties that they must have."""

import numpy as np
import pytest
import xarray
from matplotlib.tri import Triangulation

from dafw.studies.contour_distance import contour_distance
from dafw.studies.forecast_scores import BINS, bin_of, kept_scores, scores_of
from dafw.studies.forecast_table import forecast_table, forecast_tables
from dafw.studies.study_forecasts import judged

SIDE = np.linspace(0.0, 10.0, 11)
NODES = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)
TRIANGLES = Triangulation(*NODES.T).triangles.astype(np.int32)
X = NODES[:, 0]
LEADS, LIMIT, HORIZON = np.array([0.0, 5.0]), 0.0, 5.0


def front(place):
    """Return a field that exceeds 0 left of x = place."""
    return place - X


def forecasts(truth, median, chance, free, *, promised=0.8, reached=3.0):
    """Return a forecast.nc with one issue: fields and probabilities (lead, node); one area."""
    n = len(NODES)

    def of(values, *dims):
        return (("issue", *dims), np.asarray(values, dtype=float)[np.newaxis])

    arrival = np.where(chance[0] >= 0.5, 0.0, np.where(chance[1] >= 0.5, 5.0, np.nan))
    true_arrival = np.where(truth[0] > 0.0, 0.0, np.where(truth[1] > 0.0, 5.0, np.nan))
    return xarray.Dataset(
        {
            "exceedance_probability": of(chance[:, np.newaxis], "lead", "threshold", "node"),
            "reach_probability": of(chance.max(axis=0)[np.newaxis], "threshold", "node"),
            "arrival_time": of(arrival[np.newaxis, np.newaxis], "threshold", "quantile", "node"),
            "gas_exceeded": of(median[:, np.newaxis], "lead", "probability", "node"),
            "exceedance_probability_released": (("threshold", "node"), np.zeros((1, n))),
            "gas_exceeded_released": (("probability", "node"), np.full((1, n), -1.0)),
            "gas_truth": of(truth, "lead", "node"),
            "gas_free": of(free, "lead", "node"),
            "arrival_time_truth": of(true_arrival[np.newaxis], "threshold", "node"),
            "arrival_time_free": of(np.full((1, n), np.nan), "threshold", "node"),
            "area_exceedance_probability": of([[[0.0]], [[promised]]], "lead", "threshold", "area"),
            "area_reach_probability": of([[promised]], "threshold", "area"),
            "area_arrival_time": of([[[reached]]], "threshold", "quantile", "area"),
            "area_exceedance_probability_released": (("threshold", "area"), [[0.0]]),
            "area_gas_truth": of([[-1.0], [1.0]], "lead", "area"),
            "area_gas_free": of([[-1.0], [-1.0]], "lead", "area"),
            "area_arrival_time_truth": of([[4.0]], "threshold", "area"),
            "area_arrival_time_free": of([[np.nan]], "threshold", "area"),
            "area_arrival_time_members": of([[[2.0], [np.nan]]], "threshold", "member", "area"),
            "weight": of([0.75, 0.25], "member"),
            "area_name": ("area", ["gate"]),
            "mesh2d_face_nodes": (("face", "corner"), TRIANGLES),
            "node_x": ("node", NODES[:, 0]),
            "node_y": ("node", NODES[:, 1]),
        },
        coords={"issue": [1.0], "lead": LEADS, "threshold": [LIMIT], "quantile": [0.5], "probability": [0.5]},
        attrs={"scored_variable": "gas", "horizon": HORIZON},
    )


def usual(**changes):
    truth = np.stack([front(3.5), front(6.5)])
    given = {"truth": truth, "median": truth, "chance": (truth > 0.0).astype(float), "free": -truth}
    return scores_of(forecasts(**(given | changes)))


def test_a_forecast_that_knows_the_truth_has_no_error():
    scores = usual()
    for score in ("brier", "contour_distance", "arrival_error"):
        np.testing.assert_allclose(scores[f"{score}_belief"], 0.0, atol=1e-12)


def test_the_others_have_the_errors_that_can_be_counted():
    scores = usual()
    # The nodes 0 to 3 (lead 0) and 0 to 6 (lead 5) of eleven are true; half a cell belongs to those at the rim.
    np.testing.assert_allclose(scores["brier_now"].values.ravel(), [0.0, 0.3])
    np.testing.assert_allclose(scores["brier_released"].values.ravel(), [0.35, 0.65])
    np.testing.assert_allclose(scores["brier_free"].values.ravel(), [1.0, 1.0])
    np.testing.assert_allclose(scores["contour_distance_now"].values.ravel(), [0.0, 3.0])
    np.testing.assert_allclose(scores["contour_distance_free"].values.ravel(), [0.0, 0.0], atol=1e-12)
    assert np.isinf(scores["contour_distance_released"]).all()  # it has no contour
    np.testing.assert_allclose(scores["arrival_error_now"].values.ravel(), [0.0, 0.0])  # the horizon is 5 s, too
    np.testing.assert_allclose(scores["arrival_error_released"].values.ravel(), [5.0, 0.0])


def test_a_doubtful_forecast_has_the_mean_square_of_its_doubt():
    truth = np.stack([front(3.5), front(6.5)])
    chance = np.where(truth > 0.0, 0.7, 0.1)
    scores = usual(chance=chance)
    np.testing.assert_allclose(scores["brier_belief"].values.ravel(), [0.35 * 0.09 + 0.65 * 0.01, 0.65 * 0.09 + 0.0035])
    share = scores["reliability_share"].values[0, :, 0]
    np.testing.assert_allclose(share[:, [1, 7]], [[0.65, 0.35], [0.35, 0.65]])
    np.testing.assert_allclose(share.sum(axis=1), 1.0)
    promised, happened = (scores[f"reliability_{part}"].values[0, :, 0] for part in ("promised", "happened"))
    np.testing.assert_allclose(promised[:, [1, 7]], share[:, [1, 7]] * [0.1, 0.7])
    np.testing.assert_allclose(happened[:, [1, 7]], share[:, [1, 7]] * [0.0, 1.0])


def test_areas_have_the_brier_score_and_the_crps_of_the_weighted_members():
    scores = usual()
    assert scores["area_happened"].item() == 1.0
    assert scores["area_brier_belief"].item() == pytest.approx(0.04)
    assert scores["area_brier_free"].item() == 1.0
    # Members arrive after 2 s (three quarters) and not within 5 s; the truth after 4 s.
    expected = 0.75 * 2.0 + 0.25 * 1.0 - 0.75 * 0.25 * 3.0
    assert scores["area_arrival_crps_belief"].item() == pytest.approx(expected)
    assert scores["area_arrival_crps_free"].item() == pytest.approx(1.0)  # the horizon, 5 s


def test_distances_of_contours_are_symmetric_and_exact():
    left = np.array([[[0.0, 0.0], [0.0, 4.0]], [[0.0, 4.0], [0.0, 10.0]]])
    right = left + np.array([3.0, 0.0])
    assert contour_distance(left, right) == contour_distance(right, left) == pytest.approx(3.0)
    assert contour_distance(left, left) == 0.0
    nothing = np.empty((0, 2, 2))
    assert contour_distance(left, nothing) == contour_distance(nothing, left) == np.inf
    assert np.isnan(contour_distance(nothing, nothing))


def test_bins_are_centred():
    assert bin_of(np.array([0.0, 0.04, 0.06, 0.5, 0.94, 0.96, 1.0])).tolist() == [0, 0, 1, 5, 9, 10, 10]
    assert bin_of(np.arange(BINS + 1) / BINS).tolist() == list(range(BINS + 1))


def rows_of_now(chance):
    """The Brier score of what is promised at lead 0, kept up to 5 s: three nodes in ten have changed."""
    return 0.35 * (1.0 - chance.max()) ** 2 + 0.3 * (1.0 - chance.min()) ** 2 + 0.35 * chance.min() ** 2


def test_runs_are_judged_together():
    truth = np.stack([front(3.5), front(6.5)])
    chance = np.where(truth > 0.0, 0.7, 0.1)
    told = judged([usual(), usual(chance=chance)], "made")
    rows = {row["lead"]: row for row in told["by_lead"]}
    assert told["n_runs"] == 2 and set(rows) == {0.0, 5.0}
    single = 0.35 * 0.09 + 0.65 * 0.01
    assert rows[0.0]["brier_belief"] == pytest.approx(single / 2.0)
    assert rows[0.0]["brier_belief_interval"] == pytest.approx([0.0, single])
    assert rows[5.0]["contour_distance_now"] == pytest.approx(3.0)
    assert rows[5.0]["contour_distance_released"] is None  # infinite
    assert [(row["lead"], row["issue"]) for row in told["by_issue"]] == [(0.0, 1.0), (5.0, 1.0)]
    assert told["by_issue"][1]["brier_now"] == pytest.approx((0.3 + rows_of_now(chance)) / 2.0)
    (reliability,) = [row for row in told["reliability"] if row["lead"] == 0.0]
    assert reliability["promised"][7] == pytest.approx(0.7) and reliability["happened"][7] == pytest.approx(1.0)
    assert reliability["promised"][5] is None and sum(reliability["share"]) == pytest.approx(1.0)
    (areas,) = told["areas"]
    assert areas["n"][8] == 2 and areas["promised"][8] == pytest.approx(0.8) and areas["happened"][8] == 1.0
    assert areas["by_area"] == [{"name": "gate", "promised": pytest.approx(0.8), "happened": 1.0}]


def test_the_table_has_a_row_for_each_score_and_lead_time():
    text = forecast_table(judged([usual()], "made"))
    lines = text.splitlines()
    assert len(lines) == 2 + 3 * 2 + 2
    assert lines[0].split("|")[4:8] == [
        f" {title.ljust(len(cell) - 2)} "
        for title, cell in zip(
            ("belief", "free run", "stays as it is now", "stays where released"), lines[0].split("|")[4:8], strict=True
        )
    ]
    assert [cell.strip() for cell in lines[3].split("|")[1:-1]] == [
        "Brier score",
        "0",
        "5 s",
        "0.0000",
        "1.0000",
        "0.3000",
        "0.6500",
    ]
    assert forecast_tables({"made": judged([usual()], "made")}).startswith("## made\n\n| score")


def test_kept_scores_are_read_again_until_the_forecasts_change(tmp_path, monkeypatch):
    from dafw.studies import forecast_scores

    truth = np.stack([front(3.5), front(6.5)])
    made = forecasts(truth, truth, (truth > 0.0).astype(float), -truth)
    made.to_netcdf(tmp_path / "forecast.nc", engine="netcdf4")
    first = kept_scores(tmp_path)
    monkeypatch.setattr(forecast_scores, "forecast_scores", lambda path: pytest.fail("computed again"))
    assert kept_scores(tmp_path)["brier_now"].equals(first["brier_now"])
    monkeypatch.undo()
    forecasts(truth, truth, np.full(truth.shape, 0.5), -truth).to_netcdf(tmp_path / "forecast.nc", engine="netcdf4")
    assert kept_scores(tmp_path)["brier_belief"].values == pytest.approx(0.25)
