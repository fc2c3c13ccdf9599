"""Re-runs of ten members: the direct solver, several steps at once, against BiCGStab and one step after the other.

Both ways run the same members in turn, through ``Rerun`` as filters do, with a reading of two nodes in every cycle.
Every re-run has members that were not seen before, so that it begins with their winds and matrices. Processor time, on
one core. See docs/fast-winds.md, "Re-runs".
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.cycle import SMALL, TOY_BASIS, running
from benchmarks.wind import timed
from dafw.core.observation import Selection
from dafw.core.rerun import Replay, Rerun
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.transport.transport import LEAST_KEPT

STREAMS = Streams(1000)
REDUCED = ("pictures=false", "model.wind.solver=reduced", "model.noise=0", "executor=serial")


def over_stepping(overrides: Sequence[str], lengths: Sequence[int], n_members: int, baseline: float) -> Measurement:
    """Return the time of re-runs one step after the other with BiCGStab, over that of the direct solver.

    Args:
        overrides: of the study whose model is run.
        lengths: steps of every re-run, one after the other.
        n_members: how many members a re-run has.
        baseline: the ratio to be reached.
    """
    with ExitStack() as stack:
        old, new = (
            stack.enter_context(running([*overrides, f"model.transport.solver={solver}"])).parts
            for solver in ("iterative", "direct")
        )
        several = old.model.steps_with_memory
        old.model.steps_with_memory = lambda *given: several(*given[:-1], 1)
        reading = Selection(indices=np.array([0, 1]), covariance=np.ones(2))
        reruns = [Rerun(parts.model, parts.executor, STREAMS) for parts in (old, new)]

        def again(way: int, number: int, steps: int) -> tuple[Replay, float]:
            start = old.model.first_guess(n_members, STREAMS.members("initial", number)).ensemble
            return timed(reruns[way], start, 0, steps, operators=dict.fromkeys(range(steps), reading))

        # As in the middle of a run: what is made once is there, and there are old systems to be made over.
        for way in (0, 1):
            for number in range(1000, 1000 + 2 * max(LEAST_KEPT.values()) // n_members):
                again(way, number, 1)
        rows = []
        for number, steps in enumerate(lengths, 1):
            (slow, before), (quick, after) = again(0, number, steps), again(1, number, steps)
            members = [replay.forecast.ensemble.members for replay in (slow, quick)]
            difference = np.abs(members[1] - members[0]).max() / np.abs(members[0]).max()
            rows.append((steps, before / steps / n_members, after / steps / n_members, difference))
    steps, before, after, differences = np.array(rows).T
    detail = {
        "largest_difference": float(differences.max()),
        **{
            f"ratio_{length}_steps": round(float(np.median((before / after)[steps == length])), 2) for length in lengths
        },
        "ms_per_member_and_step_before": round(1e3 * float(np.median(before)), 4),
        "ms_per_member_and_step_after": round(1e3 * float(np.median(after)), 4),
        "ratios": (before / after).round(2).tolist(),
    }
    return Measurement(float(np.median(before / after)), "times as many steps a second", baseline, detail)


def _case(short: bool, experiment: str, baseline: float, *overrides: str) -> Measurement:
    if short:
        return over_stepping([*SMALL, *TOY_BASIS, *REDUCED, *overrides], (4, 8), 2, baseline)
    return over_stepping([f"experiment={experiment}", *REDUCED, *overrides], 4 * (50, 100), 10, baseline)


@benchmark("rerun.over_stepping_2k7")
def over_stepping_2k7(short: bool) -> Measurement:
    """Member-steps a second in re-runs of 50 and 100 steps on 2,715 nodes, against stepping with BiCGStab."""
    return _case(short, "enie2d_literal", 2.5)


@benchmark("rerun.over_stepping_10k")
def over_stepping_10k(short: bool) -> Measurement:
    """The same on 10,045 nodes."""
    return _case(short, "enie2d_paper", 5.0)


@benchmark("rerun.fct_over_stepping_2k7")
def fct_over_stepping_2k7(short: bool) -> Measurement:
    """The same on 2,715 nodes with flux-corrected transport and an open boundary."""
    return _case(short, "enie2d_literal", 3.0, "model.transport.scheme=fct", "model.transport.outflow=open")
