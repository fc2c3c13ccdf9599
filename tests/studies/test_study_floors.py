"""The floors of a study: found once for each truth, model and length, kept, and in the results."""

import json

import numpy as np
import pytest
import xarray
from made_runs import make_run

from dafw.core.errors import ConfigurationError, RunError, SolverError
from dafw.studies import floors
from dafw.studies.floor import Floor
from dafw.studies.floors import FILE, composed_for_floors, find_floors, known_floors
from dafw.studies.outcomes import gather
from dafw.studies.results import write_results
from dafw.studies.study_files import study_of

FILTERS = {"etkf": ["filter=etkf"], "enkf": ["filter=enkf"]}
OTHERS = {"slow": ["model.speed=0.25", "truth.speed=0.5"], "short": ["cycles=3"]}


def made(**entries):
    small = ["experiment=linear_advection", "members=4", "cycles=4", "model.cells=20", "model.length=20"]
    return study_of("made", {"overrides": small, "configurations": FILTERS, "seeds": "1-2", "floor": True, **entries})


@pytest.fixture
def searches(monkeypatch):
    """Replace the search; return what was searched for. The n-th search finds 10 n per cent."""
    asked = []

    def search(study, *, any_seed):
        assert any_seed and study.seed == 0
        asked.append((study.model.speed, study.truth.speed, study.cycles))
        return Floor(10.0 * len(asked), {"wind": 1.0}, 5)

    monkeypatch.setattr(floors, "floor_of", search)
    return asked


def found(study, folder):
    find_floors(study, folder, composed_for_floors(study))
    return known_floors(study, folder)


def test_configurations_that_differ_in_the_filter_share_a_search(searches, tmp_path):
    assert found(made(configurations=FILTERS | OTHERS), tmp_path) == {"etkf": 10, "enkf": 10, "slow": 20, "short": 30}
    assert searches == [(1.0, 1.0, 4), (0.25, 0.5, 4), (1.0, 1.0, 3)]


def test_what_is_known_is_not_searched_for_again(searches, tmp_path):
    found(made(), tmp_path)
    before = (tmp_path / FILE).read_bytes()
    assert found(made(seeds="3-9"), tmp_path) == {"etkf": 10, "enkf": 10} and len(searches) == 1
    assert (tmp_path / FILE).read_bytes() == before
    assert found(made(configurations=FILTERS | OTHERS), tmp_path)["short"] == 30 and len(searches) == 3


def test_a_search_that_fails_leaves_the_others_and_names_its_configuration(searches, tmp_path, monkeypatch):
    study = made(configurations=FILTERS | OTHERS)
    composed, search = composed_for_floors(study), floors.floor_of

    def fails_then(one, **options):
        if one.cycles == 3:
            raise SolverError("no wind")
        return search(one, **options)

    monkeypatch.setattr(floors, "floor_of", fails_then)
    with pytest.raises(SolverError, match=r"^configuration 'short': floor: no wind$"):
        find_floors(study, tmp_path, composed)
    assert known_floors(study, tmp_path) == {"etkf": 10, "enkf": 10, "slow": 20}
    monkeypatch.setattr(floors, "floor_of", search)
    assert found(study, tmp_path)["short"] == 30 and len(searches) == 3


def test_overrides_of_the_search_make_configurations_comparable(searches, tmp_path):
    same = ["model.speed=0.75", "truth.speed=0.75", "cycles=4"]
    study = made(configurations=FILTERS | OTHERS, floor=same)
    assert set(found(study, tmp_path).values()) == {10} and searches == [(0.75, 0.75, 4)]
    assert known_floors(made(configurations=FILTERS | OTHERS), tmp_path) == {}  # those would be other searches


def test_a_study_that_asks_for_no_floors_has_none(searches, tmp_path):
    study = made(floor=False)
    assert composed_for_floors(study) == {}
    find_floors(study, tmp_path, {})
    assert searches == [] and not (tmp_path / FILE).exists()


@pytest.mark.parametrize("floor", [3, "true", [], [1], {}, None])
def test_what_is_no_request_for_floors_is_refused(floor):
    with pytest.raises(ConfigurationError, match=r"study 'made': floor must be true, false or a list of overrides"):
        made(floor=floor)


def test_overrides_that_are_not_accepted_are_refused_by_name():
    with pytest.raises(ConfigurationError, match=r"^configuration 'etkf': floor: .*'spede'"):
        composed_for_floors(made(floor=["model.spede=1"]))


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / FILE).write_text("{")
    with pytest.raises(RunError, match=FILE):
        known_floors(made(), tmp_path)


def test_the_results_have_the_floors_and_what_beliefs_make_of_them(searches, tmp_path):
    study = made(configurations=FILTERS | {"perfect": ["cycles=5"]})
    found(study, tmp_path)
    kept = json.loads((tmp_path / FILE).read_text())
    kept["floors"]["perfect"]["err"] = 1e-5  # a truth that the model can be
    (tmp_path / FILE).write_text(json.dumps(kept))
    for name, errors in {"etkf": (12, 16), "enkf": (8, 9), "perfect": (1, 1)}.items():
        for seed, err in zip((1, 2), errors, strict=True):
            make_run(tmp_path / "runs" / name / f"seed={seed}", [90, err])
    summary = write_results(study, tmp_path, pictures=False)
    etkf, enkf, perfect = summary["configurations"]
    assert (etkf["floor"], etkf["median_err_over_floor"]) == (10, pytest.approx(1.4))
    assert etkf["intervals"]["median_err_over_floor"] == pytest.approx([1.2, 1.6])
    assert (enkf["floor"], enkf["median_err_over_floor"]) == (10, pytest.approx(0.85))
    assert (perfect["floor"], perfect["median_err_over_floor"]) == (1e-5, None)
    heading, _, first, *_ = (line.split("|")[1:-1] for line in summary["table"].splitlines())
    cells = dict(zip(map(str.strip, heading), map(str.strip, first), strict=True))
    assert (cells["floor"], cells["ERR / floor"]) == ("10.0 %", "1.40 (1.20 to 1.60)")
    with xarray.open_dataset(tmp_path / "study.nc") as results:
        np.testing.assert_array_equal(results["floor"], [10.0, 10.0, 1e-5])
        assert results["floor"].dims == ("configuration",) and results["floor"].attrs["units"] == "percent"


def test_a_floor_that_is_not_known_yet_is_missing_from_the_results(tmp_path):
    make_run(tmp_path / "runs" / "etkf" / "seed=1", [90, 10])
    assert np.isnan(gather(made(), tmp_path)["floor"]).all()
    assert "floor" not in gather(made(floor=False), tmp_path)
    assert "floor" not in write_results(made(), tmp_path, pictures=False)["table"]
