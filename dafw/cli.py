"""The command ``dafw``. Exit status: 0 done, 2 the request was wrong, 1 a computation failed, 130 interrupted."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dafw.core.errors import ConfigurationError, DafwError
from dafw.mpirun import shares, together

USAGE = """\
usage: dafw COMMAND [...]

  run [-m] [experiment=NAME] [overrides]   run a study; -m runs every combination of the values given (a=1,2)
  plugins [--json] [NAME]                  list the plugins, or the options of those with this name
  plot RUN [RUN ...] [--out DIR]           draw the pictures of a run, or of several together
  check NAME [NAME ...] | --all            hold plugins to what their interface promises
  new-plugin KIND NAME DIR                 write a package with a plugin to start from, and its test
  doctor [--json]                          say what this machine lacks, and the command that installs it

`dafw run --help` lists what can be chosen. Results go to outputs/NAME/TIME; the last line printed is the folder.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; a wrong request is one line on standard error."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that knows no umlauts is no reason to fail
    if not words or words[0] in ("-h", "--help", "help"):
        print(USAGE, end="")
        return 0 if words else 2
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"dafw {version('dafw')}")
        return 0
    if shares(words):
        return together(lambda communicator: _ended(lambda: _run(words[1:], communicator)), words)
    commands: dict[str, Callable[[list[str]], int]] = {
        "run": _run,
        "plugins": _plugins,
        "plot": _plot,
        "doctor": _doctor,
        "check": _check,
        "new-plugin": _new_plugin,
    }
    if words[0] not in commands:
        return _refuse(f"unknown command '{words[0]}' (commands: {', '.join(commands)})")
    status, message = _ended(lambda: commands[words[0]](words[1:]))
    return _refuse(message, status) if message else status


def _ended(command: Callable[[], int]) -> tuple[int, str]:
    """Return a command's exit status, and what is to be said where it failed."""
    try:
        return command(), ""
    except DafwError as error:
        return error.exit_status, " ".join(str(error).split())
    except KeyboardInterrupt as stop:
        return 130, f"interrupted: {stop}".removesuffix(": ")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1, ""
    except OSError as error:
        return 2, " ".join(str(error).split())


def _refuse(message: str, status: int = 2) -> int:
    print(f"dafw: {message}", file=sys.stderr)
    return status


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every command does."""

    def error(self, message: str) -> None:  # type: ignore[override]  # raises where argparse would exit
        raise ConfigurationError(f"{self.prog.removeprefix('dafw ')}: {message}")


def _run(words: list[str], communicator: Any = None) -> int:
    from dafw.hydra_app import run_command

    return run_command(words, communicator)


def _plugins(words: list[str]) -> int:
    from dafw.core.errors import PluginError
    from dafw.core.registry import registry

    parser = _Parser(prog="dafw plugins", description="List the plugins, or the options of those with this name.")
    parser.add_argument("name", nargs="?", help="a plugin's name: list its options")
    parser.add_argument("--json", action="store_true", help="for machines")
    asked = parser.parse_args(words)
    rows = []
    for plugin in registry().named(asked.name) if asked.name else registry().plugins():
        row: dict[str, Any] = {"kind": plugin.spec.kind, "name": plugin.spec.name, "package": plugin.package}
        row["summary"] = plugin.spec.summary
        if asked.name or asked.json:
            try:
                row["options"] = [vars(option) for option in registry().options(plugin.spec.kind, plugin.spec.name)]
            except PluginError as error:
                row["problem"] = str(error)
        rows.append(row)
    if asked.json:
        problems_listed = [vars(problem) for problem in registry().problems]
        print(json.dumps({"plugins": rows, "problems": problems_listed}, indent=2, default=str))
        return 0
    for row in rows:
        print(f"{row['kind']:<9} {row['name']:<12} {row['summary']}  [{row['package']}]")
        for option in row.get("options", []):
            print(f"    {option['name']}: {option['type']} = {option['default']}    {option['help']}")
        if "problem" in row:
            print(f"    {row['problem']}")
    for problem in registry().problems:
        print(f"problem   {problem.package}: {problem.message}")
    return 0


def _plot(words: list[str]) -> int:
    parser = _Parser(prog="dafw plot", description="Draw the pictures of a run, or of several together.")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="a run's folder or its run.nc")
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    asked = parser.parse_args(words)
    from dafw.figures import plot_command

    for path in plot_command(asked.runs, asked.out):
        print(path)
    return 0


def _doctor(words: list[str]) -> int:
    parser = _Parser(prog="dafw doctor", description="Say what this machine lacks.")
    parser.add_argument("--json", action="store_true", help="for machines")
    asked = parser.parse_args(words)
    from dafw.doctor import doctor_command

    return doctor_command(asked.json)


def _check(words: list[str]) -> int:
    parser = _Parser(prog="dafw check", description="Hold plugins to what their interface promises.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="a plugin's name")
    parser.add_argument("--all", action="store_true", help="every plugin that is installed")
    asked = parser.parse_args(words)
    if bool(asked.names) == asked.all:
        parser.error("expected either names of plugins or --all")
    from dafw.checking import check_command

    return check_command(asked.names, everything=asked.all)


def _new_plugin(words: list[str]) -> int:
    parser = _Parser(prog="dafw new-plugin", description="Write a package with a plugin to start from, and its test.")
    parser.add_argument("kind", help="model, observer, policy or filter")
    parser.add_argument("name", help="the plugin's name: small letters, digits and '_'")
    parser.add_argument("folder", type=Path, metavar="DIR", help="a folder that is not there yet")
    asked = parser.parse_args(words)
    from dafw.template import new_plugin

    for path in new_plugin(asked.kind, asked.name, asked.folder):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
