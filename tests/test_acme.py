"""A third-party package: its wheel and dafw's in a fresh environment, used from an empty folder; broken packages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from fresh import ROOT, environment

from dafw import open_run

ACME = (
    *("acme_rod", "acme_cooling", "acme_solver", "acme_probe", "acme_patrol", "acme_lookout"),
    *("acme_esmda", "acme_lag", "acme_nudging"),
)


def one_line(text: str) -> str:
    """Return the only line."""
    assert text.count("\n") == 1, text
    return text.strip()


def test_what_is_run_is_what_was_installed(tmp_path):
    shown = environment().run("python", "-c", "import dafw, acme; print(dafw.__file__, acme.__file__)", cwd=tmp_path)
    assert shown.stdout.count(str(environment().bin.parent)) == 2, shown


def test_acme_conforms(tmp_path):
    done = environment().run("dafw", "check", *ACME, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{len(ACME)} plugins checked, nothing to mend" in done.stdout
    assert "prior_kept           expected failure  nudging does not ask how good the readings are" in done.stdout


def test_acmes_parts_and_configuration_are_in_the_help(tmp_path):
    done = environment().run("dafw", "run", "--help", cwd=tmp_path)
    groups = dict(line.split(": ", 1) for line in done.stdout.splitlines() if ": " in line)
    assert "acme_rod" in groups["experiment"] and "acme_rod" in groups["model"]
    assert "acme_dense, acme_probe" in groups["observer"] and "acme_nudging" in groups["filter"]


def test_options_of_a_plain_function_are_listed(tmp_path):
    listed = json.loads(environment().run("dafw", "plugins", "--json", "acme_cooling", cwd=tmp_path).stdout)
    options = {option["name"]: (option["type"], option["default"]) for option in listed["plugins"][0]["options"]}
    assert options == {"dt": ("float", 1.0), "noise_sd": ("float", 0.0), "rate": ("float", 0.1)}


def test_acmes_experiment_mixes_its_parts_with_built_in_ones(tmp_path):
    done = environment().run("dafw", "run", "experiment=acme_rod", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.splitlines()[-1])
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "complete" and summary["err_final"] < summary["err_free_final"]
    assert summary["parts"]["model"] == summary["parts"]["truth"] == "acme_rod"
    assert (summary["parts"]["observer"], summary["parts"]["filter"]) == ("acme_probe", "etkf")
    assert summary["versions"]["acme"] == "1.0" and {"dafw", "python", "numpy"} <= set(summary["versions"])
    with open_run(folder) as run:
        assert {name: json.loads(run.attrs[name]) for name in ("parts", "versions")} == {
            name: summary[name] for name in ("parts", "versions")
        }
    shown = environment().run("dafw", "run", "experiment=acme_rod", "filter=acme_nudging", "--cfg", "job", cwd=tmp_path)
    assert "filter:\n  name: acme_nudging\n  strength: 0.3\n" in shown.stdout
    assert "observer:\n  name: acme_probe\n  every: 2\n" in shown.stdout


def test_acmes_study_is_run_like_any_other(tmp_path):
    done = environment().run("dafw", "study", "acme_filters", "--no-pictures", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.splitlines()[-1])
    assert folder == (tmp_path / "outputs" / "study_acme_filters").resolve()
    summary = json.loads((folder / "summary.json").read_text())
    assert {one["name"]: one["n_seeds"] for one in summary["configurations"]} == {"etkf": 1, "nudging": 1}
    with open_run(folder / "runs" / "nudging" / "seed=1") as run:
        assert json.loads(run.attrs["parts"])["filter"] == "acme_nudging"


def test_a_wrong_choice_lists_acmes_too(tmp_path):
    run = environment().run
    assert "(there are: acme_rod, " in one_line(run("dafw", "run", "experiment=rod", cwd=tmp_path).stderr)
    wrong = one_line(run("dafw", "run", "observer=acme_dens", cwd=tmp_path).stderr)
    assert "configured ones: acme_dense" in wrong


# Broken third-party packages, installed as a folder of packages on the path. ------------------------------------------

SPEC = "from dafw import PluginSpec, hookimpl\n\n@hookimpl\ndef {hook}():\n    return [{specs}]\n"
HEAD = """\
from dataclasses import dataclass
import numpy as np
from dafw import Analysis, Filter, Model, StateSpace, Variable

@dataclass
class Base(Model):
    dt: float = 1.0
    heating: float = 0.0
    def __post_init__(self):
        self.space = StateSpace([Variable("x", 3)])
    def initial(self, n_members, rng):
        return rng.standard_normal((n_members, 3))
    def step(self, members, t, rng):
        return members

"""
FAULTS = {
    "bad_shape": ("filter", "class Bad(Filter):\n    def analyse(self, f, p, o, r): return Analysis(f.members[:, :1])"),
    "bad_nan": ("model", "class Bad(Base):\n    def step(self, members, t, rng): return np.nan * members"),
    "bad_raise": ("model", "class Bad(Base):\n    def step(self, members, t, rng): raise KeyError('wind')"),
    "bad_import": ("filter", "import no_such_library"),
    "bad_options": ("policy", "from dafw import Policy\nclass Bad(Policy):\n    pass"),
}


def install(folder: Path, package: str, code: str, **modules: str) -> None:
    """Write into ``folder`` the files that an installation of the package writes."""
    (folder / package).mkdir()
    (folder / package / "__init__.py").write_text(code)
    for module, text in modules.items():
        (folder / package / f"{module}.py").write_text(text)
    about = folder / f"{package}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[dafw]\n{package} = {package}\n")


@pytest.fixture(scope="module")
def broken(tmp_path_factory) -> Path:
    """Return a folder with every broken package."""
    folder = tmp_path_factory.mktemp("broken")
    specs = [f"PluginSpec('{kind}', '{name}', 'faults.{name}:Bad')" for name, (kind, _) in FAULTS.items()]
    dataclasses = {name: code.replace("class Bad", "@dataclass\nclass Bad") for name, (_, code) in FAULTS.items()}
    dataclasses["bad_options"] = FAULTS["bad_options"][1]
    modules = {name: HEAD + code + "\n" for name, code in dataclasses.items()}
    install(folder, "faults", SPEC.format(hook="dafw_plugins", specs=", ".join(specs)), **modules)
    install(folder, "lost", "import no_such_library\n")
    install(folder, "misspelt", SPEC.format(hook="dafw_plugin", specs=""))
    taken = "PluginSpec('filter', 'etkf', 'taken:Other'), PluginSpec('filter', 'own', 'taken:Own')"
    install(folder, "taken", SPEC.format(hook="dafw_plugins", specs=taken))
    (folder / "hydra_plugins" / "evil").mkdir(parents=True)
    path = (ROOT / "tests/acme/hydra_plugins/acme_search_path/__init__.py").read_text()
    (folder / "hydra_plugins" / "evil" / "__init__.py").write_text(
        path.replace("Acme", "Evil").replace('"acme", "pkg://acme.conf"', f'"evil", "file://{folder}/conf"')
    )
    (folder / "conf" / "experiment").mkdir(parents=True)
    (folder / "conf" / "experiment" / "evil.yaml").write_text(
        "# @package _global_\nhydra:\n  callbacks:\n    one:\n      _target_: faults.bad_nan.Bad\n"
    )
    return folder


def test_plugins_lists_the_others_and_what_is_wrong(broken, tmp_path):
    done = environment().run("dafw", "plugins", cwd=tmp_path, path=broken)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    for name in ("acme_rod", "ad_ins", "etkf", "bad_import", "own"):
        assert sum(line.split()[1] == name for line in lines) == 1, name
    problems = [line for line in lines if line.startswith("problem")]
    assert problems == [
        "problem   lost (lost): cannot be imported: ModuleNotFoundError: No module named 'no_such_library'",
        "problem   misspelt (misspelt): unknown hook 'dafw_plugin' (the hook is: dafw_plugins)",
        "problem   taken (taken): filter 'etkf' is taken already by dafw (dafw.plugins)",
    ]


RUN = ("dafw", "run", "experiment=acme_rod", "cycles=2")
SMALL = ("observer=grid", "policy=stationary")


@pytest.mark.parametrize(
    ("overrides", "status", "expected"),
    [
        (
            ["filter=bad_import"],
            2,
            "filter 'bad_import' of faults (faults): faults.bad_import:Bad cannot be imported",
        ),
        (["policy=bad_options"], 2, "policy 'bad_options': faults.bad_options.Bad is not a dataclass"),
        (["filter=bad_shape"], 1, "at t = 0 s, phase 'analyse': filter 'bad_shape': members after the analysis must "),
        (["model=bad_nan", *SMALL], 1, "model 'bad_nan': members after a step holds nan at (0, 0)"),
        (["model=bad_raise", *SMALL], 1, "phase 'forecast': model 'bad_raise' raised KeyError: 'wind'"),
        (["experiment=evil"], 2, "a configuration may not name code to be run, got 'faults.bad_nan.Bad'"),
    ],
)
def test_a_broken_plugin_is_one_clear_line(broken, tmp_path, overrides, status, expected):
    words = ("dafw", "run", *overrides) if "experiment=evil" in overrides else (*RUN, *overrides)
    done = environment().run(*words, cwd=tmp_path, path=broken)
    assert (done.returncode, expected in one_line(done.stderr)) == (status, True), done.stderr


def test_check_names_what_a_broken_plugin_does(broken, tmp_path):
    done = environment().run("dafw", "check", *FAULTS, cwd=tmp_path, path=broken)
    assert done.returncode == 1
    found = {" ".join(line.split()[1:3]): line for line in done.stdout.splitlines()}
    assert "failed" in found["'bad_shape' shapes"] and "must have the shape" in found["'bad_shape' shapes"]
    assert "failed" in found["'bad_nan' shapes"] and "holds nan" in found["'bad_nan' shapes"]
    assert "failed" in found["'bad_raise' shapes"] and "KeyError: 'wind'" in found["'bad_raise' shapes"]
    assert "no_such_library" in found["'bad_import' cannot"]
    assert "decorate it with @dataclass" in found["'bad_options' cannot"]


def test_an_unknown_name_is_a_wrong_request(broken, tmp_path):
    done = environment().run("dafw", "check", "nonesuch", cwd=tmp_path, path=broken)
    assert done.returncode == 2 and one_line(done.stderr).startswith("dafw: there is no plugin 'nonesuch' (there are: ")
