"""A study that needs more memory than is free is refused before anything is made."""

from types import SimpleNamespace

import psutil
import pytest

from dafw import ConfigurationError, Study
from dafw.commands import main
from dafw.core import memory
from dafw.core.memory import free_memory, require_memory
from dafw.core.registry import registry

GB = 10**9
RUN = ["run", "experiment=lorenz96", "pictures=false", "hydra.run.dir=run"]


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with 8 GB free and without control groups."""
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=8 * GB))
    return tmp_path


def write(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_text(f"{content}\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["members=1000000000000"], "2.56e+06 GB of it for 1000000000000 members of 40 numbers, with what"),
        (["filter=enks", "cycles=1000000000000"], "past beliefs that filter 'enks' looks back to"),
    ],
)
def test_more_than_there_is_is_one_line_and_nothing_is_made(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    assert main([*RUN, *words]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("dafw: the study needs at least ") and message in line
    assert not any(tmp_path.iterdir())


def test_the_workers_of_this_machine_count(machine):
    members = 8 * GB // (8 * 8 * 40)
    create = registry().create
    models = {role: create("model", {"name": "lorenz96"}) for role in ("model", "truth")}
    parts = models | {"filter": create("filter", {"name": "etkf"}), "members": members}
    for executor in ({"name": "serial"}, {"name": "dask", "address": "tcp://10.0.0.1:8786"}):
        Study(**parts, executor=create("executor", executor)).prepare()
    for name in ("processes", "dask"):
        study = Study(**parts, executor=create("executor", {"name": name}))
        with pytest.raises(
            ConfigurationError, match=r"needs at least 11 GB of memory, there are 8 GB free; 8 GB of it"
        ):
            study.prepare()


def test_what_fits_is_let_pass_and_the_most_expensive_thing_is_named(machine):
    require_memory({"a": 3 * GB, "b": 5 * GB})
    with pytest.raises(ConfigurationError, match=r"at least 9 GB of memory, there are 8 GB free; 6 GB of it for b$"):
        require_memory({"a": 3 * GB, "b": 6 * GB})


@pytest.mark.parametrize("path", ["/", "/system/job"])
def test_the_limit_of_a_container_counts(machine, path):
    """The process's control group is the topmost visible one, or one below others."""
    (machine / "own").write_text(f"0::{path}\n")
    own = machine / "groups" / path.lstrip("/")
    write(own, memory__max=4 * GB, memory__current=3 * GB, memory__stat=f"anon 1\ninactive_file {2 * GB}")
    assert free_memory() == 3 * GB
    write(own, memory__max="max")
    assert free_memory() == 8 * GB


def test_the_narrowest_of_the_groups_around_a_process_counts(machine):
    (machine / "own").write_text("0::/a/b\n")
    for path, limit in (("a", 2 * GB), ("a/b", 3 * GB)):
        write(machine / "groups" / path, memory__max=limit, memory__current=GB, memory__stat="inactive_file 0")
    assert free_memory() == GB
    write(machine / "groups" / "a/b", memory__max=GB // 2)
    assert free_memory() == 0


def test_control_groups_of_version_1(machine):
    (machine / "own").write_text("5:devices:/x\n4:cpu,memory:/job\n0::/\n")
    files = {"memory__usage_in_bytes": 2 * GB, "memory__stat": f"cache 7\ntotal_inactive_file {GB}"}
    write(machine / "groups" / "memory" / "job", memory__limit_in_bytes=6 * GB, **files)
    write(machine / "groups" / "memory", memory__limit_in_bytes=2**63 - 4096, **files)
    assert free_memory() == 5 * GB


def test_this_machine_has_memory():
    assert 0 < free_memory() <= psutil.virtual_memory().total
