"""Making a run again: identical, or the first difference by name; and the table of what failed."""

import json
import shutil

import netCDF4
import numpy as np
import pytest
import xarray

from dafw.commands import main
from dafw.core.composition import compose, study_part
from dafw.core.experiment import study_from
from dafw.studies.failures import counted, failure_table
from dafw.studies.from_python import keep_configuration
from dafw.studies.replaying import difference_of
from dafw.studies.running import run_study

WORDS = [
    *("experiment=linear_advection", "members=5", "cycles=5", "pictures=false", "filter=enks", "filter.window=2"),
    *("forecast.every=2", "forecast.horizon=1", "forecast.lead_times=[0,1]"),
]


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    folder = tmp_path_factory.mktemp("complete") / "run"
    composed = study_part(compose(WORDS))
    keep_configuration(folder / ".hydra", composed, WORDS)
    run_study(study_from(composed), folder)
    return folder


@pytest.fixture
def run(complete, tmp_path):
    return shutil.copytree(complete, tmp_path / "run")


def said(words, capsys):
    status = main(words)
    captured = capsys.readouterr()
    return status, captured.out.splitlines(), captured.err.splitlines()


def test_a_run_is_made_again_and_other_versions_are_said_first(run, capsys):
    known = json.loads((run / "summary.json").read_text())
    known["versions"]["numpy"] = "1.0"
    (run / "summary.json").write_text(json.dumps(known))
    status, out, _ = said(["replay", str(run)], capsys)
    assert status == 0 and out == [f"another version: numpy was 1.0 and is {np.__version__}", "identical"]
    assert sorted(path.name for path in run.parent.iterdir()) == ["run"]


def test_a_changed_file_of_readings_is_said_first(tmp_path, capsys):
    file, run = tmp_path / "readings.csv", tmp_path / "run"
    file.write_text("time,value,sensor\n1,1.0,a\n3,2.0,b\n")
    words = [
        "experiment=linear_advection",
        "filter=etkf",
        "truth=null",
        "free=null",
        "readings=recorded",
        f"readings.file={file}",
    ]
    words += ["readings.entries={a: 3, b: 9}", "readings.sd=0.5", "members=5", "cycles=4", "pictures=false"]
    assert said(["run", *words, f"hydra.run.dir={run}"], capsys)[0] == 0
    assert said(["replay", str(run)], capsys)[:2] == (0, ["identical"])
    file.write_text("time,value,sensor\n1,1.0,a\n3,2.5,b\n")
    status, out, _ = said(["replay", str(run)], capsys)
    assert status == 1 and out[0] == f"another file: {file} has changed"
    assert out[1].startswith("different: u_mean, at time 3 s")


def changed(run, name, place, file="run.nc"):
    """Change the last bit of a number in a file."""
    with netCDF4.Dataset(run / file, "r+") as opened:
        variable = opened[name]
        variable.set_auto_maskandscale(False)
        variable[place] = np.nextafter(variable[place], np.array(np.inf, dtype=variable.dtype))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("u_mean", (3, 7), "run.nc")], "different: u_mean, at time 3 s, node 7 (7 m): was "),
        ([("u_truth", (4, 0), "run.nc"), ("err", (2,), "run.nc")], "different: err, at time 2 s: was "),
        ([("err", (2,), "run.nc"), ("u_mean", (2, 1), "run.nc")], "different: u_mean, at time 2 s, node 1"),
        ([("u_smoothed_mean", (1, 0), "run.nc"), ("err", (4,), "run.nc")], "different: err, at time 4 s"),
        ([("observation_value", (2, 3), "run.nc")], "observation_value, at time 2 s, observation 3: was "),
        ([("node_x", (0,), "run.nc"), ("err", (0,), "run.nc")], "different: node_x, node 0"),
        ([("u_exceeded", (1, 0, 2, 5), "forecast.nc")], "forecast.nc: u_exceeded, at issue 4 s, lead 0"),
    ],
)
def test_the_first_difference_is_named(run, changes, message, capsys):
    for name, place, file in changes:
        changed(run, name, place, file)
    status, out, _ = said(["replay", str(run)], capsys)
    assert status == 1 and message in out[-1], out
    assert ("; 1 more variable differs" in out[-1]) is (len(changes) > 1)


def test_what_cannot_be_made_again_is_a_wrong_request(run, tmp_path, capsys):
    assert said(["replay", str(tmp_path)], capsys)[::2] == (
        2,
        [f"dafw: {tmp_path}: holds no run (expected the folder of a run, with its run.nc)"],
    )
    known = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**known, "pinned": {"truth": {"speed": 0.5}, "other": {"a": 1}}}))
    assert "pinned options of its other" in said(["replay", str(run)], capsys)[2][0]
    (run / "summary.json").write_text(json.dumps({**known, "pinned": {"model": {"sped": 2.0}}}))
    assert "sped" in said(["replay", str(run)], capsys)[2][0]
    (run / "summary.json").write_text(json.dumps({**known, "status": "failed"}))
    assert "the run is not complete (failed): dafw resume goes on" in said(["replay", str(run)], capsys)[2][0]
    (run / "summary.json").write_text(json.dumps(known))
    (run / ".hydra" / "config.yaml").unlink()
    assert "was made of Python objects" in said(["replay", str(run)], capsys)[2][0]
    assert said(["replay"], capsys)[0] == 2


def test_pinned_options_are_used(run, capsys):
    known = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**known, "pinned": {"truth": {"speed": 0.5}}}))
    status, out, _ = said(["replay", str(run)], capsys)
    assert status == 1 and "different: u_truth, at time 1 s" in out[-1]


def test_files_of_another_form_differ():
    one = xarray.Dataset({"a": ("time", [1.0, 2.0]), "time": [0.0, 1.0]}, attrs={"seed": 1, "versions": "x"})
    assert difference_of(one, one.assign_attrs(versions="y"), "time") == ""
    assert difference_of(one, one.assign_attrs(seed=2), "time") == "attribute seed: was 1, is 2"
    assert difference_of(one, one.drop_vars("a"), "time") == "variable a: only the run that was made has it"
    assert difference_of(one.drop_vars("a"), one, "time") == "variable a: only the run made now has it"
    other = one.assign(a=one["a"].assign_attrs(units="m"))
    assert difference_of(one, other, "time") == "a: its attribute units was None, is m"
    assert "a: was float64 {'time': 2}, is float32" in difference_of(one, one.assign(a=one["a"].astype("f4")), "time")
    negative = one.assign(a=("time", [1.0, -0.0])), one.assign(a=("time", [1.0, 0.0]))
    assert difference_of(*negative, "time") == "a, at time 1 s: was -0.0, is 0.0"
    missing = one.assign(a=("time", [np.nan, 2.0]))
    assert difference_of(missing, missing, "time") == ""


def test_a_table_says_what_failed_where_and_why(tmp_path):
    for name, summary in {
        "good": {"status": "complete"},
        "bad": {
            **{"status": "failed", "cycles": 3, "cycles_wanted": 9, "failed_at": {"time": 1.5, "phase": "forecast"}},
            "error": "at t = 1.5 s, phase 'forecast': model 'x' broke; 3 of 9 cycles are kept",
        },
        "killed": {"status": "interrupted", "cycles": 1, "cycles_wanted": 9},
        "wordy": {"status": "failed", "error": "e" * 500},
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(json.dumps(summary))
    runs = [(name, tmp_path / name) for name in ("good", "bad", "killed", "wordy")] + [("new", None)]
    lines = failure_table(runs).splitlines()
    assert lines[0].split() == ["run", "status", "cycles", "time", "phase", "why"]
    assert [line.split()[0] for line in lines[1:]] == ["bad", "killed", "wordy", "new"]
    assert lines[1].split(maxsplit=7) == [*["bad", "failed", "3", "of", "9", "1.5", "s"], "forecast  model 'x' broke"]
    assert lines[3].endswith("e...") and len(lines[3]) < 200
    assert failure_table(runs[:1]) == ""
    assert counted([place for _, place in runs]) == "5 runs: 1 complete, 2 failed, 1 interrupted, 1 missing"
