"""Checks what dafw needs from the machine: what is there, what is missing, and the command that fixes it.

Only the standard library and syntax of Python 3.9 are used, and nothing of dafw is imported; doctor.py beside this file
explains why.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

GIGABYTE = 10**9
FREE_SPACE = 2 * GIGABYTE  # bytes: enough for a paper-size run with whole ensembles and the caches
PYTHON_FROM, PYTHON_BELOW = (3, 12), (3, 14)  # hydra-core 1.3 fails on 3.14
IMPORT_TIMEOUT = 180  # seconds; the first import of PETSc from disk may be slow

# The modules to import -> the distribution that brings them. dolfinx_solver puts PETSc and MPI where dolfinx looks.
PACKAGES = {
    "dask.array": "dask",
    "dolfinx_solver, dolfinx": "dolfinx-solver-real",
    "filelock": "filelock",
    "filterpy": "filterpy",
    "gmsh": "gmsh",
    "hydra": "hydra-core",
    "matplotlib": "matplotlib",
    "netCDF4": "netcdf4",
    "numba": "numba",
    "numpy": "numpy",
    "PIL": "pillow",
    "pint": "pint",
    "platformdirs": "platformdirs",
    "psutil": "psutil",
    "pluggy": "pluggy",
    "pyproj": "pyproj",
    "scipy": "scipy",
    "shapely": "shapely",
    "scoringrules": "scoringrules",
    "threadpoolctl": "threadpoolctl",
    "tqdm": "tqdm",
    "xarray": "xarray",
}

# Libraries that gmsh's wheel links to and does not contain -> the Debian and Ubuntu package with each of them. The
# others that it needs (X11, Xext, Xfixes, Xrender, fontconfig; stdc++, z) come with these, or apt itself needs them.
LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libGLU.so.1": "libglu1-mesa",
    "libXcursor.so.1": "libxcursor1",
    "libXft.so.2": "libxft2",
    "libXinerama.so.1": "libxinerama1",
    "libgomp.so.1": "libgomp1",
}
SHARED_MEMORY = Path("/dev/shm")
COMPILER_PACKAGES = ("gcc", "libc6-dev")

PROGRAM = '#include <stdio.h>\n#include <math.h>\nint main(void) { return printf("%f", sin(1.0)) < 0; }\n'


@dataclass(frozen=True)
class Finding:
    """One checked item: what was found, the command that fixes it, the Debian packages that it needs."""

    name: str
    ok: bool
    found: str
    remedy: str = ""
    packages: tuple[str, ...] = ()


def diagnose() -> list[Finding]:
    """Check everything that dafw needs; a missing item is returned as a finding, never raised as an exception."""
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        packages = list(pool.map(_package, PACKAGES))
    return diagnose_system() + packages


def diagnose_system() -> list[Finding]:
    """Check everything but the Python packages; this takes a fraction of a second."""
    cache = cache_folder()
    forms = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics"
    return [
        _interpreter(),
        _compiler(),
        _headers(),
        _libraries(),
        _writable("cache of dafw", cache, "set DAFW_CACHE to a folder that you may write"),
        _writable("cache of compiled forms", forms, "set XDG_CACHE_HOME to a folder that you may write"),
        _shared_memory(),
        _space(cache),
    ]


def cache_folder() -> Path:
    """Return the folder of dafw's caches: the variable DAFW_CACHE, or the user's cache folder on this platform."""
    if os.environ.get("DAFW_CACHE"):
        return Path(os.environ["DAFW_CACHE"])
    try:
        from platformdirs import user_cache_dir
    except ImportError:  # the report then names platformdirs as missing; on Linux this is the same folder
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dafw"
    return Path(user_cache_dir("dafw"))


def _interpreter() -> Finding:
    version = sys.version_info[:3]
    wanted = f"Python >= {PYTHON_FROM[0]}.{PYTHON_FROM[1]}, < {PYTHON_BELOW[0]}.{PYTHON_BELOW[1]}"
    found = f"{'.'.join(map(str, version))} ({sys.executable})"
    if PYTHON_FROM <= version[:2] < PYTHON_BELOW:
        return Finding("Python", True, found)
    return Finding("Python", False, f"{found}; needed: {wanted}", _set_up("install Python 3.12 and dafw in it"))


def _compiler() -> Finding:
    """Find the compiler. FFCx needs one: the variable CC, or else the compiler that built this Python."""
    name = "C compiler"
    command = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    path = shutil.which(command[0])
    remedy = "unset CC" if os.environ.get("CC") else _install(COMPILER_PACKAGES)
    if path is None:
        return Finding(name, False, f"'{command[0]}' is not on PATH", remedy, COMPILER_PACKAGES)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "probe.c")
        source.write_text(PROGRAM, encoding="ascii")
        status, output = _run([path, *command[1:], str(source), "-o", str(Path(folder, "probe")), "-lm"], timeout=60)
    if status != 0:
        return Finding(name, False, f"{path} compiles nothing: {_first_error(output)}", remedy, COMPILER_PACKAGES)
    return Finding(name, True, f"{path}, compiles and links")


def _headers() -> Finding:
    """Find Python.h, which FFCx's code includes and which Linux distributions put into a package of its own."""
    header = Path(sysconfig.get_paths()["include"], "Python.h")
    if header.is_file():
        return Finding("Python headers", True, str(header))
    package = f"python{sys.version_info[0]}.{sys.version_info[1]}-dev"
    if sys.base_prefix == "/usr":
        return Finding("Python headers", False, f"{header} is missing", _install([package]), (package,))
    return Finding("Python headers", False, f"{header} is missing", f"install Python anew in {sys.base_prefix}")


def _libraries() -> Finding:
    name = "libraries of gmsh"
    if sys.platform != "linux":
        return Finding(name, True, f"come with the package on {sys.platform}")
    missing = [library for library in LIBRARIES if not _loads(library)]
    if not missing:
        return Finding(name, True, f"all {len(LIBRARIES)} load")
    packages = tuple(LIBRARIES[library] for library in missing)
    return Finding(name, False, f"missing: {', '.join(missing)}", _install(packages), packages)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _package(modules: str) -> Finding:
    """Import in a separate process, because a broken library may crash the interpreter."""
    distribution = PACKAGES[modules]
    program = f"import {modules}\nfrom importlib.metadata import version\nprint('version', version({distribution!r}))\n"
    status, output = _run([sys.executable, "-W", "ignore", "-c", program], timeout=IMPORT_TIMEOUT)
    lines = output.strip().splitlines() or [f"import {modules} ended with status {status}"]
    if status == 0:
        return Finding(distribution, True, lines[-1].replace("version ", ""))
    if "cannot open shared object file" in lines[-1]:
        return Finding(distribution, False, lines[-1], "install the system package that brings this library")
    return Finding(distribution, False, lines[-1], _set_up(f"{sys.executable} -m pip install {distribution}"))


def _writable(name: str, folder: Path, remedy: str) -> Finding:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return Finding(name, True, str(folder))
    except OSError as error:
        return Finding(name, False, f"{folder}: {error.strerror}", remedy)


def _shared_memory() -> Finding:
    """Check shared memory, without which MPI does not start, not even with one process."""
    if sys.platform != "linux":
        return Finding("shared memory", True, f"needs nothing on {sys.platform}")
    return _writable("shared memory", SHARED_MEMORY, f"as root: mount -t tmpfs -o mode=1777 tmpfs {SHARED_MEMORY}")


def _space(cache: Path) -> Finding:
    """Check free disk space in the current folder (results) and in the cache (meshes and reduced winds)."""
    folders = [Path.cwd(), next(folder for folder in (cache, *cache.absolute().parents) if folder.exists())]
    free, folder = min((shutil.disk_usage(folder).free, str(folder)) for folder in folders)
    found = f"{free / GIGABYTE:.1f} GB free at {folder}"
    if free >= FREE_SPACE:
        return Finding("disk space", True, found)
    return Finding("disk space", False, found, f"free {FREE_SPACE / GIGABYTE:.0f} GB there, or work elsewhere")


def _run(command: list[str], timeout: float) -> tuple[int, str]:
    """Return the exit status and all output of a command; a failed start or a timeout counts as a failure."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout,
            encoding="utf-8",
            errors="replace",
        )
    except OSError as error:
        return 126, str(error)
    except subprocess.TimeoutExpired:
        return 124, f"no answer within {timeout:.0f} s"
    return done.returncode, done.stdout


def _first_error(output: str) -> str:
    lines = output.strip().splitlines() or ["it said nothing"]
    return next((line for line in lines if "error" in line.lower()), lines[-1])


def _install(packages: tuple[str, ...] | list[str]) -> str:
    names = " ".join(packages)
    if shutil.which("apt-get") is None:
        return f"install with the system's package manager what Debian calls {names}"
    return f"{'' if os.geteuid() == 0 else 'sudo '}apt-get install -y {names}"


def _set_up(otherwise: str) -> str:
    """Return the command that fixes the environment: in a checkout setup.sh, after removing what it would keep."""
    checkout = Path(__file__).resolve().parents[2]
    if not (checkout / "setup.sh").is_file():
        return otherwise
    broken = Path(sys.prefix).resolve() == checkout / ".venv"
    return f"rm -rf {checkout}/.venv && sh {checkout}/setup.sh" if broken else f"sh {checkout}/setup.sh"
