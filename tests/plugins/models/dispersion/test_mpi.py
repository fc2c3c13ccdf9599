"""Two ranks of mpiexec on one domain have the results of one process, and so does a whole run."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import ufl
import yaml
from divided_mesh import results
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import KDTree
from waiting import PATIENCE, go_on, halted

from dafw.commands import main
from dafw.core.errors import ConfigurationError
from dafw.core.experiment import study_from
from dafw.core.options import build
from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood
from dafw.plugins.models.dispersion.mesh import generate as module
from dafw.plugins.models.dispersion.mesh.generate import generate
from dafw.plugins.models.dispersion.mesh.load import load
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver

HERE = Path(__file__).parent
AGREED = 1e-9
VELOCITIES = [f"velocity {boundary} {name}" for boundary in ("uniform", "outflow") for name in ("first", "second")]
CLOUDS = [
    f"{s} {b} {w}" for s in ("galerkin", "supg") for b in ("uniform", "outflow") for w in ("flow", "uniform", "strong")
]


def mpiexec(*words, cwd):
    """Run two Python processes by the mpiexec beside this interpreter."""
    command = [str(Path(sys.executable).parent / "mpiexec"), "-n", "2", sys.executable, *map(str, words)]
    return subprocess.run(command, cwd=cwd, env=os.environ, capture_output=True, text=True, timeout=PATIENCE)


@pytest.fixture(scope="module")
def options(small_model):
    """Some 700 nodes around one tank."""
    return small_model | {"mesh": {"wall_size": 5.0, "far_size": 8.0, "transition": 20.0}}


@pytest.fixture(scope="module")
def mesh_file(options):
    model = build(AdvectionDiffusionINS, options, "model")
    return generate(model.ground, model.mesh)


@pytest.fixture(scope="module")
def alone(options):
    """The results of one process."""
    return results(MPI.COMM_SELF, options)


@pytest.fixture(scope="module")
def divided(options, mesh_file, tmp_path_factory):
    """The results of two ranks."""
    folder = tmp_path_factory.mktemp("divided")
    ended = mpiexec(HERE / "divided_mesh.py", folder / "found.npz", json.dumps(options), cwd=folder)
    assert ended.returncode == 0, ended.stderr
    with np.load(folder / "found.npz") as found:
        return dict(found)


def matched(alone, divided):
    """Return the values of both at the same places."""
    distances, places = KDTree(divided[:, :2]).query(alone[:, :2])
    assert distances.max() < 1e-9 and len(np.unique(places)) == len(divided)
    return alone[:, 2:], divided[places, 2:]


def test_the_nodes_are_divided_among_the_ranks_which_hold_the_same_bits(alone, divided):
    assert 500 < alone["nodes"].sum() == divided["nodes"].sum() and len(divided["nodes"]) == 2
    assert divided["nodes"].min() > 0.3 * divided["nodes"].sum()
    assert divided["same on all ranks"].tolist() == [True, True]


@pytest.mark.parametrize("name", VELOCITIES)
def test_two_ranks_find_the_wind_of_one(mesh_file, alone, divided, name):
    one, two = matched(alone[name], divided[name])
    space = TaylorHood(load(mesh_file).mesh).velocity_space

    def norm(values):
        function = fem.Function(space)
        function.x.array[:] = values.ravel()
        return np.sqrt(fem.assemble_scalar(fem.form(ufl.inner(function, function) * ufl.dx)))

    assert norm(two - one) < AGREED * norm(one)
    assert np.abs(two - one).max() < AGREED * np.abs(one).max()


@pytest.mark.parametrize("name", [name.replace("velocity", "pressure") for name in VELOCITIES])
def test_the_pressure_is_fixed_at_the_same_node(alone, divided, name):
    one, two = matched(alone[name], divided[name])
    assert np.abs(two - one).max() < AGREED * np.abs(one).max()
    if "uniform" in name:
        assert np.count_nonzero(one == 0.0) == np.count_nonzero(two == 0.0) == 1


@pytest.mark.parametrize("name", CLOUDS)
def test_two_ranks_carry_the_cloud_of_one(alone, divided, name):
    one, two = matched(alone[name], divided[name])
    assert np.abs(one).max() > 0.05
    assert np.abs(two - one).max() < AGREED * np.abs(one).max()


@pytest.mark.parametrize("name", ["members", "units"])
def test_state_and_memory_keep_the_numbering_of_one_process(alone, divided, name):
    assert alone[name].shape == divided[name].shape
    assert np.abs(divided[name] - alone[name]).max() < 1e-8 * np.abs(alone[name]).max()


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("no such file", "MeshError: mesh file nowhere.msh: not found"),
        ("reduced", "ConfigurationError: wind: solver 'reduced' works in one process"),
        ("bad start", "ContractError: wind: expected a start of"),
        ("too few steps", "WindError: wind: no solution"),
    ],
)
def test_what_is_wrong_is_an_error_on_every_rank(divided, name, error):
    told = divided[f"failure {name}"]
    assert len(told) == 2 and all(line.startswith(error) for line in told)


def test_a_communicator_of_one_rank_changes_no_bit(mesh_file):
    def found(tagged):
        solver = WindSolver(tagged, WindOptions(viscosity=10.0))
        wind = solver.solve(4.0, 1.0)
        transport = Transport(tagged, TransportOptions(), 1.0)
        return wind.unit, transport.system(solver.velocity(wind)).step(np.ones(transport.matrices.nodes))

    for one, other in zip(found(load(mesh_file)), found(load(mesh_file, MPI.COMM_WORLD)), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def folder(small_model, tmp_path_factory):
    """A working folder with a small experiment."""
    study = {
        "defaults": [{"override /model": "ad_ins"}, {"override /observer": "drone"}, "_self_"],
        "name": "small",
        "members": 2,
        "cycles": 2,
        "record": {"members": "all"},
        "pictures": False,
        "model": small_model | {"noise": 0.1, "wind": {"tolerance": 1e-11}},
        "truth": {"wind_speed": 4.0, "wind_speed_sd": 0.0, "noise": 0.0},
        "free": {"wind_speed_sd": 0.0, "noise": 0.0},
        "vehicle": {"start": [[60.0, 10.0]]},
    }
    made = tmp_path_factory.mktemp("runs")
    (made / "my" / "experiment").mkdir(parents=True)
    (made / "my" / "experiment" / "small.yaml").write_text("# @package _global_\n" + yaml.safe_dump(study))
    return made


RUN = ["-m", "dafw", "run", "--config-dir", "my", "experiment=small"]


def test_a_run_of_two_ranks_is_that_of_one_process(folder, monkeypatch, capsys):
    ended = mpiexec(*RUN, cwd=folder)
    assert (ended.returncode, ended.stderr) == (0, "")
    (path,) = (folder / "outputs" / "small").iterdir()
    assert ended.stdout.splitlines()[-1] == str(path) and len(ended.stdout.splitlines()) == 2
    summary = json.loads((path / "summary.json").read_text())
    assert (summary["status"], summary["cycles"], summary["processes"]) == ("complete", 2, 2)
    monkeypatch.chdir(folder)
    assert main([*RUN[2:], "hydra.run.dir=alone"]) == 0
    capsys.readouterr()
    with netCDF4.Dataset(path / "run.nc") as two, netCDF4.Dataset(folder / "alone" / "run.nc") as one:
        assert one.variables.keys() == two.variables.keys()
        for name in one.variables:
            if one[name].dtype is str or name == "phase_seconds":
                continue
            values = np.ma.filled(one[name][...].astype(float), -1.0)
            # fields are stored in single precision, and may be rounded to neighbours
            allowed = 1e-8 if one[name].dtype == np.float64 else 1e-7
            difference = np.nan_to_num(np.ma.filled(two[name][...].astype(float), -1.0) - values)
            assert np.abs(difference).max() <= allowed * np.nan_to_num(np.abs(values)).max(), name
        assert np.ptp(one["err"][:]) > 0.1


def test_what_cannot_be_divided_among_ranks_is_refused_in_one_line(folder):
    ended = mpiexec(*RUN, "model.wind.solver=reduced", "hydra.run.dir=refused", cwd=folder)
    assert (ended.returncode, ended.stdout) == (2, "")
    (line,) = ended.stderr.splitlines()
    assert line.startswith("dafw: model 'ad_ins': wind: solver 'reduced' works in one process, expected 'newton'")
    assert not (folder / "refused").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"executor": {"name": "processes"}}, "mpirun expects the executor 'serial', got executor 'processes'"),
        ({}, "model 'lorenz96' works in one process"),
    ],
)
def test_a_study_that_cannot_be_distributed_is_refused(changes, message):
    study = {"model": {"name": "lorenz96"}, "observer": {"name": "grid"}, "policy": {"name": "stationary"}}
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        study_from(study | {"filter": {"name": "none"}} | changes).prepare(MPI.COMM_SELF)


TROUBLE = """\
import os, sys
import dafw.commands.mpirun
from dafw.commands import main
from dafw.plugins.models.dispersion.fem.factorisation import Factorisation

def fail(self, *arguments):
    raise MemoryError("no room")

dafw.commands.mpirun.PATIENCE = 0.5
if os.environ["PMI_RANK"] == "1":
    Factorisation.factorise = fail
sys.exit(main(sys.argv[1:]))
"""


def test_trouble_on_one_rank_ends_them_all(folder):
    (folder / "trouble.py").write_text(TROUBLE)
    ended = mpiexec("trouble.py", *RUN[2:], "hydra.run.dir=trouble", cwd=folder)
    assert ended.returncode == 1
    assert "dafw: rank 1: at t = 0 s, phase 'forecast': model 'ad_ins' raised MemoryError: no room" in ended.stderr
    assert json.loads((folder / "trouble" / "summary.json").read_text())["status"] == "interrupted"


def test_a_run_that_is_told_to_stop_ends_after_its_cycle_on_all_ranks(folder):
    command = [str(Path(sys.executable).parent / "mpiexec"), "-n", "2", sys.executable, *RUN, "cycles=100000"]
    halting = ["policy=halting", f"policy.folder={folder / 'halt'}", "hydra.run.dir=stopped"]
    with halted([*command, *halting], folder, waiting=2) as run:
        run.terminate()
        go_on(folder)
        _, said = run.communicate(timeout=PATIENCE)
    assert "dafw: interrupted:" in said.splitlines()[0]
    assert "Abort" not in said
    summary = json.loads((folder / "stopped" / "summary.json").read_text())
    with netCDF4.Dataset(folder / "stopped" / "run.nc") as file:
        assert len(file.dimensions["time"]) == summary["cycles"] + 1
    assert summary["status"] == "interrupted"


def test_a_rank_looks_the_mesh_up_once(options, monkeypatch):
    looked_up = []
    monkeypatch.setattr(module, "generate", lambda *what: looked_up.append(what) or generate(*what))
    model = build(AdvectionDiffusionINS, options, "model")
    model.distribute(MPI.COMM_SELF)
    assert model.solver_mesh.file == model.tagged_mesh.file
    assert len(looked_up) == 1


def test_other_commands_are_refused_by_one_rank_and_load_no_mpi(folder):
    # A file for each rank, because the output of two ranks may be mixed.
    code = "import os, sys, pathlib; from dafw.commands import main; status = main(['plugins']); "
    code += "pathlib.Path(f'{os.getpid()}.rank').write_text(f'{status} {\"mpi4py\" in sys.modules}')"
    ended = mpiexec("-c", code, cwd=folder)
    assert [path.read_text() for path in Path(folder).glob("*.rank")] == ["2 False", "2 False"], ended.stderr
    assert ended.stderr == "dafw: 'dafw plugins' works in one process: mpirun is for 'dafw run'\n"


def test_a_single_process_never_asks_for_mpi_where_it_need_not(folder):
    code = "import sys; from dafw.commands import main; main(['--help']); main(['plugins']); "
    code += "print('mpi4py' in sys.modules)"
    ended = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=PATIENCE)
    assert ended.stdout.splitlines()[-1] == "False"
