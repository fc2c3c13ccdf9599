"""A measured wind: how far it carries, its turbulence, spikes, gaps, and the columns of files."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import ConfigurationError
from dafw.plugins.models.wind_record import (
    WindColumns,
    WindFile,
    are_spikes,
    of_samples,
    read_wind,
    read_wind_along_the_ground,
)

TIME = np.arange(0.0, 1200.0, 2.0)


def test_a_wind_that_grows_evenly_carries_as_it_should():
    wind = np.stack([0.01 * TIME, np.full(TIME.size, -1.0), np.zeros(TIME.size)], axis=1)
    record = of_samples(TIME, wind)
    t = np.array([[0.0, 100.0], [700.0, 1000.0]])
    moved = record.carried_by(t) - record.carried_by(np.array(0.0))
    np.testing.assert_allclose(moved[..., 0], 0.005 * t**2, atol=1e-9)
    np.testing.assert_allclose(moved[..., 1], -t, atol=1e-9)


def test_a_gap_is_bridged_and_the_order_of_samples_does_not_matter():
    wind = np.stack([0.01 * TIME, np.zeros(TIME.size), np.zeros(TIME.size)], axis=1)
    kept = (TIME < 300.0) | (TIME > 400.0)
    order = np.random.default_rng(0).permutation(np.flatnonzero(kept))
    record = of_samples(TIME[order], wind[order])
    moved = record.carried_by(np.array(500.0)) - record.carried_by(np.array(0.0))
    assert moved[0] == pytest.approx(0.005 * 500.0**2)


def test_outside_of_the_record_the_wind_is_that_of_the_first_and_of_the_last_minute():
    wind = np.where(TIME[:, np.newaxis] < 600.0, [2.0, 1.0, 0.0], [0.0, -1.0, 0.0])
    record = of_samples(TIME, wind)
    np.testing.assert_allclose(record.carried_by(np.array(0.0)) - record.carried_by(np.array(-100.0)), [200.0, 100.0])
    after = record.carried_by(np.array(TIME[-1] + 50.0)) - record.carried_by(np.array(TIME[-1]))
    np.testing.assert_allclose(after, [0.0, -50.0], atol=1e-9)


def test_samples_of_the_same_time_are_averaged():
    record = of_samples(np.array([0.0, 0.0, 10.0]), np.array([[1.0, 0, 0], [3.0, 0, 0], [2.0, 0, 0]]))
    assert record.carried_by(np.array(10.0))[0] - record.carried_by(np.array(0.0))[0] == pytest.approx(20.0)


def test_turbulence_is_the_standard_deviation_of_ten_minutes():
    rng = np.random.default_rng(1)
    wind = rng.normal([3.0, 1.0, 0.0], [0.5, 0.5, 0.2], (TIME.size, 3))
    wind[TIME >= 600.0, 2] *= 3.0
    record = of_samples(TIME, wind)
    late = wind[(TIME >= 1199.0 - 600.0) & (TIME <= 1199.0)]
    sides = np.sqrt(0.5 * (late[:, 0].var() + late[:, 1].var()))
    np.testing.assert_allclose(record.turbulence_at(np.array(1199.0)), [sides, late[:, 2].std()], rtol=0.02)
    early = wind[TIME <= 60.0, 2].std()
    assert record.turbulence_at(np.array(5.0))[1] == pytest.approx(early, rel=1e-6)


def test_spikes_are_left_out_and_counted():
    wind = np.random.default_rng(2).normal(0.0, 0.3, (TIME.size, 3))
    wind[[50, 300]] = [40.0, 0.0, -30.0]
    assert np.flatnonzero(are_spikes(wind)).tolist() == [50, 300]
    assert of_samples(TIME, wind).spikes == 2


def test_one_time_is_not_enough():
    with pytest.raises(ConfigurationError, match="samples at two times or more, got 1"):
        of_samples(np.zeros(3), np.ones((3, 3)))


def test_a_steady_wind_needs_no_file():
    record = read_wind(WindFile(steady=[2.0, -1.0, 0.8, 0.3]))
    np.testing.assert_allclose(record.carried_by(np.array(7.0)) - record.carried_by(np.array(-3.0)), [20.0, -10.0])
    np.testing.assert_array_equal(record.turbulence_at(np.array([0.0, 9.0])), [[0.8, 0.3]] * 2)


@pytest.mark.parametrize("options", [{}, {"file": "a.csv", "steady": [1.0, 1.0, 1.0, 1.0]}, {"steady": [1.0, 2.0]}])
def test_one_wind_must_be_given(options):
    with pytest.raises(ConfigurationError, match=r"^wind"):
        read_wind(WindFile(**options))


def test_columns_are_turned_as_the_options_say(tmp_path):
    lines = [f"{t} {2.0 + t} {5.0} 0.5" for t in range(4)]
    (tmp_path / "wind1.csv").write_text("\n".join(["t east north up", *lines]))
    options = WindFile(file=str(tmp_path / "wind*.csv"), x="-north", y="east", z="up", delimiter="space")
    options.columns.time = "t"
    record = read_wind(options)
    np.testing.assert_allclose(record.wind[1:-1], [[-5.0, 2.0 + t, 0.5] for t in range(4)])


def test_components_are_converted_to_metres_a_second(tmp_path):
    (tmp_path / "wind.csv").write_text("time,wind_x (km/h),wind_y (m/s)\n0,36,1\n10,36,1\n", encoding="utf-8")
    record = read_wind_along_the_ground(WindColumns(file=str(tmp_path / "wind.csv")), "wind")
    np.testing.assert_allclose(record.wind[:, :2], [[10.0, 1.0]] * 4)


def test_the_first_wind_is_the_start_though_rows_before_it_have_none(tmp_path):
    text = "time,wind_x,wind_y\n,1,1\n5,nan,1\n8,2,1\n9,2,1\n"
    (tmp_path / "wind.csv").write_text(text, encoding="utf-8")
    record = read_wind_along_the_ground(WindColumns(file=str(tmp_path / "wind.csv"), start="first"), "wind")
    np.testing.assert_allclose(record.time[1:-1], [0.0, 1.0])


def test_a_minus_before_a_speed_is_refused(tmp_path):
    (tmp_path / "wind.csv").write_text("time,speed,from\n0,2,90\n9,2,90\n", encoding="utf-8")
    wind = WindColumns(file=str(tmp_path / "wind.csv"), speed="-speed", direction="from")
    with pytest.raises(ConfigurationError, match=r"wind.speed: a minus stands before a component only, got '-speed'"):
        read_wind_along_the_ground(wind, "wind")
