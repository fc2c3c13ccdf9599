"""How dafw recognises whether it is one of several processes. These tests start no processes."""

import os
import subprocess
import sys

import pytest
from waiting import PATIENCE

from dafw.commands import main, mpirun
from dafw.commands.mpirun import ALONE, Launch, launched

SEVERAL = {"SLURM_PROCID": "0", "SLURM_STEP_NUM_TASKS": "4"}


@pytest.fixture(autouse=True)
def task(monkeypatch):
    """No variables of any launcher; if a test sets SLURM's, the process is a task of srun."""
    for name in [name for name in os.environ if name.startswith(("PMI", "OMPI_", "SLURM_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setattr(mpirun, "_is_task", lambda: True)


def environment(monkeypatch, **variables):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, ALONE),
        ({"PMI_RANK": "1", "PMI_SIZE": "2"}, Launch("mpirun", 1, 2)),
        ({"OMPI_COMM_WORLD_RANK": "0", "OMPI_COMM_WORLD_SIZE": "3"}, Launch("mpirun", 0, 3)),
        ({"SLURM_PROCID": "3", "SLURM_STEP_NUM_TASKS": "4", "SLURM_NTASKS": "4"}, Launch("srun", 3, 4)),
        ({"SLURM_PROCID": "3", "SLURM_STEP_NUM_TASKS": "4", "PMIX_RANK": "3"}, Launch("srun", 3, 4)),
        ({"PMI_RANK": "0", "PMI_SIZE": "1", **SEVERAL}, Launch("mpirun", 0, 1)),  # mpirun -n 1 within a step
        ({"PMIX_RANK": "2"}, Launch("mpirun", 2, 0)),
        ({"PMI_RANK": "1"}, Launch("mpirun", 1, 0)),
        ({"PMIX_RANK": "0"}, ALONE),
        ({"SLURM_PROCID": "0", "SLURM_NTASKS": "4", "SLURM_JOB_ID": "7"}, ALONE),  # a batch script
        ({"SLURM_STEP_NUM_TASKS": "4"}, ALONE),
    ],
)
def test_launchers_are_known_by_their_variables(monkeypatch, variables, expected):
    environment(monkeypatch, **variables)
    assert launched() == expected


@pytest.mark.parametrize(
    ("cgroup", "size"),
    [("0::/system.slice/slurmstepd.scope/job_7/step_batch/user/task_0", 1), ("0::/slurm/uid_1/job_7/step_0/task_0", 4)],
)
def test_a_batch_script_is_alone_whatever_it_was_handed_down(tmp_path, cgroup, size):
    (tmp_path / "cgroup").write_text(cgroup + "\n")
    code = "import sys; from pathlib import Path; from dafw.commands import mpirun; mpirun.CGROUP = Path(sys.argv[1]); "
    assert asked(code, tmp_path / "cgroup").startswith(str(size))


def test_the_shell_of_an_interactive_step_is_alone(tmp_path):
    ours, theirs = os.openpty()
    code = "import os, sys; from dafw.commands import mpirun; "
    code += "os.open(sys.argv[1], os.O_RDWR); "  # of a session: its terminal
    try:
        assert asked(code, os.ttyname(theirs)).startswith("1")
    finally:
        os.close(ours)
        os.close(theirs)
    assert asked("import os, sys; from dafw.commands import mpirun; ", "none").startswith("4")


def asked(code, argument):
    """Return the size that a process without a terminal finds in a step of four."""
    return subprocess.run(
        [sys.executable, "-c", code + "print(mpirun.launched().size)", str(argument)],
        env={**os.environ, **SEVERAL},
        start_new_session=True,
        check=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    ).stdout


def refused(capsys, words):
    assert main(words) == 2
    return capsys.readouterr().err


def test_the_mpirun_of_another_library_is_refused(monkeypatch, capsys):
    environment(monkeypatch, OMPI_COMM_WORLD_SIZE="2", OMPI_COMM_WORLD_RANK="0")
    line = "dafw: mpirun started 2 processes, which see 1: expected the mpirun of MPICH\n"
    assert refused(capsys, ["run"]) == line


def test_tasks_that_do_not_see_each_other_are_refused_by_one_of_them(monkeypatch, capsys):
    environment(monkeypatch, **SEVERAL)
    said = refused(capsys, ["run"])
    assert said.startswith("dafw: srun started 4 processes, which see 1: expected the mpirun of MPICH, or ")
    assert said.count("\n") == 1
    monkeypatch.setenv("SLURM_PROCID", "1")
    assert refused(capsys, ["run"]) == ""


def test_ranks_of_an_unknown_number_are_refused_by_one_of_them(monkeypatch, capsys):
    monkeypatch.setenv("PMIX_RANK", "1")
    said = refused(capsys, ["run"])
    assert said.startswith("dafw: rank 1 of a launcher that does not give the number of processes: expected the mpirun")
    assert said.count("\n") == 1
    monkeypatch.setenv("PMIX_RANK", "2")
    assert refused(capsys, ["run"]) == ""


def test_srun_starts_other_commands_wherever_it_likes(monkeypatch, capsys):
    environment(monkeypatch, **SEVERAL)
    assert main(["plugins", "etkf"]) == 0
    assert "etkf" in capsys.readouterr().out
