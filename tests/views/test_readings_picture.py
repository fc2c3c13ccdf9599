"""The picture of the readings of a file: a map and a curve for every part, in metres, less background."""

from __future__ import annotations

import numpy as np
import pytest

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.recorded import Recorded
from dafw.views.readings import parts_of, plot_readings

LOG = "time,lat,lon,value\n5,50.0,8.0,430\n1,50.0,8.0,421\n900,50.001,8.0,460\n910,50.001,8.001,440\n"


def test_a_pause_begins_another_part():
    assert [part.tolist() for part in parts_of(np.array([0.0, 60.0, 200.0, 210.0, 900.0]))] == [[0, 1], [2, 3], [4]]
    assert len(parts_of(1000.0 * np.arange(9))) == 4
    assert parts_of(1000.0 * np.arange(9))[-1].tolist() == [3, 4, 5, 6, 7, 8]


def test_values_are_less_background_at_places_about_the_first_reading(tmp_path):
    (tmp_path / "log.csv").write_text(LOG)
    source = Recorded.from_options(file=str(tmp_path / "log.csv"), sd=1.0, background=420.0)
    figure = plot_readings(source)
    first, second, curve, other, bar = figure.axes
    (dots,) = second.collections
    np.testing.assert_allclose(dots.get_offsets(), [[71.7, 111.2], [0.0, 111.2]], rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(dots.get_array(), [20.0, 40.0])  # the highest is drawn last
    np.testing.assert_allclose(curve.get_lines()[0].get_ydata(), [1.0, 10.0])
    np.testing.assert_allclose(other.get_lines()[0].get_xdata(), [900.0, 910.0])
    assert "less 420" in bar.get_ylabel() and first.get_xlim() == second.get_xlim()


def test_readings_in_metres_are_drawn_where_they_are(tmp_path):
    (tmp_path / "walk.csv").write_text("time,x,y,value\n1,3,4,9\n2,5,6,7\n")
    figure = plot_readings(Recorded.from_options(file=str(tmp_path / "walk.csv"), sd=1.0))
    np.testing.assert_allclose(figure.axes[0].collections[0].get_offsets(), [[5.0, 6.0], [3.0, 4.0]])


@pytest.mark.parametrize("text", ["time,entry,value\n1,0,9\n", "time,value\n1,9\n"])
def test_readings_without_places_have_no_map(tmp_path, text):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(ReadingsError, match="a map needs columns x and y, or lon and lat"):
        plot_readings(Recorded.from_options(file=str(tmp_path / "log.csv"), sd=1.0))


def test_no_readings_are_no_picture(tmp_path):
    (tmp_path / "log.csv").write_text("time,x,y,value\n1,3,4,\n")
    with pytest.raises(ReadingsError, match="there are no readings to draw"):
        plot_readings(Recorded.from_options(file=str(tmp_path / "log.csv"), sd=1.0))
