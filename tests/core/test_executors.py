"""Executors: the same bits wherever members are stepped; lost workers are replaced, and none outlives its run."""

import json
import logging
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from trouble import Trouble, install
from waiting import PATIENCE, children, ended, go_on, halted

import dafw
from dafw import ComputationError, ConfigurationError, ContractError, DafwError, Ensemble
from dafw.commands import main
from dafw.core.ensemble import Diagnostic, Step
from dafw.core.errors import RequestError, SolverError
from dafw.core.executors.batches import Batch, Stepped, join, split, step_members
from dafw.core.making import alive
from dafw.core.registry import registry
from dafw.core.rng import Streams
from dafw.core.space import StateSpace, Variable

N = 7


@pytest.fixture(autouse=True)
def installed(tmp_path, monkeypatch):
    """Register the model `trouble` in this process and its workers."""
    install(tmp_path, monkeypatch)


def walk(executor, steps=3, **options):
    """Return the forecasts of a few steps of seven members."""
    model, streams = Trouble(**options), Streams(4)
    model.name = "trouble"
    forecast = model.first_guess(N, streams.members("initial", 0))
    done = []
    with registry().create("executor", executor) as running:
        running.start(model, {"name": "trouble", **options})
        for cycle in range(steps):
            rng, ensemble = streams.members("error", cycle), forecast.ensemble
            stepped = running.submit(model, Batch(ensemble.members, forecast.memory, ensemble.time, rng))
            forecast = model.stepped(ensemble, stepped().steps[-1])
            done.append(forecast)
    return done


def assert_same_bits(ones, others):
    for one, other in zip(ones, others, strict=True):
        assert one.ensemble.members.tobytes() == other.ensemble.members.tobytes()
        assert one.memory["way"].tobytes() == other.memory["way"].tobytes()
        assert one.diagnostics.keys() == other.diagnostics.keys()
        for name, diagnostic in one.diagnostics.items():
            assert diagnostic.dims == other.diagnostics[name].dims
            np.testing.assert_array_equal(diagnostic.values, other.diagnostics[name].values)


SERIAL = {"name": "serial"}
TWO = {"name": "processes", "workers": 2}


@pytest.mark.parametrize("workers", [1, 9])
def test_processes_give_the_bits_of_the_serial_executor(workers):
    assert_same_bits(walk(SERIAL), walk({"name": "processes", "workers": workers}))


def test_a_worker_that_is_killed_is_replaced_and_nothing_is_lost(tmp_path, caplog):
    whole = walk(SERIAL)
    with caplog.at_level(logging.WARNING, "dafw"):
        assert_same_bits(whole, walk(TWO, kind_of="killed_once", marker=str(tmp_path / "once")))
    assert re.search(r"worker 1 \(process \d+\) was killed by signal 9 while it stepped members 3 to 6", caplog.text)
    assert (tmp_path / "once").exists()


def test_a_dask_worker_that_is_killed_is_replaced_and_nothing_is_lost(tmp_path):
    dask = {"name": "dask", "workers": 2}
    assert_same_bits(walk(SERIAL), walk(dask, kind_of="killed_once", marker=str(tmp_path / "once")))
    assert (tmp_path / "once").exists()


def test_two_dask_clusters_of_this_machine_do_not_meet():
    model = Trouble()
    one, other = (registry().create("executor", {"name": "dask", "workers": 1}) for _ in range(2))
    with one, other:
        one.start(model, {"name": "trouble"})
        other.start(model, {"name": "trouble"})  # a port in use would give a warning, which is an error here
        assert one._client.scheduler.address != other._client.scheduler.address


def test_workers_that_are_lost_again_and_again_end_the_run():
    with pytest.raises(ComputationError, match=r"members 3 to 6; 2 were lost in this step, at most 1 are replaced"):
        walk(TWO | {"retries": 1}, kind_of="always_killed")


@pytest.mark.parametrize("executor", [SERIAL, TWO], ids=["serial", "processes"])
def test_errors_come_back_with_their_name_and_the_number_of_the_member(executor):
    with pytest.raises(SolverError, match=r"^member 3: does not walk$"):
        walk(executor, kind_of="refuses")


def test_whoever_steps_a_batch_counts_members_in_the_whole_ensemble():
    model, streams = Trouble(kind_of="refuses"), Streams(4)
    forecast = model.first_guess(N, streams.members("initial", 0))
    ensemble = forecast.ensemble
    batches = split(model, Batch(ensemble.members, forecast.memory, 1.0, streams.members("error", 0)), 3)
    with pytest.raises(SolverError, match=r"^member 3: does not walk$"):
        [step_members(model, batch) for batch in batches]


def test_what_a_plugin_raises_on_its_own_names_the_plugin():
    with pytest.raises(ComputationError, match="model 'trouble' raised ValueError: a leg is broken"):
        walk(TWO, kind_of="breaks")


def test_a_diagnostic_that_is_not_of_members_must_not_depend_on_the_batch():
    assert walk(SERIAL, kind_of="not_of_members")[0].diagnostics["batch_size"].values == N
    with pytest.raises(ContractError, match="model 'trouble': the diagnostic 'batch_size' differs from one batch"):
        walk(TWO, kind_of="not_of_members")


def test_closing_ends_the_workers_even_in_a_step_that_nobody_waits_for(tmp_path):
    options = {"kind_of": "sleeps", "marker": str(tmp_path / "awake")}
    model, streams = Trouble(**options), Streams(0)
    forecast = model.first_guess(N, streams.members("initial", 0))
    executor = registry().create("executor", TWO)
    executor.start(model, {"name": "trouble", **options})
    workers = [place.worker.process.pid for place in executor._pool]
    executor.submit(model, Batch(forecast.ensemble.members, forecast.memory, 1.0, streams.members("error", 0)))
    executor.close()
    assert len(workers) == 2 and not any(map(alive, workers))
    assert not (tmp_path / "awake").exists()


def test_a_step_that_nobody_waited_for_does_not_spoil_the_next():
    model, streams = Trouble(), Streams(0)
    forecast = model.first_guess(N, streams.members("initial", 0))
    rng = streams.members("error", 0)
    with registry().create("executor", TWO) as executor:
        executor.start(model, {"name": "trouble"})
        executor.submit(model, Batch(forecast.ensemble.members + 1.0, forecast.memory, 0.0, rng))
        (step,) = executor.submit(model, Batch(forecast.ensemble.members, forecast.memory, 0.0, rng))().steps
    alone = model.step_with_memory(forecast.ensemble.members, forecast.memory, 0.0, rng)
    assert step.members.tobytes() == alone.members.tobytes()


# Batches


def ensemble(n_members):
    space = StateSpace([Variable("x", 2)])
    model = Trouble()
    model.name = "trouble"
    return model, Ensemble(np.arange(2.0 * n_members).reshape(n_members, 2), space)


@pytest.mark.parametrize(("n_members", "count"), [(1, 4), (5, 2), (7, 3), (4, 4), (3, 8)])
def test_batches_are_neighbours_in_order_with_their_own_streams(n_members, count):
    model, belief = ensemble(n_members)
    rng, memory = Streams(1).members("error", 5), {"number": np.arange(n_members)}
    batches = split(model, Batch(belief.members, memory, 2.0, rng), count)
    assert len(batches) == min(n_members, count)
    sizes = [len(batch.members) for batch in batches]
    assert sum(sizes) == n_members and max(sizes) - min(sizes) <= 1
    whole = rng.standard_normal((n_members, 3))
    for batch in batches:
        here = slice(batch.first, batch.first + len(batch.members))
        np.testing.assert_array_equal(batch.members, belief.members[here])
        np.testing.assert_array_equal(batch.memory["number"], np.arange(n_members)[here])
        np.testing.assert_array_equal(batch.rng.standard_normal((len(batch.members), 3)), whole[here])


def test_a_memory_without_members_on_axis_0_cannot_be_cut():
    model, belief = ensemble(4)
    with pytest.raises(ContractError, match=r"4 members on axis 0, got the shape \(3, 4\) for 'way'"):
        split(model, Batch(belief.members, {"way": np.zeros((3, 4))}, 0.0, Streams(0).members("error", 0)), 2)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([Step(np.zeros((2, 2))), Step(np.zeros((1, 2)))], r"members 2 to 3 after a step must have the shape \(2, 2\)"),
        ([Step(np.zeros((2, 2)), {"a": np.zeros(2)}), Step(np.zeros((2, 2)))], "different kinds of memory"),
        ([Step(np.zeros((2, 2)), {"a": np.zeros(2)})] * 2, None),
        ([Step(np.zeros((2, 2)), {"a": np.zeros(4)})] * 2, r"memory of members 0 to 1 must have them on axis 0"),
        ([Step(np.zeros((2, 2)), None, {"a": Diagnostic(1)}), Step(np.zeros((2, 2)))], "different diagnostics"),
    ],
)
def test_steps_that_do_not_fit_together_are_refused(steps, message):
    model, belief = ensemble(4)
    batches = split(model, Batch(belief.members, None, 0.0, Streams(0).members("error", 0)), 2)
    stepped = [Stepped((step,)) for step in steps]
    if message is None:
        assert join(model, batches, stepped).steps[0].memory["a"].shape == (4,)
    else:
        with pytest.raises(ContractError, match=message):
            join(model, batches, stepped)


# Messages and behaviour that users see


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"name": "threads"}, r"no executor 'threads' \(there are: dask, processes, serial\)"),
        ({}, "an executor needs a name"),
        ({"name": "serial", "workers": 2}, "executor 'serial': unknown option 'workers'"),
        ({"name": "processes", "workers": 0}, "executor 'processes': option 'workers' must be at least 1"),
    ],
)
def test_a_wrong_executor_is_refused(config, message):
    with pytest.raises(RequestError, match=message):
        registry().create("executor", config)


def test_dask_without_its_package_is_refused(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"needs the package distributed: install dafw\[dask\]"):
        registry().create("executor", {"name": "dask"})


def test_a_scheduler_that_does_not_answer_is_a_wrong_request():
    with pytest.raises(ConfigurationError, match=r"executor 'dask': no 1 workers at tcp://127.0.0.1:9: "):
        walk({"name": "dask", "address": "tcp://127.0.0.1:9", "wait": 0.5})


def test_an_executor_that_was_not_started_says_so():
    model, belief = ensemble(4)
    batch = Batch(belief.members, None, 0.0, Streams(0).members("error", 0))
    for name in set(registry().names("executor")) - {"serial"}:
        with pytest.raises(DafwError, match="was not started"):
            registry().create("executor", {"name": name}).submit(model, batch)


LORENZ = ["experiment=lorenz96", "pictures=false", "hydra.run.dir=run"]


@pytest.mark.parametrize(
    ("number", "whom", "executor"),
    [
        (signal.SIGTERM, os.kill, "processes"),
        (signal.SIGINT, os.killpg, "processes"),  # like Ctrl-C, which signals the whole process group
        (signal.SIGKILL, os.kill, "processes"),
        (signal.SIGINT, os.killpg, "dask"),
    ],
)
def test_no_worker_outlives_its_run(tmp_path, number, whom, executor):
    words = ["-m", "dafw", "run", *LORENZ, "model=halting_lorenz96", f"model.folder={tmp_path / 'halt'}"]
    words += ["+truth.folder=''", "+free.folder=''", f"executor={executor}", "executor.workers=2"]
    with halted(words, tmp_path, waiting=2, start_new_session=True) as run:
        workers = children(run.pid)
        assert len(workers) >= 2
        whom(run.pid, number)
        if number != signal.SIGKILL:
            go_on(tmp_path)
        _, error = run.communicate(timeout=PATIENCE)
    assert "Traceback" not in error
    if number != signal.SIGKILL:
        assert run.returncode == 130 and "interrupted" in error
    assert ended(workers)


def test_the_command_gives_the_same_file_and_says_where_members_were_stepped(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    values = {}
    for executor in ("serial", "processes"):
        assert main(["run", *LORENZ[:2], "cycles=4", f"executor={executor}", f"hydra.run.dir={executor}"]) == 0
        assert json.loads(Path(executor, "summary.json").read_text())["executor"]["name"] == executor
        with dafw.open_run(executor) as run:
            values[executor] = {name: run[name].values for name in run.variables if name != "phase_seconds"}
    assert values["serial"].keys() == values["processes"].keys()
    for name, array in values["serial"].items():
        np.testing.assert_array_equal(array, values["processes"][name], err_msg=name)


def test_a_sweep_side_by_side_ends_like_any_other(tmp_path):
    words = [sys.executable, "-m", "dafw", "run", "-m", "hydra/launcher=cores", "hydra.launcher.n_jobs=2"]
    words += [LORENZ[0], LORENZ[1], "cycles=2", "seed=0,1", "hydra.sweep.dir='a sweep'", "hydra.sweep.subdir=${seed}"]
    sweep = tmp_path / "a sweep"
    (sweep / "0").mkdir(parents=True)
    (sweep / "0" / "run.nc").touch()  # a wrong request that is found only when the job runs
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("holds a run already") == 1, done.stderr
    assert done.stdout.splitlines()[-1] == str(sweep)
    assert json.loads((sweep / "1" / "summary.json").read_text())["status"] == "complete"
    assert not (sweep / "0" / "summary.json").exists()


def test_the_launcher_of_a_cluster_composes():
    from dafw.core.composition import compose

    config = compose(["hydra/launcher=slurm", "hydra.launcher.partition=short"])
    assert config.hydra.launcher.partition == "short" and config.hydra.launcher.cpus_per_task == 1
    assert config.hydra.launcher._target_.startswith("hydra_plugins.hydra_submitit_launcher.")
