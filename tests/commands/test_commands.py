"""The command ``dafw``: help and lists load no heavy library; every command exists, also as ``python -m dafw``."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from dafw.commands import COMMANDS, USAGE, main


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_in_the_usage_and_explains_itself(name, capsys):
    assert f"\n  {name} " in USAGE
    try:
        status = main([name, "--help"])
    except SystemExit as end:  # argparse exits
        status = end.code
    assert not status
    assert f"dafw {name}" in capsys.readouterr().out


def test_an_unknown_command_is_refused_with_those_that_there_are(capsys):
    assert main(["fly"]) == 2
    assert capsys.readouterr().err == f"dafw: unknown command 'fly' (commands: {', '.join(COMMANDS)})\n"


def test_the_package_is_the_command():
    done = subprocess.run([sys.executable, "-m", "dafw", "fly"], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("dafw: unknown command 'fly'")
    assert subprocess.run([sys.executable, "-m", "dafw"], capture_output=True, text=True).stdout == USAGE


def test_plugins_are_listed_with_their_options(capsys):
    assert main(["plugins"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in ("ad_ins", "drone", "enie2d", "etkf"))
    assert main(["plugins", "etkf"]) == 0
    assert "inflation: float = 1.0" in capsys.readouterr().out
    assert main(["plugins", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["problems"] == []
    etkf = next(plugin for plugin in found["plugins"] if plugin["name"] == "etkf")
    assert {"kind", "name", "package", "options"} <= set(etkf)


def test_the_list_for_machines_is_strict_json(capsys):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    assert main(["plugins", "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=refuse)
    options = {(p["kind"], p["name"], o["name"]): o for p in found["plugins"] for o in p["options"]}
    inflation = options["filter", "etkf", "inflation"]
    assert (inflation["default"], inflation["minimum"], inflation["required"]) == (1.0, 1.0, False)
    assert options["model", "ad_ins", "wind.tolerance"]["above"] == 0.0
    assert options["model", "ad_ins", "wind.tolerance"]["maximum"] == 0.01
    assert options["model", "ad_ins", "wind.solver"]["choices"] == ["newton", "accelerated", "reduced"]
    assert options["observer", "drone", "assumed_variance"]["default"] is None
    positions = options["observer", "stations", "positions"]
    assert positions["required"] and "default" not in positions


def test_ranges_are_shown(capsys):
    assert main(["plugins", "ad_ins"]) == 0
    shown = capsys.readouterr().out
    assert "wind.tolerance: float = 1e-08 (above 0, at most 0.01)" in shown
    assert "wind.solver: str = newton (one of newton, accelerated, reduced)" in shown
    assert 'wind.basis.digest: str = ""' in shown
    assert main(["plugins", "stations"]) == 0
    assert "positions: list[list[float]] must be given" in capsys.readouterr().out


def test_help_answers_without_loading_anything_heavy():
    code = "import sys, dafw.commands; dafw.commands.main(['--help']); dafw.commands.main(['plugins']); "
    code += "print(sorted({'dolfinx', 'gmsh', 'numba', 'matplotlib', 'xarray', 'scipy', 'shapely'} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "usage: dafw" in shown and shown.strip().endswith("[]")


@pytest.mark.parametrize(
    ("words", "foreign"),
    [(["--help"], {"numpy", "hydra", "pluggy"}), (["plugins"], {"hydra", "scipy", "xarray", "netCDF4"})],
)
def test_asking_for_a_list_imports_nothing_heavy(words, foreign):
    program = f"import sys; from dafw.commands import main; main({words}); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert (
        loaded & {*foreign, "dolfinx", "dolfinx_solver", "gmsh", "numba", "matplotlib", "shapely", "petsc4py"} == set()
    )
