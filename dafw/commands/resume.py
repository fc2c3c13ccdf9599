"""``dafw resume``: goes on with a run, a multirun or a study that was stopped, killed or failed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import chdir, nullcontext
from pathlib import Path
from typing import Any

from dafw.commands.parser import Parser
from dafw.core.errors import RunError


def resume_command(words: Sequence[str]) -> int:
    """Go on with what a folder holds; raises DafwError. Exit status 1 if a run failed; 0 also if nothing was to do."""
    parser = Parser(
        prog="dafw resume",
        description="Go on with what was stopped, killed or failed: a run from its last checkpoint, to the same bits "
        "as if it had never stopped; of a multirun or a study only the runs that are not complete.",
    )
    parser.add_argument("folder", type=Path, metavar="RUN|SWEEP|STUDY", help="the folder of a run, multirun or study")
    folder: Path = parser.parse_args(list(words)).folder
    if not folder.is_dir():
        raise RunError(f"{folder}: there is no such folder")
    folder = folder.resolve()
    from dafw.core.sweeps import is_sweep
    from dafw.studies.many_runs import REQUEST

    if (folder / REQUEST).is_file():
        return _resume_study(folder, folder / REQUEST)
    if is_sweep(folder) and not (folder / "run.nc").exists():
        return _resume_sweep(folder)
    return _resume_run(folder)


def _resume_run(folder: Path) -> int:
    from dafw.core.experiment import study_from
    from dafw.studies.reporting import closing_line
    from dafw.studies.resuming import is_complete, said_of_complete
    from dafw.studies.run_configuration import configuration_of, in_working_folder
    from dafw.studies.running import run_study
    from dafw.studies.stopping import Interrupted

    with in_working_folder(folder):
        study = study_from(configuration_of(folder))
        if is_complete(folder, study):
            print(said_of_complete(folder))
        else:
            try:
                print(closing_line(study, run_study(study, folder, resume=True)))
            except Interrupted as stop:
                raise KeyboardInterrupt(str(stop)) from stop
    print(folder)
    return 0


def _resume_sweep(folder: Path) -> int:
    from dafw.commands.run import run_command
    from dafw.core.sweeps import requested, sweep_runs
    from dafw.studies.failures import counted, failure_table

    asked = requested(folder)
    runs = sweep_runs(folder)
    print(counted([place for _, place in runs]))
    with chdir(asked.working_folder) if asked.working_folder else nullcontext():
        status = run_command(asked.words(folder), resume=True)
    named = [(",".join(f"{key}={one}" for key, one in values.items()), place) for values, place in sweep_runs(folder)]
    if table := failure_table(named):
        print(table)
    return status


def _resume_study(folder: Path, request: Path) -> int:
    from dafw.commands.study import study_command

    try:
        told: Any = json.loads(request.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{request}: cannot be read ({' '.join(str(error).split())})") from error
    command = told.get("command") if isinstance(told, dict) else None
    if not isinstance(command, dict) or not isinstance(command.get("words"), list):
        raise RunError(f"{request}: does not say by which command the study was begun: repeat that command")
    words, place = [str(word) for word in command["words"]], Path(str(command.get("working_folder")))
    with chdir(place) if place.is_dir() else nullcontext():
        return study_command([*words, "--folder", str(folder), "--retry"], resumes=True)
