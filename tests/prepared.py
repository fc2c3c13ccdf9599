"""A Python process that has imported the libraries, and forks itself for each command.

Half of what a short ``dafw`` command takes is the import of libraries. So the pages of the documentation, with some two
hundred commands, are tried with copies of a process that has done this once. It also has dafw's own modules, and has
composed a study; a copy looks for plugins anew, because some may be installed meanwhile. What starts threads or MPI,
which a fork would not survive, is imported by each copy; its libraries are loaded once.

    PYTHON prepared.py FOLDER    serve; FOLDER gets ``dafw`` and ``python``, which send a command and wait for its end

``python`` does so for ``python FILE ARGUMENTS`` and ``python -m MODULE ARGUMENTS``; all else goes to the interpreter.
"""

from __future__ import annotations

import array
import ctypes
import gc
import importlib
import json
import os
import runpy
import select
import signal
import site
import socket
import sys
import sysconfig
import threading
from pathlib import Path

LIBRARIES = (
    "netCDF4",
    "xarray",
    "dask.array",  # xarray looks for both when it opens a file
    "pint",
    "scipy.optimize",
    "scipy.sparse.linalg",
    "scipy.spatial",
    "scipy.stats",
    "hydra.main",
    "omegaconf",
    "numba",
    "shapely",
    "pyproj",
    "matplotlib.pyplot",
    "matplotlib.tri",
    "ufl",
    "ffcx",
    "filelock",
    "tqdm",
    "dafw.commands.run",
    "dafw.studies.running",
    "dafw.views",
)

SHARED = ("mpi4py/MPI.mpich.*.so", "petsc4py/lib/PETSc.*.so", "dolfinx/cpp.*.so")
"""Libraries that take a while to load; modules of that name are not imported, which would start MPI."""

CLIENT = """#!{python} -IS
import os, socket, sys
words = [{program!r}, *sys.argv[1:]]
if words[0] == "python" and (len(words) == 1 or words[1].startswith("-") and words[1] != "-m"):
    os.execv({python!r}, [{python!r}, *words[1:]])
from json import dumps
here = socket.socket(socket.AF_UNIX)
here.connect({address!r})
asked = dumps({{"words": words, "folder": os.getcwd(), "variables": dict(os.environ)}}).encode()
socket.send_fds(here, [len(asked).to_bytes(8, "big")], [0, 1, 2])
here.sendall(asked)
status = here.recv(8)
sys.exit(int(status) if status else 70)
"""


def received(connection: socket.socket) -> tuple[dict, list[int]]:
    """Return what a client asks for, and its standard input, output and error."""
    head, ancillary, _, _ = connection.recvmsg(8, socket.CMSG_LEN(3 * array.array("i").itemsize))
    streams = array.array("i")
    for _, _, data in ancillary:
        streams.frombytes(data)
    body, length = b"", int.from_bytes(head, "big")
    while len(body) < length:
        body += connection.recv(1 << 16)
    return json.loads(body), list(streams)


def become(asked: dict, streams: list[int]) -> None:
    """Take over the client's streams, folder, variables and words, and find what was installed in the meantime."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    # Anew, because Python found out earlier which kind of files the former streams are.
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)
    os.chdir(asked["folder"])
    os.environ.clear()
    os.environ.update(asked["variables"])
    sys.argv = list(asked["words"])
    importlib.invalidate_caches()
    site.addsitedir(sysconfig.get_path("purelib"))


def serve(address: Path) -> dict:
    """Return in a copy of this process what it is to run; this process itself ends when its standard input does."""
    here = socket.socket(socket.AF_UNIX)
    here.bind(str(address))
    here.listen()
    print("ready", flush=True)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        if sys.stdin in select.select([here, sys.stdin], [], [])[0]:
            os._exit(0)  # the tests have ended, however they did
        connection, _ = here.accept()
        if os.fork():
            connection.close()
            continue
        # This copy waits for the command and tells the client how it ended.
        here.close()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        asked, streams = received(connection)
        if command := os.fork():
            _, ended = os.waitpid(command, 0)
            status = os.waitstatus_to_exitcode(ended)
            connection.sendall(str(status if status >= 0 else 128 - status).encode())
            os._exit(0)
        connection.close()
        become(asked, streams)
        return asked


def main() -> None:
    """Import, serve, and in a copy run what was asked for."""
    folder, programs = Path(sys.argv[1]), Path(sys.executable).parent
    for library in LIBRARIES:
        importlib.import_module(library)
    for spec in importlib.import_module("dafw.plugins").dafw_plugins():
        importlib.import_module(spec.target.partition(":")[0])
    composition = importlib.import_module("dafw.core.composition")
    composition.compose([])
    importlib.import_module("dafw.core.registry").registry.cache_clear()
    for library in [found for place in sys.path for pattern in SHARED for found in Path(place).glob(pattern)]:
        ctypes.CDLL(str(library))
    unsafe = {"dolfinx", "mpi4py.MPI", "petsc4py.PETSc"} & sys.modules.keys()
    assert not unsafe and threading.active_count() == 1, f"a fork would not survive {unsafe or 'threads'}"
    sys.modules["numba"].njit(lambda number: number)(1)  # numba prepares itself when it compiles for the first time
    gc.freeze()  # else each copy would go through all objects of the libraries when it ends
    address = folder / "socket"
    for program in ("dafw", "python"):
        client = CLIENT.format(python=str(programs / "python"), program=program, address=str(address))
        (folder / program).write_text(client)
        (folder / program).chmod(0o755)
    sys.path.pop(0)  # the folder of this file
    program, *_ = serve(address)["words"]
    if program == "dafw":
        sys.argv[0] = str(programs / "dafw")
    elif sys.argv[1] == "-m":
        sys.argv = sys.argv[2:]
        # The environment's dafw stays what it is, also where the variable names a checkout with others.
        sys.path[:] = [str(Path.cwd()), *sys.path, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
        return
    else:
        sys.argv = sys.argv[1:]
        sys.path.insert(0, str(Path(sys.argv[0]).resolve().parent))
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
