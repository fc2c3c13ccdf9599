"""Settings of all tests."""

import os

import pytest

# One thread: the matrices of the tests are small, and CI has two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Share the tests among processes (``sh setup.sh test`` has two): pages one by one, all others file by file.

    A file's tests share what its fixtures make. Pages come first, because some of them take minutes.
    """
    items.sort(key=lambda item: item.path.name != "test_docs.py")
    for item in items:
        name = item.name if item.path.name == "test_docs.py" else str(item.path)
        item.add_marker(pytest.mark.xdist_group(name))
