"""``dafw doctor`` on broken machines: nothing on PATH, a compiler that fails, missing libraries and packages."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tomllib
from collections import namedtuple
from pathlib import Path

import pytest

from dafw.commands import doctor, doctor_findings

SOURCES = (Path(doctor.__file__), Path(doctor_findings.__file__))
CHECKOUT = SOURCES[0].parents[2]


def _command(folder: Path, name: str, script: str) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


def test_it_needs_only_the_standard_library():
    program = f"import sys; sys.path.insert(0, {str(SOURCES[0].parent)!r}); import doctor; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, check=True)
    others = {name.partition(".")[0] for name in loaded.stdout.split()} - set(sys.stdlib_module_names)
    assert others == {"doctor", "doctor_findings", "__main__"} - set(sys.stdlib_module_names)


def test_it_can_be_run_by_its_path_where_nothing_is_installed(tmp_path):
    command = [sys.executable, "-S", "-E", str(SOURCES[0]), "--json"]
    refused = subprocess.run([*command, "--system"], cwd=tmp_path, capture_output=True, text=True)
    assert refused.returncode == 2 and "not allowed with argument --json" in refused.stderr
    done = subprocess.run([*command[:-1], "--system"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stderr == "" and "Python headers" in done.stdout


def test_an_old_interpreter_can_read_it():
    for source in SOURCES:
        ast.parse(source.read_text(), feature_version=(3, 9))


def test_it_knows_every_package_that_the_project_needs():
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    needed = {requirement.partition(">")[0] for requirement in project["dependencies"]}
    assert needed == set(doctor_findings.PACKAGES.values())


def test_the_wrong_interpreter_is_named(monkeypatch):
    assert doctor_findings._interpreter().ok
    monkeypatch.setattr(doctor_findings, "PYTHON_BELOW", sys.version_info[:2])
    finding = doctor_findings._interpreter()
    assert not finding.ok and sys.executable in finding.found and finding.remedy


def test_a_compiler_that_works_is_found(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    finding = doctor_findings._compiler()
    assert finding.ok, finding.found


def test_no_compiler_on_path(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    finding = doctor_findings._compiler()
    assert not finding.ok and "not on PATH" in finding.found
    assert finding.packages == ("gcc", "libc6-dev") and "gcc libc6-dev" in finding.remedy


def test_a_compiler_without_the_headers_of_libc(monkeypatch, tmp_path):
    said = "probe.c:1:10: fatal error: stdio.h: No such file or directory"
    _command(tmp_path, "gcc", f"echo 'In file included'; echo '{said}' >&2; echo 'compilation ended.'; exit 1")
    _command(tmp_path, "apt-get", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(doctor_findings.sysconfig, "get_config_var", lambda name: "gcc -pthread")
    monkeypatch.setenv("PATH", str(tmp_path))
    finding = doctor_findings._compiler()
    assert not finding.ok and finding.found == f"{tmp_path}/gcc compiles nothing: {said}"
    assert finding.remedy.endswith("apt-get install -y gcc libc6-dev")


def test_a_compiler_asked_for_by_variable_that_is_not_there(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -O2")
    finding = doctor_findings._compiler()
    assert not finding.ok and "'no-such-compiler'" in finding.found and finding.remedy == "unset CC"


def test_headers_of_python(monkeypatch, tmp_path):
    assert doctor_findings._headers().ok
    monkeypatch.setattr(doctor_findings.sysconfig, "get_paths", lambda: {"include": str(tmp_path)})
    monkeypatch.setattr(doctor_findings.sys, "base_prefix", "/usr")
    finding = doctor_findings._headers()
    assert not finding.ok and finding.packages == (f"python{sys.version_info[0]}.{sys.version_info[1]}-dev",)
    monkeypatch.setattr(doctor_findings.sys, "base_prefix", "/opt/own")
    finding = doctor_findings._headers()
    assert not finding.ok and finding.packages == () and "/opt/own" in finding.remedy


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere gmsh brings its libraries")
def test_missing_libraries_come_with_the_packages_that_bring_them(monkeypatch, tmp_path):
    assert doctor_findings._libraries().ok
    libraries = {"libc.so.6": "libc6", "libnone.so.9": "libnone9", "libno.so": "libno1"}
    monkeypatch.setattr(doctor_findings, "LIBRARIES", libraries)
    monkeypatch.setenv("PATH", str(tmp_path))
    finding = doctor_findings._libraries()
    assert not finding.ok and finding.found == "missing: libnone.so.9, libno.so"
    assert finding.packages == ("libnone9", "libno1")
    assert "package manager" in finding.remedy and "libnone9 libno1" in finding.remedy


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (None, "No module named 'odd'"),
        ("raise RuntimeError('first line\\nlast line')", "last line"),
        ("import os; os.abort()", "ended with status -6"),
    ],
)
def test_a_package_that_does_not_import(monkeypatch, tmp_path, source, said):
    if source is not None:
        (tmp_path / "odd.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(doctor_findings.PACKAGES, "odd", "odd-package")
    finding = doctor_findings._package("odd")
    assert finding.name == "odd-package" and not finding.ok and said in finding.found and finding.remedy


def test_a_package_whose_library_is_missing_is_not_installed_again(monkeypatch, tmp_path):
    said = "libodd.so.1: cannot open shared object file: No such file or directory"
    (tmp_path / "odd.py").write_text(f"raise OSError({said!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(doctor_findings.PACKAGES, "odd", "odd-package")
    finding = doctor_findings._package("odd")
    assert not finding.ok and said in finding.found and "library" in finding.remedy


def test_a_package_that_imports_tells_its_version():
    finding = doctor_findings._package("pluggy")
    assert finding.ok and finding.found[0].isdigit()


def test_what_setup_made_and_is_broken_is_made_anew(monkeypatch):
    checkout = CHECKOUT
    monkeypatch.setattr(doctor_findings.sys, "prefix", str(checkout / ".venv"))
    assert doctor_findings._set_up("-") == f"rm -rf {checkout}/.venv && sh {checkout}/setup.sh"
    monkeypatch.setattr(doctor_findings.sys, "prefix", "/usr")
    assert doctor_findings._set_up("-") == f"sh {checkout}/setup.sh"
    monkeypatch.setattr(doctor_findings, "__file__", "/usr/lib/python3/dafw/commands/doctor_findings.py")
    assert doctor_findings._set_up("pip install it") == "pip install it"


def test_cache_folder_that_cannot_be_written(monkeypatch, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("DAFW_CACHE", str(file / "cache"))
    assert doctor_findings.cache_folder() == file / "cache"
    finding = doctor_findings._writable("cache", doctor_findings.cache_folder(), "elsewhere")
    assert not finding.ok and str(file / "cache") in finding.found and finding.remedy == "elsewhere"
    assert doctor_findings._writable("cache", tmp_path / "new" / "one", "elsewhere").ok


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MPI shares memory by other means")
def test_shared_memory_that_cannot_be_written(monkeypatch, tmp_path):
    assert doctor_findings._shared_memory().ok
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(doctor_findings, "SHARED_MEMORY", tmp_path / "file" / "shm")
    finding = doctor_findings._shared_memory()
    assert not finding.ok and "mount -t tmpfs" in finding.remedy


def test_the_fullest_disk_counts(monkeypatch, tmp_path):
    usage = namedtuple("usage", "free")
    free = {str(tmp_path): doctor_findings.FREE_SPACE - 1, str(Path.cwd()): doctor_findings.FREE_SPACE}
    monkeypatch.setattr(doctor_findings.shutil, "disk_usage", lambda folder: usage(free[str(folder)]))
    finding = doctor_findings._space(tmp_path / "not" / "yet")
    assert not finding.ok and str(tmp_path) in finding.found
    free[str(tmp_path)] = doctor_findings.FREE_SPACE
    assert doctor_findings._space(tmp_path).ok


GOOD = doctor_findings.Finding("good", True, "as it should be")
BAD = doctor_findings.Finding("a longer name", False, "gone", "fetch it", ("one", "two"))


def test_table_and_exit_status(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "diagnose", lambda: [GOOD, BAD])
    assert doctor.doctor_command([]) == 1
    good, bad, remedy, last = capsys.readouterr().out.splitlines()
    assert good.split() == ["ok", "good", "as", "it", "should", "be"]
    assert bad.startswith("MISSING") and bad.index("gone") == good.index("as it") == remedy.index("mend: fetch it")
    assert last == "1 of 2 need mending"
    monkeypatch.setattr(doctor, "diagnose", lambda: [GOOD])
    assert doctor.doctor_command([]) == 0


def test_json_holds_all_findings(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "diagnose", lambda: [GOOD, BAD])
    assert doctor.doctor_command(["--json"]) == 1
    good, bad = json.loads(capsys.readouterr().out)
    assert good["ok"] is True
    assert bad == {
        "name": "a longer name",
        "ok": False,
        "found": "gone",
        "remedy": "fetch it",
        "packages": ["one", "two"],
    }


def test_the_script_names_each_lacking_package_once(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "diagnose_system", lambda: [GOOD, BAD, BAD])
    assert doctor.doctor_command(["--packages"]) == 0
    assert capsys.readouterr().out == "one two\n"
    assert doctor.doctor_command(["--system"]) == 1


def test_diagnosis_covers_system_and_packages(monkeypatch):
    monkeypatch.setattr(doctor_findings, "PACKAGES", {"pluggy": "pluggy", "no_such_module": "none"})
    findings = {finding.name: finding for finding in doctor_findings.diagnose()}
    assert {"Python", "C compiler", "Python headers", "libraries of gmsh", "disk space"} < set(findings)
    assert findings["pluggy"].ok and not findings["none"].ok
