"""The benchmarks run: their command, its table, its JSON. Nothing here depends on the machine's speed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def command(*words):
    return subprocess.run(
        [sys.executable, "-m", "benchmarks", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_command_prints_a_table_and_writes_json(tmp_path):
    done = command("l96.enkf_rmse", "l96.etkf_rmse", "--short", "--json", str(tmp_path / "results.json"))
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    assert [result["name"] for result in results] == ["l96.enkf_rmse", "l96.etkf_rmse"]
    for result, baseline in zip(results, (0.22, 0.18), strict=True):
        assert result["name"] in done.stdout
        assert result["baseline"] == baseline
        assert {"unit", "machine"} <= result.keys()
        assert len(result["detail"]["scores"]) == 2
        assert 0.0 < result["value"] < 1.0  # below the error of the readings


def test_they_are_listed_with_what_they_measure():
    done = command("l96.enkf_rmse", "--list")
    assert done.returncode == 0, done.stderr
    (line,) = done.stdout.splitlines()
    assert line.split()[0] == "l96.enkf_rmse" and "median over ten seeds" in line


def test_an_unknown_name_is_a_wrong_request():
    done = command("l96.nothing")
    assert done.returncode == 2
    assert "there is no benchmark 'l96.nothing' (there are: " in done.stderr


@pytest.mark.skip(
    reason="downloads pyESMDA into an environment of its own; run: python -m benchmarks esmda.difference_from_pyesmda"
)
def test_esmda_is_compared_with_pyesmda():
    assert command("esmda.difference_from_pyesmda", "--short").returncode == 0


@pytest.mark.skip(
    reason="downloads two checkers and uxarray into environments of their own; "
    "run: python -m benchmarks netcdf.complaints netcdf.uxarray"
)
def test_others_read_the_files_of_runs():
    assert command("netcdf.complaints", "netcdf.uxarray", "--short").returncode == 0


@pytest.mark.skip(
    reason="downloads DAPPER into an environment of its own; run: python -m benchmarks l96.etkf_over_dapper"
)
def test_dapper_is_timed_on_the_same_setting():
    assert command("l96.etkf_over_dapper", "--short").returncode == 0
