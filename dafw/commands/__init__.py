"""The command ``dafw``. Exit status: 0 done, 2 the request was wrong, 1 a computation failed, 130 interrupted."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from dafw.commands.mpirun import run_on_all_ranks, shares
from dafw.core.errors import DafwError, in_one_line, is_request

COMMANDS = (
    "run",
    "resume",
    "replay",
    "study",
    "plugins",
    "plot",
    "animate",
    "report",
    "watch",
    "readings",
    "simulate",
    "score",
    "site",
    "doctor",
    "check",
    "new-plugin",
)
"""The command NAME is the function ``NAME_command(words)`` of the module NAME in this folder, loaded when called; a
hyphen becomes an underscore."""

USAGE = """\
usage: dafw COMMAND [...]

  run [-m] [experiment=NAME] [overrides]   run a study; -m runs every combination of the values given (a=1,2)
  resume RUN|SWEEP|STUDY                   go on with what was stopped, killed or failed, to the same bits
  replay RUN                               make a run again from its own file, and name the first difference
  study NAME [overrides] | --list          run a study file's configurations on many seeds, and compare them
  plugins [--json] [NAME]                  list the plugins, or the options of those with this name
  plot RUN|SWEEP ... [--out DIR]           draw the pictures of a run, or of several; --help: for print, at chosen times
  animate RUN ... [-o FILE.gif|FILE.mp4]   write an animation of the maps of a run
  report RUN|SWEEP|STUDY ... [-o FILE]     write a page in one file that plays a run, or compares many, in a browser
  watch RUN [--port N]                     serve that page on this machine while the run goes on, and follow it
  readings FILE|RUN [options] [--to FILE]  say how a file of readings would be read; write it, or a run's, anew; draw it
  simulate WORDS | dafw run WORDS          rehearse a live run: WORDS have readings=live and hydra.run.dir=DIR
  score RUN [--truth FILE]                 compare the belief of a rehearsed run with the truth
  site fetch ... | site preview FILE ...   get buildings from OpenStreetMap; look at a site, place release and drone
  check NAME [NAME ...] | --all            hold plugins to what their interface promises
  new-plugin KIND NAME DIR                 write a package with a plugin to start from, and its test
  doctor [--json]                          say what this machine lacks, and the command that installs it

`dafw run --help` lists what can be chosen. Results go to outputs/NAME/TIME; the last line printed is the folder.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; a wrong request prints one line on standard error."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a character the terminal cannot show is no error
    if not words or words[0] in ("-h", "--help", "help"):
        print(USAGE, end="")
        return 0 if words else 2
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"dafw {version('dafw')}")
        return 0
    name, *others = words
    if shares(words):
        return run_on_all_ranks(lambda communicator: _ended(lambda: _command("run")(others, communicator)), words)
    if name not in COMMANDS:
        return _refuse(f"unknown command '{name}' (commands: {', '.join(COMMANDS)})")
    status, message = _ended(lambda: _command(name)(others))
    return _refuse(message, status) if message else status


def _command(name: str) -> Callable[..., int]:
    module = name.replace("-", "_")
    command: Callable[..., int] = getattr(import_module(f"{__name__}.{module}"), f"{module}_command")
    return command


def _ended(command: Callable[[], int]) -> tuple[int, str]:
    """Return a command's exit status, and the error message if it failed."""
    try:
        return command(), ""
    except KeyboardInterrupt as stop:
        return 130, f"interrupted: {stop}".removesuffix(": ")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1, ""
    except Exception as error:
        line = said(error)
        if line is None:  # a bug in dafw: print the traceback
            raise
        return status_of(error), line


def status_of(error: Exception) -> int:
    """Return the exit status of a failure."""
    if isinstance(error, DafwError):
        return error.exit_status
    return 2 if is_request(error) else 1


def said(error: Exception) -> str | None:
    """Return the error as one line; None for an unexpected error that no plugin raised."""
    if not isinstance(error, DafwError | OSError):
        from dafw.core.plugin import by_plugin

        failure = by_plugin(error)
        return said(failure) if failure else None
    return in_one_line(error)


def _refuse(message: str, status: int = 2) -> int:
    print(f"dafw: {message}", file=sys.stderr)
    return status
