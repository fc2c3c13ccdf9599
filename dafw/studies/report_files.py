"""``dafw report``: the page of a run, of a study or of a multirun, whichever a folder holds."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

from dafw.core.errors import RunError
from dafw.core.files import write_atomically
from dafw.core.progress import progress
from dafw.core.sweeps import RECORD, is_sweep, sweep_folder
from dafw.studies.study_page import page_of_study, results_of_study
from dafw.studies.study_statistics import summarised
from dafw.studies.sweep_results import results_of_sweep
from dafw.views.report import NAME, write_report
from dafw.views.report_page import page


def write_page(path: Path, file: Path | None = None, *, runs: bool = False) -> Path:
    """Write the page of what a path names, to ``file`` or to ``report.html`` in its folder, and return the file.

    With ``runs`` every run of a study or a multirun gets its page, too, which its point in the page of all leads to.
    Raises RunError if there is nothing that can be read.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if path.name == "study.nc" or (path / "study.nc").is_file():
        results, summary = results_of_study(folder)
        command = _study_command(folder, summary)
    elif path.name == RECORD or (is_sweep(path) and not (path / "run.nc").exists()):
        folder = sweep_folder(path)
        results = results_of_sweep(folder)
        summary = summarised(results)
        command = _sweep_command(folder)
    elif runs:
        raise RunError(f"{path}: --runs is for a study or a multirun; expected its folder")
    else:
        return write_report(path, file)
    target = file or folder / NAME
    if target.is_dir():
        raise RunError(f"{target}: is a folder; expected the file to write")
    if runs:
        places = [folder / str(place) for place in results["folder"].values.ravel() if place]
        _write_pages_of_runs([place for place in places if (place / "run.nc").is_file()])
    text = page(page_of_study(results, summary, folder, target.parent, command))
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, text)
    return target


def _write_pages_of_runs(places: list[Path]) -> None:
    with progress(len(places), "run", "writing pages") as bar:
        for place in places:
            write_report(place)
            bar.update()


def _study_command(folder: Path, summary: dict[str, Any]) -> str:
    """Return the command that the folder keeps; of older folders one with the name and the seeds of the study."""
    from dafw.studies.many_runs import REQUEST  # here, because it loads Hydra, which the page of a run does not need

    try:
        told = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
        return shlex.join(["dafw", "study", *map(str, told["command"]["words"])])
    except (OSError, ValueError, LookupError, TypeError):
        pass
    seeds = [int(seed) for seed in summary.get("seeds", [])]
    text = ",".join(map(str, seeds))
    if len(seeds) > 1 and seeds == list(range(seeds[0], seeds[-1] + 1)):
        text = f"{seeds[0]}-{seeds[-1]}"
    return shlex.join(["dafw", "study", str(summary.get("name", "")), "--seeds", text])


def _sweep_command(folder: Path) -> str:
    """Return the command of a multirun; empty if Hydra did not record its overrides."""
    import yaml

    try:
        record = yaml.safe_load((folder / RECORD).read_text(encoding="utf-8"))
        asked = [str(word) for word in record["hydra"]["overrides"]["task"]]
    except (OSError, UnicodeError, yaml.YAMLError, LookupError, TypeError):
        return ""
    return shlex.join(["dafw", "run", "-m", *asked])
