"""The benchmarks of wind and transport run; a coarse mesh gets the published drag as well as it can."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import dafw
from benchmarks import record_winds

ROOT = Path(__file__).parent.parent
NAMES = [
    "wind.accelerated_over_newton",
    "wind.reduced_over_newton",
    "wind.reduced_error_median",
    "wind.reduced_error_p95",
    "ad.step_over_scratch",
    "ad.two_precisions",
    "ad.fct_over_galerkin",
    "transport.rotation",
    "wind.cylinder_drag_error",
    "wind.proportional_share_reduced",
    "wind.proportional_share_accelerated",
    "wind.proportional_directions",
]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    file = tmp_path_factory.mktemp("benchmarks") / "results.json"
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", *NAMES, "--short", "--json", str(file)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return {result["name"]: result for result in json.loads(file.read_text())}


def test_all_of_them_run(results):
    assert list(results) == NAMES
    assert all(result["value"] > 0.0 for name, result in results.items() if name != "wind.proportional_directions")


def test_a_step_is_the_same_as_from_scratch(results):
    assert results["ad.step_over_scratch"]["detail"]["largest_difference"] < 1e-8


def test_rotating_bodies_stay_in_range_with_flux_correction(results):
    found = results["transport.rotation"]["detail"]
    assert found["fct"]["lowest"] == 0.0 and found["fct"]["highest"] <= 1.0 < found["galerkin"]["highest"]
    assert found["fct"]["L1, backward Euler"] < 0.5 * found["low order"]["L1, backward Euler"]


def test_drag_lift_and_pressure_difference_of_a_cylinder(results):
    ((_, drag, lift, pressure),) = results["wind.cylinder_drag_error"]["detail"]["unknowns_drag_lift_pressure"]
    assert drag == pytest.approx(5.57953523384, rel=0.012)
    assert lift == pytest.approx(0.010618948146, abs=0.006)  # 0.1 % of the drag
    assert pressure == pytest.approx(0.11752016697, rel=0.012)


def test_the_winds_of_a_run_are_written_down_in_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small = [
        "experiment=enie2d_literal",
        "model.mesh.wall_size=60",
        "model.mesh.far_size=90",
        "model.wind_speed_sd=0.2",
        "members=3",
        "cycles=2",
    ]
    with dafw.run([*small, "pictures=false", "model.speed_threshold=0"]) as run:
        solved = run["model_wind_solved"].values == 1
        speeds = run["model_wind_speed"].values[solved]
        assert record_winds.write(Path(run.attrs["folder"]), sys.stdout) == solved.sum() == 6
    lines = [line.split(",") for line in capsys.readouterr().out.splitlines() if line.count(",") == 2]
    assert lines[0] == ["intensity", "direction", "start"]
    assert [float(speed) for speed, _, _ in lines[1:]] == speeds.tolist()
    assert [line[2] for line in lines[1:5]] == ["", "", "", "0"]
