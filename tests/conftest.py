"""Settings of all tests."""

import os

# One thread: the matrices of the tests are small, and CI has two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
