"""Worker processes: they run functions, are replaced if they are lost, and none is left over."""

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import errands
import pytest
from waiting import PATIENCE, ended

from dafw.core import workers
from dafw.core.errors import ComputationError, SolverError
from dafw.core.making import alive
from dafw.core.workers import Worker, outcome, run_tasks, spare_cores


@pytest.fixture(autouse=True)
def found(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def test_tasks_are_shared_out_and_all_come_back():
    done = dict(run_tasks(errands.squared, [(k,) for k in range(7)], 3, "squares"))
    assert {number: value for number, (value, _) in done.items()} == {k: k * k for k in range(7)}
    processes = {process for _, process in done.values()}
    assert os.getpid() not in processes and len(processes) <= 3
    assert not any(map(alive, processes))


def test_a_worker_takes_no_part_in_its_parents_mpi_job(monkeypatch):
    for name in ("PMI_RANK", "PMI_FD", "OMPI_COMM_WORLD_SIZE"):
        monkeypatch.setenv(name, "1")
    assert list(run_tasks(errands.ranks_known, [()], 1, "ranks")) == [(0, [])]


def test_an_error_is_the_one_line_that_it_is_here():
    with pytest.raises(SolverError, match=r"^no square of 13$"):
        list(run_tasks(errands.squared, [(1,), (13,)], 2, "squares"))
    with pytest.raises(ComputationError, match=r"^squares raised TypeError: unsupported operand"):
        list(run_tasks(errands.squared, [("one",)], 2, "squares"))


def test_a_worker_that_is_killed_is_replaced(tmp_path, caplog):
    done = dict(run_tasks(errands.killed_once, [(str(tmp_path / "once"), k) for k in range(3)], 2, "errands"))
    assert done == {k: k for k in range(3)}
    assert "errands: a worker (process" in caplog.text and "killed by signal 9; another does its work" in caplog.text


def test_workers_that_die_again_and_again_end_it():
    with pytest.raises(ComputationError, match="3 were lost, at most 2 are replaced"):
        list(run_tasks(errands.killed, [()], 2, "errands"))


def test_no_worker_is_left_where_nobody_wants_the_rest(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(workers, "Worker", lambda: made.append(Worker()) or made[-1])
    done = tmp_path / "done"
    with closing(run_tasks(errands.slow, [(0.0,), (600.0, str(done))], 2, "errands")) as tasks:
        next(tasks)
    assert len(made) == 2 and not any(alive(worker.process.pid) for worker in made)
    assert not done.exists()


def test_workers_have_no_workers_of_their_own():
    worker = Worker()
    worker.ask(errands.cores_to_spare)
    assert worker.receive().get() == 1
    worker.end()
    assert outcome("a test", spare_cores).get() == 1


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_process_that_wants_them(number, tmp_path):
    script = tmp_path / "script.py"  # no `if __name__ == "__main__"`
    script.write_text(
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it is ignored\n"
        "import errands; from dafw.core.workers import run_tasks\n"
        "print('begun', flush=True)\n"
        "for _, process in run_tasks(errands.slow, [(0.0,), (0.0,), (600.0,), (600.0,)], 2, 'errands'):\n"
        "    print(process, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        try:
            assert run.stdout.readline() == "begun\n"
            pids = [int(run.stdout.readline()) for _ in range(2)]
            run.send_signal(number)
            output, _ = run.communicate(timeout=PATIENCE)
        finally:
            run.kill()
    assert "begun" not in output
    assert ended(pids)
