"""Settings of all tests."""

import os

import pytest

import dafw  # noqa: F401 - before any test module loads netCDF4, so that files that are being written can be read

# One thread: the matrices of the tests are small, and CI has two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add what tests/plugins/test_combinations.py and tests/test_benchmarks.py ask for."""
    parser.addoption("--all-combinations", action="store_true", help="run every combination of parts that can be run")
    parser.addoption("--downloads", action="store_true", help="run the benchmarks that download other programs")


@pytest.fixture(scope="session")
def browser():
    """Return a Chromium for all tests of pages; where there is none they are skipped."""
    from browser import installed_browser

    path = installed_browser()
    if path is None:
        pytest.skip("there is no Chromium, and the variable DAFW_BROWSER names none")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path)
        yield opened
        opened.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Try the pages first, because some of them take minutes: of two processes none then waits long for the other."""
    items.sort(key=lambda item: item.path.name != "test_docs.py")
