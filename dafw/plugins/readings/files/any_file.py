"""Reading and writing a table in the format that the name of its file says."""

from __future__ import annotations

from pathlib import Path

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.several import files_of, is_pattern, read_several
from dafw.plugins.readings.files.table import Table, about

SUFFIXES = {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".nc": "netcdf", ".geojson": "geojson", ".json": "geojson"}
EXAMPLE = "example"


def path_of(options: FileOptions) -> Path:
    """Return the path of the file that the options name; raises ReadingsError if there is no such file."""
    if options.file == EXAMPLE:
        return Path(__file__).with_name("example.csv")
    path = Path(options.file).expanduser()
    try:
        if path.is_file():
            return path
        raise about(options.file, "is a folder, expected a file" if path.is_dir() else "not found")
    except (OSError, ValueError) as error:  # a name that no file can have
        raise about(options.file[:80], f"not found ({error})") from None


def paths_of(options: FileOptions) -> list[Path]:
    """Return the paths of the files that the options name, if they name any; raises ReadingsError if there are none.

    The one that ships with dafw is not among them: it is as old as dafw.
    """
    if options.file in ("", EXAMPLE):
        return []
    return list(files_of(options.file).values()) if is_pattern(options.file) else [path_of(options)]


def read_table(options: FileOptions) -> Table:
    """Return the readings of a file, or of several, as they stand in it; raises ReadingsError."""
    if is_pattern(options.file):
        return read_several(options.file, lambda path: _read(path, options))
    return _read(path_of(options), options)


def _read(path: Path, options: FileOptions) -> Table:
    kind = format_of(path) if options.format == "by_name" else options.format
    try:
        if kind == "csv":
            from dafw.plugins.readings.files.csv_file import read_csv

            return read_csv(path, options)
        if kind == "netcdf":
            from dafw.plugins.readings.files.netcdf_file import read_netcdf

            return read_netcdf(path, options)
        from dafw.plugins.readings.files.geojson_file import read_geojson

        return read_geojson(path, options)
    except OSError as error:
        raise about(str(path), f"cannot be read ({error.strerror or error})") from None


def write_table(table: Table, path: Path, origin: tuple[float, float] | None = None) -> None:
    """Write a table to a file; a file of that name is not overwritten (ReadingsError).

    ``origin`` is the longitude and latitude of the plane's (0, 0), for the points of GeoJSON.
    """
    kind = format_of(path)
    if path.exists():
        raise about(str(path), "exists already; nothing was changed")
    try:
        if kind == "csv":
            from dafw.plugins.readings.files.csv_file import write_csv

            write_csv(table, path)
        elif kind == "netcdf":
            from dafw.plugins.readings.files.netcdf_file import write_netcdf

            write_netcdf(table, path)
        else:
            from dafw.plugins.readings.files.geojson_file import write_geojson

            write_geojson(table, path, origin)
    except OSError as error:
        raise about(str(path), f"cannot be written ({error.strerror or error})") from None


def format_of(path: Path) -> str:
    """Return the format that the end of a file's name says; raises ReadingsError for another end."""
    kind = SUFFIXES.get(path.suffix.lower())
    if kind is None:
        raise ReadingsError(
            f"readings file {path}: expected a name that ends in {', '.join(SUFFIXES)}, or the option 'format'"
        )
    return kind
