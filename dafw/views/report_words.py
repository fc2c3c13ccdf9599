"""The words of a page: how the run ended, its parts and versions, its configuration, the command that repeats it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dafw.core.runs import summary_of

if TYPE_CHECKING:
    from xarray import Dataset

LONGEST = 200_000
"""Characters of a configuration that a page shows."""


def words_of(run: Dataset, folder: Path) -> dict[str, Any]:
    """Return the tables, the configuration and the command of a run in a folder.

    A run that was started from Python has no command, and its folder no configuration: both are then empty.
    """
    summary = summary_of(folder)
    overrides = overrides_of(folder)
    return {
        "status": str(summary.get("status", "")),
        "error": str(summary.get("error", "")),
        "tables": [
            table
            for table in (
                {"title": "Run", "rows": _about(run, summary)},
                {"title": "Parts", "rows": _rows(run.attrs.get("parts"))},
                {"title": "Versions", "rows": _rows(run.attrs.get("versions"))},
            )
            if table["rows"]
        ],
        "configuration": _text(folder / ".hydra" / "config.yaml"),
        "command": "" if overrides is None else shlex.join(["dafw", "run", *_own_folder(folder), *overrides]),
    }


def overrides_of(folder: Path) -> list[str] | None:
    """Return the overrides of a run; None if it was not started by ``dafw run``."""
    import yaml

    try:
        listed = yaml.safe_load((folder / ".hydra" / "overrides.yaml").read_text(encoding="utf-8"))
    except (OSError, UnicodeError, yaml.YAMLError):
        return None
    return [str(item) for item in listed] if isinstance(listed, list) else None


def _own_folder(folder: Path) -> list[str]:
    """Return the option that named a folder of configuration, seen from where the run was started; [] if none was."""
    import yaml

    try:
        told = yaml.safe_load((folder / ".hydra" / "hydra.yaml").read_text(encoding="utf-8"))["hydra"]["runtime"]
        own = [Path(one["path"]) for one in told["config_sources"] if one["provider"] == "command-line"]
        started = Path(told["cwd"])
    except (OSError, UnicodeError, yaml.YAMLError, LookupError, TypeError):
        return []
    if not own:
        return []
    return ["--config-dir", str(own[0].relative_to(started) if own[0].is_relative_to(started) else own[0])]


def _about(run: Dataset, summary: dict[str, Any]) -> list[list[str]]:
    """Return what is known of the run itself, as rows of a table."""
    found = {"name": run.attrs.get("name"), "seed": run.attrs.get("seed"), "status": summary.get("status")}
    found["members"] = summary.get("members", run.sizes.get("member"))
    if "cycles" in summary:
        found["cycles"] = f"{summary['cycles']} of {summary.get('cycles_wanted', summary['cycles'])}"
    if isinstance(summary.get("readings"), dict):
        counts = {name.replace("_", " "): count for name, count in summary["readings"].items() if count}
        found["readings"] = ", ".join(f"{count} {name}" for name, count in counts.items()) or "none"
    for name, label in (("err_final", "ERR at the end"), ("err_free_final", "ERR of the free run at the end")):
        if isinstance(summary.get(name), int | float):
            found[label] = f"{summary[name]:.1f} %"
    if isinstance(summary.get("innovation_rms"), int | float):
        found["innovations, root mean square"] = f"{summary['innovation_rms']:.2f}"
    if isinstance(summary.get("diverged_at"), int | float):
        found["belief diverged at"] = f"{summary['diverged_at']:g} s"
    if isinstance(summary.get("wall_seconds"), int | float):
        found["wall time"] = f"{summary['wall_seconds']:.1f} s"
    if summary.get("error"):
        found["error"] = summary["error"]
    return [[name, str(value)] for name, value in found.items() if value not in (None, "")]


def _rows(text: Any) -> list[list[str]]:
    """Return a JSON object, as attributes hold it, as rows of a table."""
    try:
        found = json.loads(str(text))
    except ValueError:
        return []
    return [[str(name), str(value)] for name, value in found.items()] if isinstance(found, dict) else []


def _text(file: Path) -> str:
    try:
        content = file.read_text(encoding="utf-8")
    except (OSError, UnicodeError):
        return ""
    return content if len(content) <= LONGEST else f"{content[:LONGEST]}\n... (cut off)"
