"""Time DAPPER on Lorenz-96 as in Sakov and Oke (2008); run by the interpreter of DAPPER's own environment.

``python dapper_l96.py CYCLES SEED`` prints one JSON object: the ``seconds`` that ``assimilate`` took by the clock and
of the processor, warmed up (truth and readings are simulated before and not timed), the ``cycles``, and the ``rmse`` of
the analysis mean over the last five sevenths of them.
"""

import json
import sys
import time

import dapper
import dapper.tools.progressbar as progress
from dapper.da_methods import EnKF
from dapper.mods.Lorenz96.sakov2008 import HMM


def main(cycles: int, seed: int) -> None:
    """Warm up, time one run, print."""
    progress.disable_progbar = progress.disable_user_interaction = True
    for n_cycles in (20, cycles):
        dapper.set_seed(seed)
        HMM.tseq.Ko = n_cycles - 1
        truth, readings = HMM.simulate()
        method = EnKF("Sqrt", N=24, infl=1.013, rot=True)
        start, busy = time.perf_counter(), time.process_time()
        method.assimilate(HMM, truth, readings, liveplots=False)
        seconds, busy = time.perf_counter() - start, time.process_time() - busy
    rmse = method.stats.err.rms.a[cycles * 2 // 7 :].mean()
    print(json.dumps({"seconds": seconds, "processor_seconds": busy, "cycles": len(readings), "rmse": float(rmse)}))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
