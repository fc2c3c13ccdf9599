"""A wind table in words: directions, units in cells, a clock that begins again."""

from __future__ import annotations

import numpy as np
import pytest

from dafw.core.errors import ConfigurationError, ReadingsError
from dafw.plugins.models.wind_record import WindFile, read_wind

TABLE = """\ufeffFlight time,Altitude,Wind Direction,Wind Speed
00m 20s,6.6 m,180°,\u00a0\u00a02.00 m/s
00m 25s,9.9 m,270°,  7.2 km/h
01m 05s,9.9 m,225°,2.0 m/s
00m 10s,9.8 m,0°,3.00 m/s
00m 15s,9.9 m,90°,3.00 m/s
00m 05s,9.9 m,90°,9.00 m/s
"""
STARTS = ["2022-12-12T10:00:10Z", "2022-12-12T11:00:00Z", None]


def options(tmp_path, text=TABLE, **changed):
    (tmp_path / "wind.csv").write_text(text, encoding="utf-8")
    words = {
        "speed": "Wind Speed",
        "direction": "Wind Direction",
        "upward": 0.5,
        "starts": STARTS,
        "start": "2022-12-12T10:00:00Z",
        "units_in_cells": True,
        "time_format": "%Mm %Ss",
    }
    made = WindFile(file=str(tmp_path / "wind.csv"), **{**words, **changed})
    made.columns.time = "Flight time"
    return made


def test_a_direction_is_that_from_which_the_wind_blows(tmp_path):
    record = read_wind(options(tmp_path))
    half = np.sqrt(2.0)
    expected = [[0.0, 2.0], [2.0, 0.0], [half, half], [0.0, -3.0], [-3.0, 0.0]]
    np.testing.assert_allclose(record.wind[1:-1, :2], expected, atol=1e-12)


def test_a_direction_may_be_that_to_which_the_wind_blows(tmp_path):
    there, back = (read_wind(options(tmp_path, blows=way)).wind for way in ("to", "from"))
    np.testing.assert_allclose(there[:, :2], -back[:, :2])


def test_every_flight_has_its_own_start_and_one_may_be_left_out(tmp_path):
    record = read_wind(options(tmp_path))
    np.testing.assert_allclose(record.time[1:-1], [30.0, 35.0, 75.0, 3610.0, 3615.0])


def test_upward_fluctuations_are_a_share_of_sideways_ones(tmp_path):
    turbulence = read_wind(options(tmp_path)).turbulence
    np.testing.assert_allclose(turbulence[:, 1], 0.5 * turbulence[:, 0])
    assert turbulence[3, 0] > 0.1


@pytest.mark.parametrize(
    ("changed", "error", "said"),
    [
        (
            {"starts": STARTS[:2]},
            ReadingsError,
            "its clock begins 3 times: expected as many .*, got 2",
        ),
        ({"starts": ["soon", None, None]}, ConfigurationError, "wind.starts must be a date in ISO 8601, got 'soon'"),
        ({"start": "first"}, ConfigurationError, "wind.start must be a date in ISO 8601, got 'first'"),
        ({"direction": None}, ConfigurationError, "wind.speed and wind.direction belong together"),
        ({"upward": None}, ReadingsError, "no column 'wind_z'"),
        ({"units_in_cells": False}, ReadingsError, "expected a number, got"),
        ({"text": TABLE.replace("3.00 m/s", "3.00 Pa")}, ReadingsError, "'Pa' cannot be converted into 'm/s'"),
        ({"text": TABLE.replace("2.0 m/s", "-2.0 m/s")}, ReadingsError, "line 4.*a speed of at least 0, got -2 m/s"),
        ({"text": TABLE.replace("270°", "north")}, ReadingsError, "line 3.*expected a number, got 'north'"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, changed, error, said):
    with pytest.raises(error, match=said):
        read_wind(options(tmp_path, **changed))


def test_a_clock_without_starts_is_no_table_of_dates(tmp_path):
    text = "Flight time,Wind Direction,Wind Speed\n2022-12-12T10:00:00Z,0°,1 m/s\n2022-12-12T10:00:09Z,0°,1 m/s\n"
    with pytest.raises(ReadingsError, match="its times are dates already"):
        read_wind(options(tmp_path, text, time_format=None, starts=STARTS[:1]))
