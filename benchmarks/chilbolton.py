"""Recorded releases of methane: how well ``experiment=chilbolton`` finds each of them.

``python -m benchmarks.chilbolton FOLDER [--releases R ...] [--seeds S ...] [--out DIR] [overrides]`` runs every release
of a folder that has ``relNN/POSi_relNN_processed.txt``, or reads the runs that are in DIR already, and prints a table.
The places and rates that are known are used to score the runs, and for nothing else.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
import xarray as xr

import dafw
from dafw.views.places import places_of, probability_within

WITHIN = 15.0
"""Metres within which a place counts as found."""


@dataclass(frozen=True)
class Release:
    """What is known: the place in m, the rate in g/s."""

    place: tuple[float, float]
    rate: float


RELEASES = {
    "rel02": Release((68.91, 92.75), 0.378),
    "rel05": Release((58.82, 53.82), 0.383),
    "rel06": Release((58.82, 53.82), 0.383),
}


def row_of(run: xr.Dataset, name: str, seconds: float) -> dict[str, float | str]:
    """Return the numbers of one run; ``seconds`` is the processor's time that it took."""
    known, end = RELEASES[name], run.sizes["time"] - 1
    distances, means = [], []
    for row in range(end + 1):
        places, weights = places_of(run, row)
        off = places - known.place
        distances.append(np.sqrt(weights @ (off**2).sum(axis=1)))
        means.append(float(np.linalg.norm(weights @ off)))
    far = np.flatnonzero(np.array(distances) > WITHIN)
    on = np.flatnonzero(run["filter_source_on"].values > 0.5)
    rate = float(run["weight"].values[end] @ run["rate_members"].values[end])
    return {
        "release": name,
        "seed": str(run.attrs["seed"]),
        "place off, m": means[end],
        "root mean square, m": distances[end],
        "more likely places": probability_within(run, end, np.array(known.place)),
        "rate / true": rate / known.rate,
        "gas from, min": float(on[0]) if len(on) else np.nan,
        "gas until, min": float(on[-1]) if len(on) else np.nan,
        "within 15 m from, min": float(far[-1] + 1) if len(far) else 0.0,
        "record / processor's time": float(run["time"].values[end]) / seconds,
    }


def run_of(folder: Path, name: str, seed: int, out: Path, overrides: Sequence[str]) -> tuple[xr.Dataset, float]:
    """Run a release, unless it is in ``out`` already; return the run and the processor's time in s."""
    place, told = out / f"{name}_{seed}", out / f"{name}_{seed}" / "processor_seconds.json"
    if told.is_file():
        return dafw.open_run(place), float(json.loads(told.read_text()))
    files = folder / name / f"POS*_{name}_processed.txt"
    words = [f'readings.file="{files}"', f"seed={seed}", f"hydra.run.dir={place}"]
    begun = process_time()
    run = dafw.run(["experiment=chilbolton", *words, *overrides])
    seconds = process_time() - begun
    told.write_text(json.dumps(seconds))
    return run, seconds


def main(words: Sequence[str] | None = None) -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--releases", nargs="+", default=list(RELEASES), choices=list(RELEASES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--out", type=Path, default=Path("outputs/chilbolton_releases"))
    asked, overrides = parser.parse_known_args(words)
    header = False
    for name in asked.releases:
        for seed in asked.seeds:
            row = row_of(*_named(run_of(asked.folder, name, seed, asked.out, overrides), name))
            if not header:
                print("| " + " | ".join(row) + " |\n|" + "---|" * len(row))
                header = True
            print("| " + " | ".join(f"{v:.2f}" if isinstance(v, float) else v for v in row.values()) + " |", flush=True)


def _named(found: tuple[xr.Dataset, float], name: str) -> tuple[xr.Dataset, str, float]:
    return found[0], name, found[1]


if __name__ == "__main__":
    main()
