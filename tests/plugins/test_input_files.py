"""A built-in plugin that has an option for a file of data names that file: a resumed run needs the same one."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_type_hints

import pytest

from dafw.core.plugin import Plugin
from dafw.core.registry import KINDS, registry
from dafw.plugins.models.puffs.model_track import PuffsTrack
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.recorded import Recorded


def groups_with_files(group):
    """Yield the option groups of a dataclass, itself included, that say where a file of data is."""
    if issubclass(group, FileOptions):
        yield group
    hints = get_type_hints(group)
    for one in fields(group):
        if one.init and isinstance(hints[one.name], type) and is_dataclass(hints[one.name]):
            yield from groups_with_files(hints[one.name])


CLASSES = {f"{kind} {name}": registry().plugin_class(kind, name) for kind in KINDS for name in registry().names(kind)}
READING = [name for name, made in CLASSES.items() if is_dataclass(made) and list(groups_with_files(made))]


@pytest.mark.parametrize("name", READING)
def test_a_plugin_that_reads_a_file_says_which(name):
    assert CLASSES[name].input_files is not Plugin.input_files


def test_there_are_such_plugins():
    assert {"model ad", "model ad_ins", "model puffs", "model puffs_track", "readings recorded"} <= set(READING)


def test_all_files_are_named(tmp_path):
    for name in ("track.csv", "wind.csv", "beam1.csv", "beam2.csv"):
        (tmp_path / name).write_text("time,value\n0,1\n")
    options = {"track": {"file": str(tmp_path / "track.csv")}, "wind": {"file": str(tmp_path / "wind.csv")}}
    model = PuffsTrack.from_options(**PuffsTrack.check_options() | options)
    assert set(model.input_files) == {tmp_path / "track.csv", tmp_path / "wind.csv"}
    assert PuffsTrack.from_options(**PuffsTrack.check_options()).input_files == [], "points and a steady wind"
    readings = Recorded.from_options(file=str(tmp_path / "beam*.csv"), sd=1.0)
    assert list(readings.input_files) == [tmp_path / "beam1.csv", tmp_path / "beam2.csv"]
    shipped = Recorded.from_options(file="example")
    assert list(shipped.input_files) == [], "the file that ships with dafw is as old as dafw"
    assert all(isinstance(path, Path) for path in model.input_files)
