"""Settings of all tests."""

import os

import pytest

# One thread: the matrices of the tests are small, and CI has two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Try the pages first, because some of them take minutes: of two processes none then waits long for the other."""
    items.sort(key=lambda item: item.path.name != "test_docs.py")
