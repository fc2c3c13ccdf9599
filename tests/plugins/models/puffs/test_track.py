"""A moving sensor: its track, the gas at points against an independent sum, and its slow response."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from dafw.core.errors import ConfigurationError, ReadingsError
from dafw.core.rng import Streams
from dafw.plugins.models.puffs.model_track import PuffsTrack
from dafw.plugins.models.puffs.path_means import ages_to
from dafw.plugins.models.puffs.point_levels import point_levels
from dafw.plugins.models.puffs.track import TrackFile, read_track

SHAPE = np.array([0.2, 1.3, 0.7, 0.4, 0.5, 0.6])  # turn, factor, s_0, h_0, spread, lift
TRUTH = {
    "release_x": 0.0,
    "release_y": 0.0,
    "rate": 3.0,
    "wind_turn": 0.0,
    "wind_factor": 1.0,
    "first_width": 0.6,
    "first_height": 0.6,
    "spread": 0.3,
    "lift": 1.0,
    "response_time": 10.0,
}


def hovering(truth=TRUTH, **options):
    """Return a model whose sensor hovers 30 m downwind of the leak, 2 m above the ground."""
    quick = {"wind": {"steady": [2.0, 0.0, 0.8, 0.3]}, "area": [-50.0, -50.0, 50.0, 50.0], "dt": 5.0, "moments": 2}
    return PuffsTrack.from_options(track={"points": [[0.0, 30.0, 1.0, 2.0]]}, truth=truth, **{**quick, **options})


def test_the_gas_at_a_point_is_the_sum_of_the_puffs():
    ages, lengths = np.array([4.0, 9.0]), np.array([3.0, 7.0])
    carried = np.array([[[3.0, 1.0], [8.0, 2.0]], [[2.0, 2.0], [5.0, 6.0]]])
    turbulence = np.array([[1.1, 0.3], [0.8, 0.4]])
    points, place = np.array([[5.0, 4.0, 1.5], [6.0, 8.0, 0.2]]), np.array([1.0, 2.0])
    turn, factor, wide, high, spread, lift = SHAPE
    turned = factor * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    found = point_levels(place[np.newaxis], SHAPE[np.newaxis], carried, turbulence, ages, lengths, points, 9e9)
    for moment, point in enumerate(points):
        total = 0.0
        for number, age in enumerate(ages):
            s = np.hypot(wide, spread * turbulence[moment, 0] * age)
            h = np.hypot(high, lift * turbulence[moment, 1] * age)
            flat = np.prod(norm.pdf(point[:2], place + turned @ carried[moment, number], s))
            total += lengths[number] * flat * (norm.pdf(point[2], 0.0, h) + norm.pdf(-point[2], 0.0, h))
        assert found[0, moment] == pytest.approx(total, rel=1e-3)  # puffs farther than four widths are left out
    assert (found > 1e-4).all()


def test_all_gas_crosses_a_plane_across_the_wind():
    """Over a plane across a steady wind U, the integral of the gas is 1 g/s over U."""
    ages, lengths = ages_to(60.0, 0.05, 0.002)
    y, z = np.meshgrid(np.linspace(-30.0, 30.0, 61), np.linspace(0.0, 40.0, 81), indexing="ij")
    points = np.column_stack([np.full(y.size, 40.0), y.ravel(), z.ravel()])
    carried = np.tile(np.stack([2.0 * ages, 0.0 * ages], axis=1), (len(points), 1, 1))
    turbulence = np.tile([1.0, 0.3], (len(points), 1))
    shape = np.array([[0.0, 1.0, 4.0, 0.6, 0.0, 0.5]])
    level = point_levels(np.zeros((1, 2)), shape, carried, turbulence, ages, lengths, points, 9e9).reshape(y.shape)
    assert np.trapezoid(np.trapezoid(level, z[0], axis=1), y[:, 0]) == pytest.approx(0.5, rel=3e-3)


def test_a_slow_sensor_comes_to_what_it_meets_as_an_exponential():
    model = hovering()
    members, shown = np.append([0.0, 0.0], list(TRUTH.values()))[np.newaxis], []
    for step in range(40):
        members = model.step(members, 5.0 * step, None)
        shown.append(members[0, 1])
    whole = shown[-1] / (1.0 - np.exp(-200.0 / 10.0))
    assert whole > 1.0
    times = 5.0 * np.arange(1, 41)
    np.testing.assert_allclose(shown, whole * (1.0 - np.exp(-times / 10.0)), rtol=1e-9)
    assert members[0, 0] == pytest.approx(whole, rel=1e-6)


def test_the_gas_is_in_proportion_to_the_rate():
    model = hovering()
    one = np.append([0.0, 0.0], list(TRUTH.values()))
    two = one.copy()
    two[4] *= 2.0
    stepped = model.step(np.stack([one, two]), 0.0, None)
    np.testing.assert_allclose(stepped[1, :2], 2.0 * stepped[0, :2])
    assert stepped[0, 0] > 0.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"priors": {"spread": {"name": "normal", "mean": 0.3, "sd": 0.2}}},
            "model 'puffs.*': priors: spread: prior 'normal' with mean 0.3, sd 0.2 is not one of a positive number",
        ),
        ({"truth": {"rate": 0.0}}, "truth: rate: prior 'point' with mean 0 is not one of a positive number"),
    ],
)
def test_a_number_that_must_be_positive_is_not_drawn_from_a_prior_that_goes_below_zero(options, said):
    with pytest.raises(ConfigurationError, match=said):
        hovering(**{"truth": {}, **options})


def test_what_the_usual_priors_draw_is_possible():
    model = hovering(truth={}, priors={"rate": {"name": "uniform", "low": 0.0, "high": 1e-6}})
    members = model.first_guess(200, Streams(1).members("initial", 0)).ensemble.members
    rate = members[:, model.space.slice("rate")]
    assert rate.min() > 0.0 and len(np.unique(rate)) == 200
    assert np.isfinite(model.log_first_guess(members)).all()


def test_a_track_is_read_from_a_log(tmp_path):
    head = 'time,"Lat","Lon",Height (m)\n'
    text = head + "10,50.0,8.0,-0.4\n30,50.0,8.001,9.0\n20,50.001,8.0,5\n30,50.0,8.001,11.0\n,1,1,1\n"
    (tmp_path / "log.csv").write_text(text)
    options = TrackFile(file=str(tmp_path / "log.csv"), height="Height", origin="first", start=10.0)
    options.columns.lat, options.columns.lon = "Lat", "Lon"
    track = read_track(options, "model")
    np.testing.assert_array_equal(track.time, [0.0, 10.0, 20.0])
    np.testing.assert_allclose(track.places, [[0, 0, 0], [0, 111.2, 5], [71.7, 0, 10]], rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(track.at(np.array([-5.0, 15.0, 99.0]))[:, 2], [0.0, 7.5, 10.0])


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({}, ConfigurationError, "track needs a file or points, and not both"),
        ({"points": [[0.0, 1.0]]}, ConfigurationError, r"track.points must be rows \[t, x, y, z\]"),
        ({"file": "log.csv", "height": "z"}, ReadingsError, "expected the option origin, or origin=first"),
        ({"file": "log.csv", "height": "up", "origin": "first"}, ReadingsError, "no column 'up'"),
        ({"file": "log.csv", "origin": "here"}, ConfigurationError, "origin must be .* or first, got here"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, monkeypatch, options, error, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("time,lat,lon,z\n1,50,8,3\n")
    with pytest.raises(error, match=said):
        read_track(TrackFile(**options), "model")
