"""The page on run.nc and summary.json compared with runs of every kind: it has exactly the names in their files."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from conventions import breaches

from dafw import Analysis, ComputationError, Filter, Model, StateSpace, Study, Variable
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.observers.drone import Drone
from dafw.plugins.policies.enie2d import EnIE2D
from dafw.plugins.readings.listed import Listed
from dafw.studies.running import run_study

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "run-file.md").read_text()
NAME = re.compile(r"`([^`]+)`")
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])


def rows(heading):
    """Return the rows of the table under a heading of the page, each a list of its cells."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@dataclass
class Ponds(Model):
    """Levels at three places, temperatures at others, and a leak."""

    dt: float = 1.0
    space: StateSpace = field(
        default_factory=lambda: StateSpace(
            [
                Variable("level", 3, coordinates=PLACES),
                Variable("heat", 3, coordinates=PLACES + 1.0),
                Variable("leak", 1),
            ]
        )
    )

    def initial(self, n_members, rng):
        return 1.0 + 0.1 * rng.standard_normal((n_members, 7))

    def step(self, members, t, rng):
        return 0.9 * members


@dataclass
class Weighing(Filter):
    """Does not change the members, but gives them weights."""

    def analyse(self, forecast, predicted, observation, rng):
        weights = np.arange(1.0, len(forecast) + 1.0)
        return Analysis(forecast.members, weights=weights / weights.sum())


LISTED = Listed([{"time": 0.5, "value": 1.0, "entry": 1}, {"time": 1.0, "value": 1.0, "entry": 0, "arrives": 2.0}])

MEANS = Listed([{"time": 1.0, "value": 1.0, "entry": 1}, {"time": 2.0, "value": 1.0, "entry": 0, "span": 2.0}])


def plant():
    """Return a study with all features: a plant with its wind, a drone with a policy, a filter that looks back."""
    options = {**AdvectionDiffusionINS.check_options(), "noise": 0.0}
    models = {role: AdvectionDiffusionINS.from_options(**options) for role in ("model", "truth", "free")}
    flown = {"observer": Drone(), "policy": EnIE2D(), "start": [[0.0, -30.0]], "section": [[0.0, -80.0], [0.0, -30.0]]}
    return Study(**models, **flown, filter=EnKS(window=2), members=3, cycles=2)


def ponds(**more):
    return Study(**({"model": Ponds(), "filter": ETKF(), "readings": LISTED, "members": 3, "cycles": 3} | more))


PLANT = {
    "mesh",
    "buildings",
    "named places",
    "section",
    "policy `enie2d`",
    "model `ad_ins`",
    "sensors",
    "place on Earth",
}
STUDIES = {
    "plant": (plant, {"truth", "free run", "window", "members", "places"} | PLANT),
    "without a truth": (ponds, {"members", "places", "other places"}),
    "with a free run": (lambda: ponds(free=Ponds(), record="none"), {"free run", "places", "other places"}),
    "with a truth": (lambda: ponds(truth=Ponds()), {"truth", "members", "places", "other places"}),
    "smoothed": (lambda: ponds(filter=EnKS()), {"window", "members", "places", "other places"}),
    "averaging": (lambda: ponds(readings=MEANS), {"members", "places", "other places", "spans"}),
    "weighed": (lambda: ponds(filter=Weighing()), {"weights", "members", "places", "other places"}),
}


@pytest.fixture(scope="module", params=list(STUDIES))
def run(request, tmp_path_factory):
    """Return a run's file, its summary and the entries of the column 'present' that apply to it."""
    make, present = STUDIES[request.param]
    folder = tmp_path_factory.mktemp("run") / "run"
    summary = run_study(make(), folder)
    with netCDF4.Dataset(folder / "run.nc") as file:
        yield file, json.loads((folder / "summary.json").read_text()), present
    assert summary["status"] == "complete"


def documented(file, heading, present):
    """Yield name, dims, whether it should be present and the state variable, for every row of a table."""
    spaced = [name.removesuffix("_forecast_mean") for name in file.variables if name.endswith("_forecast_mean")]
    variables = [name for name in spaced if name != "observation"]
    for cells in rows(heading):
        names, dims, when = NAME.findall(cells[0]), cells[1] if len(cells) == 4 else "", cells[-2]
        wanted = when == "always" or set(when.split(", ")) <= present
        for name in names:
            for variable in variables if "<variable>" in name else [""]:
                yield name.replace("<variable>", variable), dims.replace("<variable>", variable), wanted, variable


def test_every_variable_is_on_the_page_and_is_there_when_the_page_says_so(run):
    file, _, present = run
    known = set()
    for name, dims, wanted, variable in documented(file, "Variables", present):
        known.add(name)
        if name.endswith("_members"):
            wanted &= file[f"{variable}_mean"].dimensions == ("time",)  # the default, `parameters`
        if name.startswith("node_") and variable:
            wanted &= f"node_{variable}" in file.dimensions
        assert (name in file.variables) == wanted, name
        if not wanted or dims == "see below":
            continue
        node = {f"node_{variable}", "node"} & set(file[name].dimensions)
        written = dims.replace(" (node)", f", {node.pop()}" if node and "(node)" in dims else "")
        assert ", ".join(file[name].dimensions) == written, name
    assert set(file.variables) - known == set()


def test_the_file_keeps_to_the_conventions(run):
    file, _, _ = run
    assert breaches(file.filepath()) == []


def test_every_dimension_is_on_the_page(run):
    file, _, _ = run
    known = {name for cells in rows("Dimensions") for name in NAME.findall(cells[0])}
    assert {re.sub("^node_.*", "node_<variable>", name) for name in file.dimensions} <= known


def test_every_attribute_is_on_the_page(run):
    file, _, present = run
    known = set()
    for name, _, wanted, _ in documented(file, "Attributes", present):
        known.add(name)
        if not name.endswith("_pinned"):
            assert (name in file.ncattrs()) == wanted, name
    assert set(file.ncattrs()) <= known


def test_every_field_of_the_summary_is_on_the_page(run):
    _, summary, present = run
    known = {name for cells in rows("`summary.json`") for name in NAME.findall(cells[0])}
    assert set(summary) == known - {"error", "failed_at"}
    said = next(cells[1] for cells in rows("`summary.json`") if cells[0] == "`readings`")
    assert set(NAME.findall(said)) == set(summary["readings"])
    assert (summary["err_final"] is None) == ("truth" not in present)
    assert (summary["err_free_final"] is None) == (not {"truth", "free run"} <= present)


def test_what_became_of_the_readings_is_as_the_page_numbers_it(run):
    file, _, _ = run
    said = next(cells[3] for cells in rows("Variables") if cells[0] == "`observation_use`")
    numbers = dict(re.findall(r"(\d) (used at the end|late and used|dropped)", said))
    meant = {"used": "used at the end", "used_in_window": "late and used", "dropped": "dropped"}
    use = file["observation_use"]
    values = [str(value) for value in use.flag_values]
    assert [numbers[value] for value in values] == [meant[flag] for flag in use.flag_meanings.split()]


def test_a_failed_run_says_what_went_wrong(tmp_path):
    class Broken(Ponds):
        def step(self, members, t, rng):
            raise RuntimeError("the pump failed")

    with pytest.raises(ComputationError):
        run_study(ponds(model=Broken()), tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["status"] == "failed" and "the pump failed" in summary["error"]
    assert set(summary) <= {name for cells in rows("`summary.json`") for name in NAME.findall(cells[0])}
