"""A fresh environment with the built wheels of dafw and acme, like a user's; made offline, once a session."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from waiting import PATIENCE

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Environment:
    """The ``bin`` folder of an environment, and a method that runs commands with it."""

    bin: Path

    def run(
        self,
        *words: str | Path,
        cwd: Path,
        path: Path | None = None,
        programs: Path | None = None,
        commands: int = 1,
        **more: str,
    ) -> subprocess.CompletedProcess[str]:
        """Run a command of the environment.

        ``path``: a folder with further installed packages; ``programs``: a folder with programs that are used instead
        of the environment's; ``commands``: how many commands a script has, each of which may take its time; ``more``:
        variables.
        """
        surroundings = self.variables(more)
        if path is not None:
            surroundings["PYTHONPATH"] = str(path)
        command = [str(word) for word in words]
        if programs is not None:
            surroundings["PATH"] = f"{programs}{os.pathsep}{surroundings['PATH']}"
        if command[0] != "sh":
            command[0] = str((self.bin if programs is None else programs) / command[0])
        patience = PATIENCE * max(1, commands)
        return subprocess.run(command, cwd=cwd, env=surroundings, capture_output=True, text=True, timeout=patience)

    def variables(self, more: Mapping[str, str]) -> dict[str, str]:
        """Return the variables of a process of the environment, with ``more`` of them."""
        surroundings = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST_"))}
        # The MPI library is beside the packages, where only their own environment looks for it.
        surroundings |= {"LD_LIBRARY_PATH": f"{sysconfig.get_path('data')}/lib"}
        surroundings |= {"PATH": f"{self.bin}{os.pathsep}{os.environ['PATH']}", "OMP_NUM_THREADS": "1", **more}
        # The usual pip, but without the network: dependencies and build tools are installed already.
        offline = {"NO_INDEX": "1", "NO_DEPS": "1", "NO_BUILD_ISOLATION": "0", "DISABLE_PIP_VERSION_CHECK": "1"}
        return surroundings | {f"PIP_{name}": value for name, value in offline.items()}


@cache
def environment() -> Environment:
    """Build the wheels of dafw and acme and install them into a new environment; its other packages are ours."""
    folder = Path(tempfile.mkdtemp(prefix="dafw-fresh-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for source in (ROOT, ROOT / "tests" / "acme"):
        build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "wheels")]
        subprocess.run(build, cwd=source, check=True, capture_output=True, timeout=PATIENCE)
    venv.create(folder / "environment", with_pip=True)
    fresh = Environment(folder / "environment" / "bin")
    site = fresh.run("python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder)
    (Path(site.stdout.strip()) / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    installed = fresh.run("python", "-m", "pip", "install", *(folder / "wheels").glob("*.whl"), cwd=folder)
    assert installed.returncode == 0, installed.stderr
    copy_loops(ROOT / "dafw", Path(site.stdout.strip()) / "dafw")
    return fresh


def copy_loops(source: Path, target: Path) -> None:
    """Copy what numba has compiled of the same modules, which takes it long; it knows them by their size and time."""
    for index in source.rglob("*.nbi"):
        module = index.relative_to(source).parent.parent / f"{index.name.partition('.')[0]}.py"
        both = (source / module, target / module)
        if all(one.is_file() for one in both) and both[0].read_bytes() == both[1].read_bytes():
            at = (source / module).stat()
            os.utime(target / module, ns=(at.st_atime_ns, at.st_mtime_ns))
            kept = (target / module).parent / "__pycache__"
            kept.mkdir(exist_ok=True)
            for file in index.parent.glob(f"{module.stem}.*.nb?"):
                shutil.copy2(file, kept)


@cache
def prepared() -> Path:
    """Return a folder with programs ``dafw`` and ``python`` whose processes have imported the libraries already."""
    folder = Path(tempfile.mkdtemp(prefix="dafw-prepared-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    fresh = environment()
    server = subprocess.Popen(
        [fresh.bin / "python", ROOT / "tests" / "prepared.py", folder],
        env=fresh.variables({"MPLBACKEND": "Agg"}),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    atexit.register(server.kill)
    assert server.stdout is not None
    assert server.stdout.readline() == "ready\n"
    return folder
