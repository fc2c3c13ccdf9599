"""Twenty real kills of real processes, at moments drawn by chance: ``python -m benchmarks.kills``."""

from killed import log_of_kills

KINDS = {
    "before a cycle": "SIGKILL",
    "inside a write of HDF5": "SIGXFSZ",
    "between the variables of rows": "SIGKILL",
    "inside a checkpoint": "SIGKILL",
    "between a checkpoint and its name": "SIGKILL",
    "inside a journal": "SIGKILL",
    "before old checkpoints go": "SIGKILL",
    "by the clock": "",  # the run may be complete before its moment has come, on a machine that is busy at times
    "twice, while it goes on": "SIGKILL",
    "on a full disk": "status 1",
}


def test_runs_that_are_killed_go_on_to_the_same_bits():
    head, rows = log_of_kills("benchmarks.kills", 20)
    assert "moment" in head
    for row, (kind, ended) in zip(rows, [*KINDS.items()] * 2, strict=True):
        assert kind in row and ended in row and row.endswith(": identical")
    assert any("went on after [" in row for row in rows)
