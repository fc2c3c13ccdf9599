"""From the folder of a run to a page in one file, which plays the run in a browser."""

from __future__ import annotations

from pathlib import Path

from dafw.core.errors import RunError
from dafw.core.files import write_atomically
from dafw.core.progress import long_task
from dafw.views.files import load_run
from dafw.views.report_page import page
from dafw.views.report_run import page_of_run

NAME = "report.html"


def write_report(path: Path, file: Path | None = None) -> Path:
    """Write the page of a run, its folder or its ``run.nc``, to ``file`` or to ``report.html`` in its folder.

    Returns the file. A former file is replaced when the new one is complete. Raises RunError if there is no run that
    can be read.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    target = file or folder / NAME
    if target.is_dir():
        raise RunError(f"{target}: is a folder; expected the file to write")
    with long_task("writing the page", 2, "step") as bar:
        run = load_run(path / "run.nc" if path.is_dir() else path)
        bar.update()
        text = page(page_of_run(run, folder))
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target, text)
        bar.update()
    return target
