"""Real kills of real processes: ``python -m benchmarks.kills`` with three of its twenty."""

from killed import log_of_kills


def test_runs_that_are_killed_go_on_to_the_same_bits():
    head, rows = log_of_kills("benchmarks.kills", 3)
    assert "moment" in head
    for row, kind, signal in zip(
        rows,
        ("before a cycle", "inside a write of HDF5", "between the variables of rows"),
        ("SIGKILL", "SIGXFSZ", "SIGKILL"),
        strict=True,
    ):
        assert kind in row and signal in row and row.endswith(": identical")
    assert any("went on after [" in row for row in rows)
