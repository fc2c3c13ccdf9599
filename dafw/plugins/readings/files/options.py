"""The options that say how a file of readings is to be understood."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import REQUIRED, option


@dataclass
class ColumnOptions:
    """Which column of a file holds what; null: the column of the role's own name, if there is one.

    In a netCDF file a column is a variable, in GeoJSON a property. Names are compared without regard to case, quotes
    and a unit in brackets behind them: ``CO2`` means the column ``"CO2 (ppm)"``, too.
    """

    time: str | None = option(None, "time of the reading; null: 'time'")
    value: str | None = option(None, "the value; null: 'value', or the only variable of a netCDF file")
    x: str | None = option(None, "metres to the east in the plane of the site; null: 'x'")
    y: str | None = option(None, "metres to the north in the plane of the site; null: 'y'")
    lon: str | None = option(None, "longitude in degrees; null: 'lon' or 'longitude'")
    lat: str | None = option(None, "latitude in degrees; null: 'lat' or 'latitude'")
    entry: str | None = option(None, "number of the entry of a variable without places, from 0; null: 'entry'")
    unit: str | None = option(None, "unit of the value; null: 'unit'")
    sd: str | None = option(None, "standard deviation of the value's error, in the value's unit; null: 'sd'")
    sensor: str | None = option(None, "name of the sensor; null: 'sensor'")
    span: str | None = option(
        None, "seconds over which the value is a mean, until its time; null: 'span', or it is none"
    )
    arrives: str | None = option(None, "time at which the reading became known; null: 'arrives'")


@dataclass
class FileOptions:
    """A file of readings and how it is written."""

    file: str = option(
        REQUIRED,
        "path of a .csv, .nc or .geojson file, or 'example' for the one that ships with dafw; a * in it names several "
        "files, and stands for the name of the sensor of each",
    )
    columns: ColumnOptions = option(ColumnOptions, "which column holds what")
    place: str = option(
        "auto",
        "which columns say where: metres (x, y), degrees (lon, lat) or entry; auto: the first of these that are there",
        choices=["auto", "metres", "degrees", "entry"],
    )
    format: str = option(
        "by_name",
        "format of the file; by_name: from the end of its name",
        choices=["by_name", "csv", "netcdf", "geojson"],
    )
    time_format: str | None = option(
        None,
        "how times are written, as in Python's strptime; a * at the end: anything may follow. "
        "null: seconds, or dates in ISO 8601",
    )
    delimiter: str = option(
        "auto",
        "CSV: what separates the columns; auto: what is most frequent in the line of column names",
        choices=["auto", "comma", "semicolon", "tab", "bar", "space"],
    )
    decimal: str = option("point", "CSV: the decimal mark", choices=["point", "comma"])
    skip: int = option(0, "CSV: number of lines before the line of column names", minimum=0)
    date_line: int | None = option(
        None, "CSV: number of the line, from 1, with the date from which the seconds of the times count", minimum=1
    )
    date_format: str | None = option(None, "CSV: how that date is written, as time_format says; null: ISO 8601")
    missing: list[str] = option(
        ["nan", "na", "n/a", "null", "none", "-", "--"], "words that stand for a missing number, beside the empty cell"
    )
    units_in_cells: bool = option(False, "whether every value has its unit behind it, in its own cell: 2.10 m/s, 203°")
