"""Combinations of built-in parts either run to their end or are refused in one line before anything is computed.

All that must be refused are tried. Of those that run there are hundreds, which differ in ever fewer ways: so many are
tried that any three parts that can meet do meet in one of them. ``pytest --all-combinations`` tries them all.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from dafw import RequestError
from dafw.core.experiment import study_from
from dafw.core.registry import registry
from dafw.core.runs import open_run
from dafw.studies.running import run_study

KINDS = ("model", "observer", "policy", "filter")
CYCLES, MEMBERS = 3, 6

SMALL = {
    "linear_advection": {"cells": 5, "waves": 1},
    "lorenz96": {"size": 5, "spinup": 10},
    "ad": {"coarse_mesh": {"far_size": 90.0}},
    "ad_ins": {"coarse_mesh": {"far_size": 90.0}},
}
"""Options beside those under which ``dafw check`` makes a model (the flagship's has 200 nodes): fewer numbers than
members, and a coarser version."""

ONE_ANALYSIS = {
    "esmda": {"every": CYCLES, "iterations": 1},
    "ienks": {"every": CYCLES, "iterations": 1},
    "restart_enkf": {"every": CYCLES},
    "amis": {"every": CYCLES, "steps": 2 * CYCLES * MEMBERS},
    "smc": {"every": CYCLES, "steps": 2 * CYCLES * MEMBERS},
    "local": {"base": {"name": "amis", "every": CYCLES, "steps": 2 * CYCLES * MEMBERS}},
    "coarse_search": {"base": {"name": "amis", "every": CYCLES, "steps": 2 * CYCLES * MEMBERS}, "renew": CYCLES},
}
"""Options of filters that run the model again, with which they do so twice: winds take their time."""

QUICK_WINDS = {"wind": {"solver": "reduced", "basis": {"directions": 4, "levels": 1, "modes": 6, "tolerance": 1.0}}}
"""Winds from a reduced basis, as in the default study, for combinations that run the model again; others solve them."""

READS = {"linear_advection": "u", "lorenz96": "x", "puffs": "path_mean", "puffs_track": "mean"}
"""The state variable for observers and policies, if it is not the concentration."""

STEP = {"path_mean": 60.0, "mean": 60.0}
"""Time steps, in s, of models that have longer ones than 1 s, by this variable."""

PLACES = "no coordinates in the plane"
WITHOUT_PLACES = ("linear_advection", "lorenz96", "puffs_track")
MISFITS = {
    ("model", "observer"): {
        (model, observer): PLACES  # variables without coordinates: there are no places to fly to or for stations
        for model in WITHOUT_PLACES
        for observer in ("drone", "stations", "composite", "path")
    }
    | {("puffs", "path"): "no triangles"},  # its places are the middles of paths
    ("model", "policy"): {(model, policy): PLACES for model in WITHOUT_PLACES for policy in ("enie2d", "look_ahead")},
    ("model", "filter"): {
        **{(model, "kalman"): "filter 'kalman'" for model in ("ad", "ad_ins", "puffs", "puffs_track")},  # N < n
        **{("linear_advection", filter_): "how likely" for filter_ in ("amis", "smc", "local", "coarse_search")},
        # (no density in R^n)
        **{(model, "coarse_search"): "no coarser version" for model in ("lorenz96", "puffs", "puffs_track")},
        **{(model, "local"): "a variable with places" for model in ("lorenz96", "puffs_track")},
    },
}
"""Parts that do not fit together, and the message of the refusal."""


def built_in(kind):
    """Return the names of dafw's own plugins of a kind."""
    return [r.spec.name for r in registry().plugins() if r.spec.kind == kind and r.spec.target.startswith("dafw.")]


def options(kind, name, variable):
    """Return the configuration of a part that uses ``variable``."""
    made = {"name": name, **registry().plugin_class(kind, name).check_options()}
    if name == "stations":
        made["positions"] = [[10.0, 60.0] if variable == "path_mean" else [-6.0, -30.0]]
        made["every"] = STEP.get(variable, 1.0)
    if name == "route":
        made["points"] = [[-6.0, -60.0]]
    if name == "path":
        made["paths"] = {"north": [[-6.0, -60.0], [-6.0, -20.0]]}
        made["every"] = STEP.get(variable, 1.0)
    if name == "composite":
        made["parts"] = {part: options("observer", part, variable) for part in ("drone", "stations")}
    if kind != "model" and any(o.name == "variable" for o in registry().options(kind, name)):
        made["variable"] = variable
    return made


def reasons(names):
    """Return the messages of which one must refuse a combination; none if it runs."""
    parts = dict(zip(KINDS, names, strict=True))
    pairs = [(parts[a], parts[b], MISFITS[a, b]) for a, b in MISFITS]
    return [refused[one, other] for one, other, refused in pairs if (one, other) in refused]


def threes(names):
    """Return any three parts of a combination, each with its kind."""
    return set(combinations(zip(KINDS, names, strict=True), 3))


def few(fitting):
    """Return combinations in which any three parts meet that meet in one of ``fitting``: those with most news first."""
    left, chosen = set().union(*map(threes, fitting)), []
    for news in (4, 3, 2, 1):
        for names in fitting:
            if len(threes(names) & left) >= news:
                chosen.append(names)
                left -= threes(names)
    return chosen


COMBINATIONS = list(product(*map(built_in, KINDS)))
FITTING = [names for names in COMBINATIONS if not reasons(names)]
REFUSED = [names for names in COMBINATIONS if reasons(names)]


def pytest_generate_tests(metafunc):
    if "names" in metafunc.fixturenames:
        fitting = FITTING if metafunc.config.getoption("all_combinations") else few(FITTING)
        metafunc.parametrize("names", [*fitting, *REFUSED], ids="-".join)


def test_a_combination_runs_or_is_refused(names, tmp_path):
    parts = dict(zip(KINDS, names, strict=True))
    variable = READS.get(parts["model"], "concentration")
    configuration = {kind: options(kind, name, variable) for kind, name in parts.items()}
    configuration["model"] |= SMALL.get(parts["model"], {})
    configuration["filter"] |= ONE_ANALYSIS.get(parts["filter"], {})
    if parts["model"] == "ad_ins" and (parts["filter"] in ONE_ANALYSIS or parts["policy"] == "look_ahead"):
        configuration["model"] |= QUICK_WINDS
    start = [[-6.0, -20.0]] if variable == "concentration" else []
    configuration |= {"members": MEMBERS, "cycles": CYCLES, "vehicle": {"start": start}, "pictures": False}
    folder = tmp_path / "run"
    if expected := reasons(names):
        with pytest.raises(RequestError) as refusal:
            run_study(study_from(configuration), folder)
        assert "\n" not in str(refusal.value) and any(reason in str(refusal.value) for reason in expected)
        assert not folder.exists()
    else:
        assert run_study(study_from(configuration), folder)["status"] == "complete"
        with open_run(folder) as run:
            truth = run[f"{variable}_truth"]
            something = (truth != 0.0).any([dim for dim in truth.dims if dim != "time"])
            assert run.sizes["time"] == CYCLES + 1
            # Where the truth is zero, as before a leak arrives, there is no relative error.
            np.testing.assert_array_equal(run["err"].notnull(), something)


@pytest.mark.parametrize("policy", built_in("policy"))
def test_a_study_needs_no_vehicle(policy, tmp_path):
    configuration = {
        kind: options(kind, name, "concentration")
        for kind, name in zip(KINDS, ("ad", "drone", policy, "etkf"), strict=True)
    }
    study = study_from(configuration | {"members": MEMBERS, "cycles": CYCLES, "pictures": False})
    assert run_study(study, tmp_path / "run")["status"] == "complete"


def test_the_exceptions_are_few_and_about_parts_that_there_are():
    for kinds, pairs in MISFITS.items():
        for pair in pairs:
            assert all(name in built_in(kind) for kind, name in zip(kinds, pair, strict=True))
    assert len(FITTING) >= len(COMBINATIONS) // 3


def test_any_three_parts_that_can_meet_do_meet():
    assert set().union(*map(threes, few(FITTING))) == set().union(*map(threes, FITTING))
