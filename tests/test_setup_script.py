"""setup.sh in simulated environments: PATH has only a test's commands; uv and apt-get are imitations."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

from dafw.commands import doctor_findings, first_imports

CHECKOUT = Path(__file__).resolve().parents[1]
TOOLS = ["sh", "cat", "cksum", "dirname", "echo", "env", "flock", "ln", "mkdir", "mv", "rm", "sed", "sleep", "true"]

# Makes the files that uv would make and logs every call. FAIL names the part of a call that fails, with status 3.
UV = f"""
echo "uv $*" >>"$LOG"
case "$*" in *"${{FAIL:-nothing}}"*) exit 3 ;; *--help) exit 0 ;; esac
for last in "$@"; do :; done
if [ "$1" = venv ]; then mkdir -p "$last/bin"; ln -s {sys.executable} "$last/bin/python"; fi
"""

# Imitates dafw/commands/doctor.py: the file `lacking` beside it has the packages that the system lacks.
DOCTOR = """
import sys, pathlib
lacking = pathlib.Path(__file__).with_name("lacking").read_text()
print(lacking if "--packages" in sys.argv else f"MISSING {lacking}")
sys.exit("--system" in sys.argv and lacking != "")
"""

# Imitates dafw/commands/first_imports.py, and fails if the file `broken` is beside it.
IMPORTS = """
import sys, pathlib
sys.exit(pathlib.Path(__file__).with_name("broken").exists())
"""


class World:
    """A checkout with setup.sh, a folder of commands that is the whole PATH, and a log of what was called."""

    def __init__(self, folder: Path):
        self.checkout, self.bin, self.log = folder / "check out", folder / "bin", folder / "log"
        (self.checkout / "dafw" / "commands").mkdir(parents=True)
        self.bin.mkdir()
        self.sbin = folder / "sbin"
        self.sbin.mkdir()
        self.write("setup.sh", (CHECKOUT / "setup.sh").read_text().replace("/usr/sbin/", f"{self.sbin}/"))
        self.write("requirements.lock", "numpy==2\n")
        self.write("pyproject.toml", "[project]\n")
        self.write("dafw/commands/doctor.py", DOCTOR)
        self.write("dafw/commands/first_imports.py", IMPORTS)
        self.write("dafw/commands/lacking", "")
        for tool in TOOLS:
            if path := shutil.which(tool):
                (self.bin / tool).symlink_to(path)
        self.command("python3.12", f'exec {sys.executable} "$@"')
        self.command("uv", UV)
        self.command("id", "echo 0")
        self.command("openssl", "")

    def write(self, name: str, text: str) -> None:
        (self.checkout / name).write_text(text)

    def command(self, name: str, script: str, folder: Path | None = None) -> None:
        path = (folder or self.bin) / name
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)

    def start(self, *arguments: str, cwd: Path | None = None, **variables: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["/bin/sh", str(self.checkout / "setup.sh"), *arguments],
            cwd=cwd or self.bin,
            env={"PATH": str(self.bin), "HOME": str(self.bin), "LOG": str(self.log), **variables},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str, cwd: Path | None = None, **variables: str) -> tuple[int, str, str]:
        process = self.start(*arguments, cwd=cwd, **variables)
        out, err = process.communicate(timeout=PATIENCE)
        return process.returncode, out, err

    def calls(self, word: str) -> int:
        """Return how often a command with ``word`` was called since the last call of this function."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return sum(word in line and "--help" not in line for line in lines)


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_first_call_sets_up_and_runs_the_command_where_the_caller_stands(world, tmp_path):
    status, out, err = world.run("sh", "-c", 'pwd; echo "$PATH"', cwd=tmp_path)
    assert (status, out.splitlines()) == (0, [str(tmp_path), f"{world.checkout}/.venv/bin:{world.bin}"]), err
    log = [line for line in world.log.read_text().splitlines() if "--help" not in line]
    assert len(log) == 3
    assert log[0].startswith("uv venv") and str(world.bin / "python3.12") in log[0]
    assert "pip install" in log[1] and "--require-hashes -r requirements.lock" in log[1]
    assert "pip install" in log[2] and log[2].endswith("--no-deps --no-build-isolation -e .")


def test_what_cannot_be_imported_ends_the_set_up_and_is_tried_again(world):
    world.write("dafw/commands/broken", "")
    status, out, err = world.run("sh", "-c", "echo done")
    assert (status, out) == (1, "") and "cannot be imported" in err
    (world.checkout / "dafw/commands/broken").unlink()
    assert world.run("sh", "-c", "echo done")[:2] == (0, "done\n")


def test_the_modules_that_set_up_imports_are_there():
    assert all(importlib.util.find_spec(module) for module in first_imports.MODULES)


def test_second_call_needs_neither_uv_nor_words(world):
    world.run()
    (world.bin / "uv").unlink()
    assert world.run("sh", "-c", "echo done; exit 7") == (7, "done\n", "")


@pytest.mark.parametrize("changed", ["requirements.lock", "pyproject.toml"])
def test_what_changed_is_installed_into_the_environment_that_is_there(world, changed):
    world.run()
    world.calls("")
    world.write(changed, "something else\n")
    assert world.run()[0] == 0
    assert world.calls("uv pip install") == 2
    assert world.run()[0] == 0
    assert world.calls("uv") == 0


def test_a_moved_checkout_is_set_up_anew(world):
    world.run()
    world.calls("")
    world.checkout = world.checkout.rename(world.checkout.with_name("moved"))
    assert world.run()[0] == 0
    assert world.calls("-e .") == 1


@pytest.mark.parametrize(
    ("part", "said"), [("requirements.lock", "packages of requirements.lock"), ("-e .", "dafw itself")]
)
def test_a_half_environment_is_not_taken_for_whole(world, part, said):
    status, out, err = world.run("echo", "never", FAIL=part)
    assert (status, out) == (1, "") and said in err.splitlines()[-1]
    world.calls("")
    assert world.run("echo", "now")[:2] == (0, "now\n")
    assert world.calls("uv venv") == 1


def test_an_interrupted_set_up_is_started_over(world):
    world.command("uv", UV + 'if [ "$1" = pip ]; then kill -9 $PPID; fi')
    assert world.run("echo", "never")[:2] != (0, "never\n")
    world.calls("")
    world.command("uv", UV)
    assert world.run("echo", "now")[:2] == (0, "now\n")
    assert world.calls("uv venv") == 1


@pytest.mark.skipif(shutil.which("flock") is None, reason="without flock(1) set-ups do not wait for each other")
def test_of_two_at_once_one_sets_up_and_the_other_waits(world):
    # uv waits for the third call: then the second set-up has found the lock taken and tried again.
    (world.bin / "flock").unlink()
    world.command("flock", f'echo >>"$LOG.flock"; exec {shutil.which("flock")} "$@"')
    world.command("uv", UV + 'until [ "$(sed -n "$=" "$LOG.flock")" -ge 3 ]; do sleep 0.01; done')
    both = [world.start("echo", "done") for _ in range(2)]
    assert [process.communicate(timeout=PATIENCE)[0] for process in both] == ["done\n"] * 2
    assert world.calls("uv venv") == 1


def test_a_python_that_fails_is_passed_over(world, tmp_path):
    world.command("python3.12", "echo 'pyenv: python3.12: command not found' >&2; exit 127")
    hidden = tmp_path / "pyenv" / "versions" / "3.12.1" / "bin"
    hidden.mkdir(parents=True)
    world.command("python3", f'exec {sys.executable} "$@"', hidden)
    assert world.run(PYENV_ROOT=str(tmp_path / "pyenv"))[0] == 0
    assert world.calls(f"--python {hidden}/python3") == 1


def test_without_python_uv_may_download_one_and_else_it_is_named(world):
    (world.bin / "python3.12").unlink()
    assert world.run()[0] == 0
    assert world.calls("--managed-python --python 3.12") == 1
    shutil.rmtree(world.checkout / ".venv")
    status, _, err = world.run(FAIL="--python 3.12")
    assert status == 2 and "3.12" in err.splitlines()[-1] and "install" in err.splitlines()[-1]


def test_a_shim_of_uv_that_fails_is_replaced_by_a_private_uv(world):
    world.command("uv", "exit 127")
    # A Python whose venv has a pip that "installs" the imitation of uv.
    world.command("real-uv", UV)
    make = f'mkdir -p "$4/bin"; ln -sf {world.bin}/python3.12 "$4/bin/python"'
    pip = f'ln -sf {world.bin}/real-uv "${{0%/*}}/uv"'
    world.command(
        "python3.12", f'case "$*" in "-m venv"*) {make} ;; "-m pip"*) {pip} ;; *) exec {sys.executable} "$@" ;; esac'
    )
    status, _, err = world.run()
    assert status == 0 and "installing uv" in err
    assert (world.checkout / ".uv/tool/bin/uv").exists()
    assert world.calls("uv venv") == 1


def test_a_bare_machine_without_rights_gets_the_one_command(world):
    for name in ("uv", "python3.12"):
        (world.bin / name).unlink()
    world.command("id", "echo 1000")
    world.command("apt-get", 'echo "apt-get $*" >>"$LOG"')
    status, out, err = world.run("echo", "never")
    assert (status, out) == (2, "") and len(err.splitlines()) == 1
    command = re.search(r"sudo apt-get install .*", err)
    assert command and {"python3-venv", "gcc", "libglu1-mesa"} <= set(command[0].split())
    assert world.calls("apt-get") == 0


@pytest.mark.parametrize("user", ["0", "1000"])
def test_lacking_system_packages_are_installed_where_that_asks_no_password(world, user):
    world.write("dafw/commands/lacking", "gcc libxft2")
    world.command("id", f"echo {user}")
    world.command("sudo", '[ "$1" = -n ] && shift && exec "$@"')
    world.command("apt-get", 'echo "apt-get $*" >>"$LOG"')
    status, out, err = world.run("echo", "never")
    assert (status, out) == (2, "") and "MISSING gcc libxft2" in err, "the pretended doctor goes on complaining"
    assert "installing system packages: gcc libxft2" in err
    assert world.calls("install -y --no-install-recommends gcc libxft2") == 1
    world.write("dafw/commands/lacking", "")
    assert world.run("echo", "now")[:2] == (0, "now\n")


def test_lacking_packages_on_another_system_are_named(world):
    world.write("dafw/commands/lacking", "gcc")
    status, _, err = world.run()
    assert status == 2 and "package manager" in err.splitlines()[-1] and "gcc" in err.splitlines()[-1]


def test_setup_installs_all_that_the_doctor_may_name():
    listed = re.search(r'debian_packages="([^"]*)"', (CHECKOUT / "setup.sh").read_text())
    assert listed
    expected = {"python3-venv", "python3-dev", *doctor_findings.COMPILER_PACKAGES, *doctor_findings.LIBRARIES.values()}
    assert set(listed[1].replace("\\\n", "").split()) == expected


def _tests_without_a_browser(world: World, user: str) -> tuple[int, str, str]:
    world.run()
    world.command("mosquitto", "")
    world.command("id", f"echo {user}")
    world.command("apt-get", 'echo "apt-get $*" >>"$LOG"')
    for name in ("ruff", "mypy", "pytest"):
        world.command(name, f"echo {name}", world.checkout / ".venv/bin")
    world.calls("")
    return world.run("test")


def test_the_tests_get_a_browser_where_there_is_none(world):
    status, out, err = _tests_without_a_browser(world, "0")
    assert (status, out.split()) == (0, ["ruff", "ruff", "mypy", "pytest"])
    assert "installing system packages: chromium" in err
    assert world.calls("install -y --no-install-recommends chromium") == 1
    world.command("chromium", "")
    assert world.run("test")[2] == ""
    assert world.calls("apt-get") == 0


def test_without_rights_the_browser_is_named_and_the_other_tests_run(world):
    status, out, err = _tests_without_a_browser(world, "1000")
    assert (status, out.split()[-1]) == (0, "pytest")
    assert "sudo apt-get install -y --no-install-recommends chromium" in err
    assert err.splitlines()[-1] == "dafw: no browser: the tests of the page are skipped"
    assert world.calls("apt-get") == 0


def test_the_tests_get_a_broker_where_there_is_none(world):
    world.command("chromium", "")
    status, _, err = _tests_without_a_browser(world, "1000")
    assert status == 0 and "no broker" not in err
    (world.bin / "mosquitto").rename(world.sbin / "mosquitto")
    assert "no broker" not in world.run("test")[2]
    (world.sbin / "mosquitto").unlink()
    assert world.run("test")[2].splitlines()[-1] == "dafw: no broker: the tests of MQTT are skipped"


def _checks(world: World, failing: str) -> tuple[int, list[str]]:
    world.run()
    world.command("chromium", "")
    world.command("mosquitto", "")
    for name in ("ruff", "mypy", "pytest"):
        world.command(name, f'echo {name} "$@"; [ "{name} $1" != "{failing}" ] || exit 5', world.checkout / ".venv/bin")
    status, out, _ = world.run("test", "-k", "a word")
    return status, out.splitlines()


def test_test_is_lint_types_and_tests(world):
    tests = "pytest -q -n 2 --dist worksteal -k a word"
    assert _checks(world, "none") == (0, ["ruff check", "ruff format --check", "mypy", tests])


@pytest.mark.parametrize(
    ("failing", "reached"), [("ruff check", 1), ("ruff format", 2), ("mypy ", 3), ("pytest -q", 4)]
)
def test_test_stops_at_the_first_failure_with_its_status(world, failing, reached):
    status, lines = _checks(world, failing)
    assert (status, len(lines)) == (5, reached)


def test_continuous_integration_calls_the_test_command(tmp_path):
    (tmp_path / ".ci").mkdir()
    shutil.copy(CHECKOUT / ".ci/run", tmp_path / ".ci/run")
    (tmp_path / "setup.sh").write_text('echo "called with $*"; exit 4\n')
    done = subprocess.run(
        ["bash", str(tmp_path / ".ci/run")], stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd="/"
    )
    assert (done.returncode, done.stdout) == (4, "called with test\n")
