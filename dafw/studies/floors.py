"""The floors of a study of many runs: for each configuration the smallest ERR that constant parameters reach.

They are kept in ``floors.json`` of the study's folder and found once. A floor depends on the model, the truth and the
number of cycles alone (``dafw.studies.floor``), so configurations that have these in common share a search. It must
not depend on the seed: a truth that is drawn at random is refused.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dafw.core.composition import advised, compose, study_hydra, study_part
from dafw.core.errors import ConfigurationError, DafwError, RunError
from dafw.core.experiment import study_from
from dafw.core.files import write_atomically
from dafw.core.progress import progress
from dafw.studies.floor import floor_of
from dafw.studies.study_files import Configuration, ManyRuns

log = logging.getLogger("dafw")

FILE = "floors.json"
SEED = 0
"""Seed of the search: the same floor whatever the seeds of the runs are."""
DECIDE = ("model", "truth", "cycles")
"""What of a configuration a floor depends on."""


def named(configuration: Configuration, error: DafwError) -> DafwError:
    """Return an error of the same kind that names the configuration."""
    return type(error)(f"configuration '{configuration.name}': {error}")


def composed_for_floors(study: ManyRuns, more: Path | None = None) -> dict[str, Any]:
    """Return, by the name of each configuration, what its floor is found from; nothing if the study asks for none.

    Raises ConfigurationError, which names the configuration, for one that is not accepted.
    """
    if study.floor is None:
        return {}
    hydra, found = study_hydra(more), {}
    for one in study.configurations:
        words = [*one.overrides, *study.floor, f"seed={SEED}"]
        try:
            found[one.name] = study_part(compose(words, more, hydra=hydra))
            study_from(found[one.name])
        except ConfigurationError as error:
            raise named(one, type(error)(f"floor: {advised(error, words, more)}")) from error
    return found


def find_floors(study: ManyRuns, folder: Path, composed: Mapping[str, Any]) -> None:
    """Find the floors that are not in the folder yet; ``composed`` is that of ``composed_for_floors``.

    Raises a DafwError, which names the configuration, if one cannot be found.
    """
    if study.floor is None:
        return
    kept = _kept(folder)
    keys = {one.name: _key(composed[one.name]) for one in study.configurations}
    todo = [one for one in study.configurations if kept.get(one.name, {}).get("key") != keys[one.name]]
    with progress(len(keys), "floor", done=len(keys) - len(todo)) as bar:
        for one in todo:
            key = keys[one.name]
            same = next((entry for entry in kept.values() if entry["key"] == key), None)
            entry = same or _found(one, composed[one.name], key)
            kept[one.name] = entry | {"overrides": _overrides(study, one)}
            write_atomically(folder / FILE, json.dumps({"floors": kept}, indent=1) + "\n")
            log.info("%s: floor %.2f %%", one.name, entry["err"])
            bar.update()


def known_floors(study: ManyRuns, folder: Path) -> dict[str, float]:
    """Return the floors in per cent that are in the folder, by the name of the configuration."""
    kept = _kept(folder)
    asked = [one for one in study.configurations if kept.get(one.name, {}).get("overrides") == _overrides(study, one)]
    return {one.name: float(kept[one.name]["err"]) for one in asked}


def _found(configuration: Configuration, composed: Mapping[str, Any], key: str) -> dict[str, Any]:
    try:
        found = floor_of(study_from(composed), any_seed=True)
    except DafwError as error:
        raise named(configuration, type(error)(f"floor: {error}")) from error
    return {"key": key, "err": found.err, "parameters": found.parameters, "model_runs": found.runs}


def _key(composed: Mapping[str, Any]) -> str:
    """Return what two configurations have in common if they have the same floor."""
    text = json.dumps({part: composed.get(part) for part in DECIDE}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _overrides(study: ManyRuns, one: Configuration) -> list[str]:
    """Return the overrides under which the floor of a configuration is searched for."""
    return [*one.overrides, *(study.floor or ())]


def _kept(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the floors in a folder by the name of the configuration; raises RunError if they cannot be read."""
    file = folder / FILE
    try:
        return dict(json.loads(file.read_text(encoding="utf-8"))["floors"]) if file.exists() else {}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RunError(f"{file}: cannot be read ({' '.join(str(error).split())})") from error
