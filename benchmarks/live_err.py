"""The error of live runs beside that of the twin runs of the same seeds.

``python -m benchmarks.live_err [--seeds 10] [--wall] [WORDS...]`` runs each seed twice: as a twin, and as a live run
(``experiment=live WORDS``) beside a simulation, which plays the truth and a drone that obeys the advice; the two have a
file of messages and a file of advice between them. The live run never sees the truth, and is scored afterwards. The
table has the ERR of both at the end, in per cent, and whether the belief is the same to the last bit. The exit status
is 1 if the median of the live runs' ERR lies outside the range of the twins'.

With ``--wall`` the live runs go by the wall's clock, and are as long as their cycles: a drone waits for its advice.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

import dafw
from dafw.commands import main as dafw_command
from dafw.core.runs import summary_of
from dafw.studies.truth_file import scores_of


def in_a_process(words: Sequence[str]) -> Callable[[], None]:
    """Start a command in a copy of this process; return what waits for its end, and raises SystemExit if it failed."""
    if not (process := os.fork()):
        status = 1
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
                status = dafw_command(list(words))
            if status:
                print(said.getvalue(), file=sys.stderr)
        finally:
            os._exit(status)

    def wait() -> None:
        if os.waitpid(process, 0)[1] != 0:
            raise SystemExit(f"live_err: dafw {' '.join(words)} failed")

    return wait


def both(seed: int, words: Sequence[str], clock: str, place: Path) -> tuple[float, float, bool]:
    """Run a seed as a twin and live; return both ERR, and whether the beliefs are the same to the last bit."""
    twin, live, feed = place / f"twin-{seed}", place / f"live-{seed}", place / f"feed-{seed}.jsonl"
    common = ["experiment=live", *words, f"seed={seed}", "pictures=false"]
    in_a_process(["run", *common, "readings=twin", f"hydra.run.dir={twin}"])()
    told = {"source": feed, "patience": 600, "clock": clock}
    given = [*common, *(f"readings.{name}={value}" for name, value in told.items()), f"hydra.run.dir={live}"]
    waits = [in_a_process(["simulate", *given]), in_a_process(["run", *given])]
    for wait in waits:
        wait()
    with dafw.open_run(twin) as one, dafw.open_run(live) as other:
        names = [name for name in one.data_vars if str(name).endswith(("_mean", "_spread"))]
        same = all(np.array_equal(one[name].values, other[name].values, equal_nan=True) for name in names)
    return summary_of(twin)["err_final"], float(scores_of(live)["err"][-1]), same


def main(words: Sequence[str] | None = None) -> int:
    """Run, print the table; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_err", description="ERR of live runs and of twins.")
    parser.add_argument("--seeds", type=int, default=10, help="seeds from 0 on")
    parser.add_argument("--wall", action="store_true", help="live runs go by the wall's clock")
    parser.add_argument("words", nargs="*", help="words of all runs")
    asked = parser.parse_intermixed_args(words)
    row = "{:>4} {:>10} {:>10}  {}"
    print(row.format("seed", "twin, %", "live, %", "belief"))
    found = []
    with tempfile.TemporaryDirectory(prefix="dafw-live-err-") as name:
        for seed in range(asked.seeds):
            twin, live, same = both(seed, asked.words, "wall" if asked.wall else "feed", Path(name))
            found.append((twin, live))
            print(row.format(seed, f"{twin:.3f}", f"{live:.3f}", "the same bits" if same else "other bits"), flush=True)
    twins, lives = np.array(found).T
    median = float(np.median(lives))
    print(f"median {np.median(twins):.3f} and {median:.3f}; twins from {twins.min():.3f} to {twins.max():.3f}")
    return 0 if twins.min() <= median <= twins.max() else 1


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
