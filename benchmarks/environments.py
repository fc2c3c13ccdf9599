"""Other projects' packages, each in an environment of its own in the user's cache, made once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from dafw.core.errors import ComputationError

# One thread for all: small matrices gain nothing from more.
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}


def interpreter_with(*packages: str) -> Path:
    """Return the Python of an environment that holds nothing but ``packages``, such as ``dapper==1.8.1``."""
    from platformdirs import user_cache_path

    name = "-".join(package.replace("==", "-").replace("*", "x") for package in packages)
    folder = user_cache_path("dafw") / f"{name}-py{sys.version_info.major}.{sys.version_info.minor}"
    interpreter, ready = folder / "bin" / "python", folder / "ready"
    if not ready.exists():
        if uv := shutil.which("uv"):
            command([uv, "venv", "--clear", "--python", sys.executable, str(folder)])
            command([uv, "pip", "install", "--python", str(interpreter), *packages])
        else:
            command([sys.executable, "-m", "venv", "--clear", str(folder)])
            command([str(interpreter), "-m", "pip", "install", "--quiet", *packages])
        ready.touch()
    return interpreter


def worker_output(packages: str | Sequence[str], worker: str, arguments: Sequence[str]) -> str:
    """Return the last line that ``workers/WORKER`` prints in the environment of ``packages``."""
    script = Path(__file__).parent / "workers" / worker
    wanted = [packages] if isinstance(packages, str) else packages
    words = [str(interpreter_with(*wanted)), "-W", "ignore", str(script), *arguments]
    return command(words, {**os.environ, **ENVIRONMENT}).splitlines()[-1]


def command(words: Sequence[str], environment: dict[str, str] | None = None) -> str:
    """Return what a command prints; raises ComputationError with its last line if it fails."""
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        raise ComputationError(f"{Path(words[0]).name} {' '.join(words[1:3])} failed: {' '.join(last)}")
    return done.stdout
