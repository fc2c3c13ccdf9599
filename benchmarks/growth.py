"""How the time of a cycle grows: ``python -m benchmarks.growth [--nodes K ...] [--members N ...] [OVERRIDE ...]``.

Prints a table of the seconds of a cycle (the mean over some cycles after the first) against the nodes of the mesh of
``enie2d_paper`` and the members, and the fitted exponents. The exponents of nodes and of members are least-squares fits
of the logarithms, each with the other number fixed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from benchmarks import machine
from benchmarks.cycle import PAPER, running

SIZES = {"2.5k": (16.0, 24.0, 100.0), "10k": (5.5, 14.0, 120.0), "40k": (2.7, 6.5, 120.0), "160k": (1.35, 3.2, 120.0)}
"""By number of nodes: sizes of the triangles at walls and far from them, width of the transition; in metres."""


def seconds_of_a_cycle(nodes: str, members: int, cycles: int, overrides: Sequence[str]) -> tuple[int, float]:
    """Return the actual number of nodes, and the seconds."""
    wall, far, transition = SIZES[nodes]
    mesh = [f"model.mesh.wall_size={wall}", f"model.mesh.far_size={far}", f"model.mesh.transition={transition}"]
    with running([*PAPER, *mesh, f"members={members}", *overrides]) as run:
        for _ in range(cycles + 1):
            run.cycle()
        return run.parts.model.space["concentration"].size, float(np.mean(run.seconds[1:]))


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Return p of seconds ~ sizes^p."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def main(words: Sequence[str] | None = None) -> int:
    """Measure, print the table as Markdown and the exponents; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description="Time of a cycle against size.")
    parser.add_argument("--nodes", nargs="+", choices=SIZES, default=["2.5k", "10k"], help="sizes of the mesh")
    parser.add_argument("--members", nargs="+", type=int, default=[10, 100], help="sizes of the ensemble")
    parser.add_argument("--cycles", type=int, default=10, help="cycles after the first")
    asked, overrides = parser.parse_known_args(words)
    found: dict[tuple[str, int], float] = {}
    counts: dict[str, int] = {}
    print(f"{machine()}; {' '.join(overrides) or 'as configured'}; {asked.cycles} cycles after the first\n")
    print("| nodes | " + " | ".join(f"N = {members}" for members in asked.members) + " |")
    print("|---" * (1 + len(asked.members)) + "|")
    for nodes in asked.nodes:
        for members in asked.members:
            counts[nodes], found[nodes, members] = seconds_of_a_cycle(nodes, members, asked.cycles, overrides)
        row = " | ".join(f"{found[nodes, members]:.3f} s" for members in asked.members)
        print(f"| {counts[nodes]} | {row} |", flush=True)
    print()
    if len(asked.nodes) > 1:
        for members in asked.members:
            times = [found[nodes, members] for nodes in asked.nodes]
            power = exponent([counts[nodes] for nodes in asked.nodes], times)
            print(f"N = {members}: seconds ~ nodes^{power:.2f}")
    if len(asked.members) > 1:
        for nodes in asked.nodes:
            power = exponent(asked.members, [found[nodes, members] for members in asked.members])
            print(f"{counts[nodes]} nodes: seconds ~ members^{power:.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
