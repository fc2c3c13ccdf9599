"""What must be the same for a run to go on: configuration, versions, files of data, and the start they lead to."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from dafw.core.cycle import State
from dafw.core.errors import ContractError
from dafw.core.plugin import label_of, plugins_named
from dafw.core.registry import registry
from dafw.core.study import Study

NOT_COMPARED = ("resume", "checkpoint", "pictures", "executor", "advice")
"""Entries of a configuration, and roles of a study, that do not change the numbers of a run."""
OWN = ("start", "speed", "members", "cycles", "seed", "late_readings", "record", "record_fields", "section", "name")


def described(study: Study) -> dict[str, Any]:
    """Return a study's configuration as plain values, without what does not change its numbers.

    Of a study that was made of objects these are the classes of its parts and their options.
    """
    if study.configuration is not None:
        return compared(study.configuration)
    parts = {role: {"class": _class(part), **_options(part)} for role, part in study.parts_by_role.items()}
    own = {name: getattr(study, name) for name in OWN}
    return compared({**parts, **own, "forecast": asdict(study.forecast)})


def compared(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return of a configuration what changes the numbers of a run, as plain values."""
    return dict(_plain({name: one for name, one in configuration.items() if name not in NOT_COMPARED}))


def digest(configuration: Mapping[str, Any]) -> str:
    """Return a short text that is the same for the same configuration."""
    return hashlib.sha256(json.dumps(configuration, sort_keys=True).encode()).hexdigest()[:32]


def difference(before: Any, now: Any, path: str = "") -> str:
    """Return the first entry in which two configurations differ, in words that follow "had"."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*before, *now]):
            inner = f"{path}.{key}".removeprefix(".")
            if key not in now:
                return f"{inner} = {json.dumps(before[key])}, which is no option now"
            if key not in before:
                return f"no {inner}, now it is {json.dumps(now[key])}"
            if before[key] != now[key]:
                return difference(before[key], now[key], inner)
    return f"{path} = {json.dumps(before)}, now it is {json.dumps(now)}"


def changed_versions(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the packages whose versions differ, in words: ``numpy was 2.2.0 and is 2.3.1``."""
    return [
        f"{name} was {before.get(name, 'not there')} and is {now.get(name, 'not there')}"
        for name in dict.fromkeys([*before, *now])
        if before.get(name) != now.get(name)
    ]


@plugins_named()
def digests_of_files(study: Study) -> dict[str, str]:
    """Return by path the digests of the files that decide the numbers of a study.

    Raises a DafwError that names the part if its files are not there, ContractError if it names none that can be read.
    """
    return {str(path): _file_digest(part, path) for part in study.parts_by_role.values() for path in _files_of(part)}


def changed_files(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the files that differ, in words: ``flight.csv has changed``."""
    changed = [path for path in dict.fromkeys([*before, *now]) if before.get(path) != now.get(path)]
    return [
        f"{path} {'was not read then' if path not in before else 'has changed' if path in now else 'is not read now'}"
        for path in changed
    ]


def changed_since(before: Mapping[str, str], known: dict[str, str]) -> list[str]:
    """Return which of the files with these digests have another content now; those that are gone are left out.

    ``known`` has the digests of now that are known already; what is found is added.
    """
    known |= {path: digest_of_file(Path(path)) for path in before if path not in known and Path(path).is_file()}
    there = [path for path in before if path in known]
    return changed_files({path: before[path] for path in there}, {path: known[path] for path in there})


def digest_of_file(path: Path) -> str:
    """Return a short text that is the same for the same content; raises OSError."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()[:32]


def start_digest(state: State) -> str:
    """Return a short text that is the same for the same bits of the belief, truth and free run at the start."""
    found = (None if one is None else one.ensemble.members for one in (state.belief, state.truth, state.free))
    return " ".join("none" if one is None else f"{crc32(np.ascontiguousarray(one)):08x}" for one in found)


def _files_of(part: Any) -> Sequence[Path]:
    """Return a part's files; raises ContractError unless they are paths."""
    files = part.input_files
    if not isinstance(files, Sequence) or not all(isinstance(path, Path) for path in files):
        raise ContractError(f"{label_of(part)}: input_files must be a sequence of pathlib.Path, got {files!r}")
    return files


def _file_digest(part: Any, path: Path) -> str:
    if not path.is_file():
        raise ContractError(f"{label_of(part)}: input_files names {path}, which is no file")
    try:
        return digest_of_file(path)
    except OSError as error:
        raise ContractError(f"{label_of(part)}: {path} cannot be read ({error.strerror or error})") from error


def _options(part: Any) -> dict[str, Any]:
    recipe = registry().recipe(part)
    if recipe is None and is_dataclass(part):
        recipe = {one.name: getattr(part, one.name) for one in fields(part) if one.init}
    return dict(recipe or {})


def _class(part: Any) -> str:
    return f"{type(part).__module__}:{type(part).__qualname__}"


def _plain(values: Any) -> Any:
    return json.loads(json.dumps(values, default=_told))


def _told(value: Any) -> Any:
    """Return as plain values what JSON does not know."""
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "sha256": hashlib.sha256(np.ascontiguousarray(value)).hexdigest()}
    if isinstance(value, np.generic):
        return value.item()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, set | frozenset):
        return sorted(value, key=repr)
    return f"a {type(value).__name__}"
