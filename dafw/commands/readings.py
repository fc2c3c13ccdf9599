"""``dafw readings``: what a file of readings holds and how it would be read; readings of a run as such a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dafw.commands.parser import Parser
from dafw.core.errors import ConfigurationError

if TYPE_CHECKING:
    from dafw.plugins.readings.files.table import Table
    from dafw.plugins.readings.recorded import Recorded

KEPT = 8
"""How many sensors, columns or rows of a kind are listed by name."""


def readings_command(words: Sequence[str]) -> int:
    """Print what a file holds, or write a table to a file; raises ReadingsError, RunError or ConfigurationError."""
    parser = Parser(
        prog="dafw readings",
        description="Say what a file of readings holds and how it would be read, or write readings to a file.",
    )
    parser.add_argument("file", help="a .csv, .nc or .geojson file, 'example', or a run (its folder or run.nc)")
    parser.add_argument("options", nargs="*", help="options of readings=recorded, such as columns.value=CO2 unit=ppm")
    parser.add_argument("--to", type=Path, metavar="FILE", help="write the rows to FILE (.csv, .nc or .geojson)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the readings along the way to FILE (.png)")
    asked = parser.parse_intermixed_args(words)
    if asked.picture is not None and asked.picture.suffix.lower() != ".png":
        raise ConfigurationError(f"readings: expected a picture's name that ends in .png, got {asked.picture}")
    from dafw.plugins.readings.files.any_file import write_table

    if _is_run(asked.file):
        if asked.options:
            raise ConfigurationError(f"readings: a run is read without options, got {asked.options[0]}")
        if asked.picture is not None:
            raise ConfigurationError("readings: --picture draws a file of readings; the pictures of a run: dafw plot")
        from dafw.plugins.readings.files.from_run import table_of_run

        table, origin = table_of_run(Path(asked.file))
        lines = described_rows(table)
    else:
        source = _source(asked.file, asked.options)
        table, origin = source.rows, source.plane_origin
        lines = [*described_rows(table), *described_use(source)]
    if asked.to is not None:
        write_table(table, asked.to, origin)
        lines = [str(asked.to)]
    if asked.picture is not None:
        from dafw.views.files import save
        from dafw.views.readings import plot_readings

        lines.append(str(save(plot_readings(source), asked.picture)))
    print("\n".join(lines))
    return 0


def _is_run(word: str) -> bool:
    """Return whether the word names the folder of a run, or its run.nc."""
    path = Path(word)
    return path.name == "run.nc" or path.is_dir()


def _source(file: str, words: Sequence[str]) -> Recorded:
    """Return ``readings=recorded`` with options written as for ``dafw run``, with or without ``readings.`` before."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException
    from omegaconf import OmegaConf

    from dafw.core.registry import registry

    given = OmegaConf.create()
    for word in words:
        try:
            override = OverridesParser.create().parse_override(word)
        except HydraException as error:
            raise ConfigurationError(f"readings: expected an option NAME=VALUE, got {word!r}") from error
        if override.is_sweep_override() or override.is_delete() or not override.key_or_group:
            raise ConfigurationError(f"readings: expected an option NAME=VALUE, got {word!r}")
        key = override.key_or_group.removeprefix("readings.")
        if key == "file":
            raise ConfigurationError(f"readings: the file is {file!r}, it cannot be an option, too")
        OmegaConf.update(given, key, override.value(), force_add=True)
    plain: Any = OmegaConf.to_container(given)
    source: Recorded = registry().create("readings", {"name": "recorded", "file": file, **plain})
    return source


def described_rows(table: Table) -> list[str]:
    """Return lines about the rows of a file: times, columns, sensors, units, places."""
    lines = [f"{table.path}: {len(table)} {table.word}s"]
    for role, name in table.names.items():
        lines.append(f"  {role:<8} from {name!r}{_range(table, role)}")
    for role in table.numbers:
        if role not in table.names:
            lines.append(f"  {role:<8}{_range(table, role)}")
    units = list(dict.fromkeys(table.text("unit")))
    if units and units != [""]:
        lines.append(f"  units     {_some([one or '(none)' for one in units])}")
    sensors = list(dict.fromkeys(table.text("sensor")))
    if sensors and sensors != [""]:
        lines.append(f"  sensors   {_some([one or '(unnamed)' for one in sensors])}")
    if table.others:
        lines.append(f"  not used  {_some(list(table.others), 30)}")
    return lines


def _range(table: Table, role: str) -> str:
    """Return the smallest and the largest number of a column, and how many are missing; for a text, nothing."""
    import numpy as np

    if role not in table.numbers:
        return ""
    column = table.number(role)
    there = column[~np.isnan(column)]
    if not len(there):
        return ": no numbers"
    low, high = float(there.min()), float(there.max())
    said = f"{table.date(low)} to {table.date(high)}" if role in ("time", "arrives") else f"{low:.9g} to {high:.9g}"
    missing = len(column) - len(there)
    back = int((np.diff(there) < 0).sum()) if role == "time" else 0
    return f": {said}" + (f", {missing} missing" if missing else "") + (f", {back} times back" if back else "")


def described_use(source: Recorded) -> list[str]:
    """Return lines about how a file would be read: what is t = 0, which rows are left out, and what is still needed."""
    from dafw.core.errors import ReadingsError
    from dafw.plugins.readings.files.screening import REASONS, complete, start_of, without_doubles

    table = source.rows
    kind = table.place_kind(source.place)
    whole, incomplete = complete(table, kind)
    whole, doubled = without_doubles(whole)
    where = {"metres": "x, y", "degrees": "lon, lat", "entry": "entry", None: "none: for a variable of one number"}
    lines = ["how it would be read", f"  places    {where[kind]}"]
    if kind == "degrees" and len(whole):
        about = source.plane_origin
        lines.append(
            "            about the centre of the site, or the option origin"
            if about is None
            else f"            about {about[0]:.9g}, {about[1]:.9g}"
        )
    needed = []
    counts = {"incomplete": incomplete, "doubled": doubled}
    try:
        start = start_of(whole, source.start)
        time = whole.number("time") - start
        lines.append(f"  t = 0     {whole.date(start)}")
        if len(time):
            lines.append(f"  times     t = {time.min():g} to {time.max():g} s, {(time <= 0).sum()} not after t = 0")
    except ReadingsError as error:
        needed.append(str(error))
    if not needed:
        try:
            usable = source.usable
            counts |= usable.counts
            lines.append(f"  readings  {len(usable.table)}")
            if usable.repeated:
                said = f"{usable.repeated} of a sensor at a time of which it has another one: {source.repeated}"
                lines.append(f"  repeated  {said}")
            if usable.below:
                lines.append(f"  censored  {usable.below} below the detection limit")
        except ReadingsError as error:
            needed.append(str(error))
    for reason, count in counts.items():
        if count:
            lines.append(f"  left out  {count} {REASONS[reason]}")
    lines += [f"  needed    {text.removeprefix(f'readings file {table.path}: ')}" for text in needed]
    return lines


def _some(names: list[str], most: int = KEPT) -> str:
    """Return names in one line, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
