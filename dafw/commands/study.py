"""``dafw study``: many runs of several configurations and seeds, side by side, and their statistics."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from dafw.commands.parser import Parser
from dafw.core.errors import ConfigurationError

NAMED = 10
"""How many failed runs are named on standard error; all are in summary.json."""


def study_command(words: Sequence[str], *, resumes: bool = False) -> int:
    """Run what is missing of a study and write its results; raises DafwError. Exit status 1 if runs failed.

    With ``resumes`` it says before and afterwards which runs are not complete.
    """
    asked = _parser().parse_intermixed_args(list(words))
    more = Path(asked.config_dir).resolve() if asked.config_dir else None
    if more is not None and not more.is_dir():
        raise ConfigurationError(f"--config-dir {asked.config_dir}: there is no such folder")
    if asked.workers is not None and asked.workers < 1:
        raise ConfigurationError(f"study: --workers must be at least 1, got {asked.workers}")
    if asked.name is None:
        if asked.list:
            return _list_studies(more)
        raise ConfigurationError("study: expected the name of a study; dafw study --list lists them")
    # Here, because they load Hydra, which --help does not need.
    from dafw.studies.failures import counted, failure_table
    from dafw.studies.many_runs import run_folder, run_missing, statuses
    from dafw.studies.results import write_results
    from dafw.studies.study_files import load_study, parse_seeds, runs_of

    whole = load_study(asked.name, more, asked.overrides)
    if asked.seeds is not None:
        whole = replace(whole, seeds=parse_seeds(asked.seeds, "--seeds"))
    study = _chosen(whole, asked.configurations)
    folder = (asked.folder or Path("outputs", f"study_{study.name}")).resolve()
    if asked.list:
        return _list_configurations(study, statuses(study, folder))
    if asked.report:
        if not any(status == "complete" for status in statuses(study, folder).values()):
            raise ConfigurationError(f"{folder}: no run of this study is complete: there is nothing to report")
    else:
        places = [(f"{one.name}, seed {seed}", run_folder(folder, one, seed)) for one, seed in runs_of(study)]
        if resumes:
            print(counted([place for _, place in places]))
        command = _command_of(words)
        run_missing(study, folder, whole=whole, more=more, workers=asked.workers, retry=asked.retry, command=command)
        if resumes and (table := failure_table(places)):
            print(table)
    summary = write_results(study, folder, pictures=not asked.no_pictures)
    print(summary["table"])
    _say_failures(summary)
    print(folder)
    return 1 if summary["n_failed"] else 0


def _command_of(words: Sequence[str]) -> dict[str, Any]:
    """Return a command as the folder of its study keeps it: without the folder, and where it was given."""
    parser = Parser(add_help=False, allow_abbrev=False)
    parser.add_argument("--folder")
    parser.add_argument("--retry", action="store_true")
    _, others = parser.parse_known_args(list(words))
    return {"words": others, "working_folder": str(Path.cwd())}


def _parser() -> Parser:
    parser = Parser(
        prog="dafw study",
        description="Run the configurations of a study file on all its seeds, side by side. What is there already is "
        "not run again: after an interrupt, the same command goes on.",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="the study, conf/study/NAME.yaml")
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="overrides added to every configuration")
    parser.add_argument("--seeds", help="seeds instead of the file's: 100-199, or 3,5,20-29")
    parser.add_argument(
        "--configurations", nargs="+", metavar="C", help="only these configurations; 'etkf*' stands for several"
    )
    parser.add_argument("--workers", type=int, help="processes side by side; default: one for each core")
    parser.add_argument("--folder", type=Path, help="folder of the study; default: outputs/study_NAME")
    parser.add_argument("--retry", action="store_true", help="run again what failed")
    parser.add_argument("--report", action="store_true", help="run nothing, write the results of what is there")
    parser.add_argument("--no-pictures", action="store_true", help="draw no figures")
    parser.add_argument("--config-dir", metavar="DIR", help="a folder with configuration of your own, searched first")
    parser.add_argument("--list", action="store_true", help="list the studies, or the configurations of one")
    return parser


def _chosen(whole: Any, patterns: Sequence[str] | None) -> Any:
    """Return the study with the chosen configurations only; raises ConfigurationError for a name that none has."""
    if patterns is None:
        return whole
    names = [one.name for one in whole.configurations]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigurationError(
                f"study '{whole.name}' has no configuration '{pattern}' (it has: {'; '.join(names)})"
            )
    chosen = [one for one in whole.configurations if any(fnmatchcase(one.name, pattern) for pattern in patterns)]
    return replace(whole, configurations=tuple(chosen))


def _list_studies(more: Path | None) -> int:
    from dafw.studies.study_files import load_study, study_names

    names = study_names(more)
    width = max(map(len, names), default=0)
    for name in names:
        study = load_study(name, more)
        runs = len(study.configurations) * len(study.seeds)
        print(f"{name.ljust(width)}  {runs:5d} runs  {study.title}")
    return 0


def _list_configurations(study: Any, status: Mapping[tuple[str, int], str]) -> int:
    width = max(len(one.name) for one in study.configurations)
    for one in study.configurations:
        done = sum(status[one.name, seed] == "complete" for seed in study.seeds)
        print(f"{one.name.ljust(width)}  {done} of {len(study.seeds)} runs  {' '.join(one.overrides)}")
    return 0


def _say_failures(summary: Mapping[str, Any]) -> None:
    failed = summary["failed"]
    for one in failed[:NAMED]:
        print(f"dafw: {one['configuration']}, seed {one['seed']} failed: {one['error']}", file=sys.stderr)
    if len(failed) > NAMED:
        print(f"dafw: and {len(failed) - NAMED} more runs failed; summary.json names them all", file=sys.stderr)
