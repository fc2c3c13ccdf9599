"""Every built-in plugin conforms; ``dafw check`` says so; asking for a list imports nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dafw.authoring.checks import factory_of
from dafw.commands import main
from dafw.core.registry import registry
from dafw.testing import run_checks

BUILT_IN = [registered.spec for registered in registry().plugins() if registered.spec.target.startswith("dafw.")]
DECLARED = {("ad", "steps_in_set"), ("ad_ins", "steps_in_set")}


@pytest.mark.parametrize("spec", BUILT_IN, ids=lambda spec: f"{spec.kind}-{spec.name}")
def test_a_built_in_plugin_conforms(spec):
    outcomes = list(run_checks(spec.kind, factory_of(spec)))
    assert [f"{outcome.check.name}: {outcome.detail}" for outcome in outcomes if not outcome.ok] == []
    declared = {(spec.name, outcome.check.name) for outcome in outcomes if outcome.status == "expected failure"}
    assert declared == {pair for pair in DECLARED if pair[0] == spec.name}


def test_the_command_prints_a_line_for_each_check(capsys):
    assert main(["check", "none", "stationary"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "2 plugins checked, nothing to mend"
    assert lines[0].split() == ["filter", "'none'", "shapes", "passed"]
    assert "filter 'none' kalman_exact not applicable declares its accuracy as 'none'" in [
        " ".join(line.split()) for line in lines
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nonesuch"], "there is no plugin 'nonesuch' (there are: "),
        ([], "expected either names of plugins or --all"),
        (["none", "--all"], "expected either names of plugins or --all"),
    ],
)
def test_a_wrong_request_is_one_line_and_status_2(words, message, capsys):
    assert main(["check", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "foreign"),
    [(["--help"], {"numpy", "hydra", "pluggy"}), (["plugins"], {"hydra", "scipy", "xarray", "netCDF4"})],
)
def test_asking_for_a_list_imports_nothing_heavy(words, foreign):
    program = f"import sys; from dafw.commands import main; main({words}); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert loaded & {*foreign, "dolfinx", "dolfinx_solver", "gmsh", "matplotlib", "shapely", "petsc4py"} == set()
