"""The literal algorithm beside the fast one, whole runs over seeds: ``python -m benchmarks.curves [--seeds S ...]``.

Both run ``enie2d_paper`` in one process, alternating after every cycle. Prints, for each seed, the ratio of their times
and the largest difference of their ERR, and the spread of ERR over all seeds. The literal algorithm takes about five
minutes a seed. ``--csv`` writes all numbers as they come, ``--picture`` draws the curves.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks import machine
from benchmarks.cycle import BEST, LITERAL, PAPER, running

COLUMNS = ("seed", "cycle", "err_literal", "err_fast", "seconds_literal", "seconds_fast")


def curves(seed: int, cycles: int, overrides: Sequence[str]) -> np.ndarray:
    """Return a row (seed, cycle, ERR in per cent of both, seconds of both) for every cycle."""
    with ExitStack() as stack:
        asked = (*PAPER, f"seed={seed}", *overrides)
        literal, fast = (stack.enter_context(running([*asked, *how])) for how in (LITERAL, BEST))
        for _ in tqdm(range(cycles), desc=f"seed {seed}", unit="cycle", disable=None):
            literal.cycle()
            fast.cycle()
    number = np.arange(1.0, cycles + 1.0)
    columns = (np.full(cycles, seed), number, literal.errors, fast.errors, literal.seconds, fast.seconds)
    return np.column_stack(columns)


def report(rows: np.ndarray) -> str:
    """Return the table of all seeds as Markdown, and a sentence on their spread."""
    seeds = np.unique(rows[:, 0])
    lines = [
        "| seed | literal | fast | ratio | without the first cycle | ERR at the end | largest difference, points |",
        "|---|---|---|---|---|---|---|",
    ]
    for seed in seeds:
        of_seed = rows[rows[:, 0] == seed]
        slow, quick = of_seed[:, 4], of_seed[:, 5]
        apart = np.abs(of_seed[:, 2] - of_seed[:, 3]).max()
        lines.append(
            f"| {seed:.0f} | {slow.sum():.0f} s | {quick.sum():.1f} s | {slow.sum() / quick.sum():.0f} | "
            f"{slow[1:].sum() / quick[1:].sum():.0f} | {of_seed[-1, 2]:.2f}, {of_seed[-1, 3]:.2f} % | {apart:.2f} |"
        )
    if len(seeds) > 1:
        spread = np.std([rows[rows[:, 0] == seed][:, 2] for seed in seeds], axis=0, ddof=1)
        at_once = f"{np.median(spread):.1f} points in the median of the cycles, {spread[-1]:.1f} in the last"
        lines += ["", f"Standard deviation of ERR over the seeds: {at_once}."]
    return "\n".join(lines)


def draw(rows: np.ndarray, path: Path) -> None:
    """Draw ERR over time, a colour for each seed: literal as a line, fast as dots on it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for number, seed in enumerate(np.unique(rows[:, 0])):
        of_seed = rows[rows[:, 0] == seed]
        axes.plot(of_seed[:, 1], of_seed[:, 2], color=f"C{number}", linewidth=1.2, label=f"seed {seed:.0f}")
        axes.plot(of_seed[::4, 1], of_seed[::4, 3], "o", color=f"C{number}", markersize=3.0, fillstyle="none")
    axes.set(xlabel="time in s", ylabel="ERR in %", title="enie2d_paper: literal algorithm (lines), fast one (circles)")
    axes.legend(frameon=False)
    FigureCanvasAgg(figure).print_png(str(path))


def main(words: Sequence[str] | None = None) -> int:
    """Run, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.curves", description="Literal and fast, over seeds.")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4], help="seeds of the runs")
    parser.add_argument("--cycles", type=int, default=100, help="cycles of each run")
    parser.add_argument("--csv", type=Path, help="file for all numbers")
    parser.add_argument("--picture", type=Path, help="file for the curves, a PNG")
    asked, overrides = parser.parse_known_args(words)
    found: list[np.ndarray] = []
    for seed in asked.seeds:
        found.append(curves(seed, asked.cycles, overrides))
        if asked.csv:
            with asked.csv.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file)
                writer.writerow(COLUMNS)
                writer.writerows([[f"{number:.6g}" for number in row] for row in np.concatenate(found)])
    rows = np.concatenate(found)
    if asked.picture:
        draw(rows, asked.picture)
    print(f"{machine()}; {asked.cycles} cycles\n\n{report(rows)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
