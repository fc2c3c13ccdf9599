"""Animations: their frames show the rows of the run, and what cannot be written is refused."""

import re
import subprocess
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

import dafw
from dafw.commands import main
from dafw.core.errors import ConfigurationError, RunError
from dafw.views.animation import animate, animated_figure


def frames(file):
    """Return all pictures (frames, height, width, 3) of a GIF, and how long one is shown, in ms."""
    with Image.open(file) as picture:
        found = []
        for number in range(picture.n_frames):
            picture.seek(number)
            found.append(np.asarray(picture.convert("RGB")))
        return np.stack(found), picture.info["duration"]


@pytest.fixture
def short_run(plant_run):
    return plant_run.isel(time=slice(0, 6))


def test_every_second_row_and_the_last_one_are_frames(short_run, tmp_path):
    found, shown = frames(animate(short_run, tmp_path / "new" / "a.gif", every=2, rate=20))
    assert len(found) == 4 and shown == 50  # rows 0, 2, 4, 5
    changes = [np.abs(a.astype(int) - b).max() for a, b in pairwise(found)]
    assert min(changes) > 30
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["a.gif"]


def test_a_row_shows_its_field_its_time_and_the_route_so_far(short_run):
    figure, draw = animated_figure(short_run)
    draw(3)
    truth, belief, free = figure.axes[:3]
    for axes, name in ((truth, "truth"), (belief, "mean"), (free, "free")):
        field = next(part for part in axes.collections if part.get_array() is not None)
        np.testing.assert_array_equal(field.get_array(), short_run[f"concentration_{name}"].values[3])
    assert figure.get_suptitle() == f"t = {float(short_run['time'][3]):g} s"
    assert belief.get_title() == f"Belief, ERR {float(short_run['err'][3]):.1f} %"
    routes = [line for line in truth.lines if len(line.get_xdata()) == 4]
    np.testing.assert_array_equal(routes[0].get_xdata(), short_run["vehicle_x"].values[:4, 0])
    # Between the first and any other row nothing else may move.
    places = [axes.get_position().bounds for axes in figure.axes]
    draw(5)
    assert [axes.get_position().bounds for axes in figure.axes] == places


def test_only_what_the_run_has_is_shown(lone_run, untold_run):
    for run, titles in ((lone_run, ["Truth", "Belief"]), (untold_run, ["Belief"])):
        figure, _ = animated_figure(run.isel(time=slice(0, 2)))
        assert [axes.get_title().partition(",")[0] for axes in figure.axes[:-1]] == titles


def test_rows_without_a_field_are_no_frames(short_run, tmp_path):
    run = short_run.copy(deep=True)
    for name in ("truth", "mean", "free"):
        run[f"concentration_{name}"].values[1:5] = np.nan
    assert len(frames(animate(run, tmp_path / "a.gif"))[0]) == 2


def test_an_mp4_can_be_decoded_and_lasts_as_long_as_its_frames(short_run, tmp_path):
    import imageio_ffmpeg as reader

    file = animate(short_run, tmp_path / "a.mp4", every=2, rate=4)
    words = [reader.get_ffmpeg_exe(), "-i", str(file), "-f", "image2pipe", "-vcodec", "ppm", "-"]
    done = subprocess.run(words, capture_output=True, check=True)
    (size,) = set(re.findall(rb"P6\n(\d+ \d+)\n255\n", done.stdout))  # what stands before each picture
    width, height = map(int, size.split())
    pictures = np.frombuffer(done.stdout, dtype=np.uint8).reshape(-1, len(size) + 8 + width * height * 3)[
        :, len(size) + 8 :
    ]
    pictures = pictures.reshape(-1, height, width, 3)
    duration = re.search(rb"Duration: 00:00:(\d+\.\d+)", done.stderr)[1]
    count = len(range(0, short_run.sizes["time"] - 1, 2)) + 1
    assert len(pictures) == count and float(duration) == pytest.approx(count / 4, abs=0.01)
    # The first frame is that of the GIF, but for what the format loses and a line that makes its sizes even.
    expected = frames(animate(short_run, tmp_path / "a.gif", every=2, rate=4))[0][0]
    assert expected.shape[0] <= height <= expected.shape[0] + 1 and expected.shape[1] <= width <= expected.shape[1] + 1
    off = np.abs(pictures[0][: expected.shape[0], : expected.shape[1]].astype(float) - expected[..., :3])
    assert off.mean() < 6.0 and np.abs(pictures[0].astype(float) - pictures[-1]).mean() > 0.5


def test_what_cannot_be_written_is_refused_and_leaves_nothing(short_run, ring_run, tmp_path, monkeypatch):
    with pytest.raises(ConfigurationError, match=r"ends with \.gif or \.mp4, got a\.avi"):
        animate(short_run, tmp_path / "a.avi")
    with pytest.raises(ConfigurationError, match="every >= 1"):
        animate(short_run, tmp_path / "a.gif", every=0)
    with pytest.raises(RunError, match="needs a field on a mesh"):
        animate(ring_run, tmp_path / "a.gif")
    monkeypatch.setattr("dafw.views.animation.FFMpegWriter.isAvailable", lambda: False)
    with pytest.raises(ConfigurationError, match=r"an MP4 needs ffmpeg; it comes with: pip install 'dafw\[video\]'"):
        animate(short_run, tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_into_the_folder_of_the_run(plant_folder, capsys):
    assert main(["animate", str(plant_folder), "--every", "100"]) == 0
    assert capsys.readouterr().out.strip() == str(plant_folder / "animation.gif")
    with dafw.open_run(plant_folder) as run:
        assert len(frames(plant_folder / "animation.gif")[0]) == len({*range(0, run.sizes["time"], 100)} | {-1})
    assert main(["animate", "a", "b", "-o", "c.gif"]) == 2
    assert "--out is for one run" in capsys.readouterr().err
    assert main(["animate", "nowhere"]) == 2
    assert "holds no run" in capsys.readouterr().err
