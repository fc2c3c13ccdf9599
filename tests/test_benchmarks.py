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


@pytest.mark.parametrize(
    "names",
    [["esmda.difference_from_pyesmda"], ["netcdf.complaints", "netcdf.uxarray"], ["l96.etkf_over_dapper"]],
    ids=["pyESMDA", "checkers and uxarray", "DAPPER"],
)
def test_those_that_ask_other_programs(names, request):
    if not request.config.getoption("downloads"):
        pytest.skip("downloads programs into environments of their own: pytest --downloads")
    done = command(*names, "--short")
    assert done.returncode == 0, done.stderr
