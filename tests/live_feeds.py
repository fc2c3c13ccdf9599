"""A feed with garbage in it, and a small live study with a smoother that takes it."""

import json

import numpy as np

from dafw import Study
from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.live import Live

CYCLES, DT = 9, 0.05


def lines(first=0, last=CYCLES, end=True):
    """Return what a feed says from one cycle to another."""
    told = []
    for cycle in range(first, last):
        for entry in range(0, 40, 4):
            time = (cycle + (entry % 3) / 3) * DT
            told.append(json.dumps({"time": time, "entry": entry, "value": 2.0 + np.sin(entry + cycle), "sd": 1.0}))
        told += ["garbage", told[-1], json.dumps({"until": (cycle + 1) * DT})]
    return "".join(f"{one}\n" for one in [*told, *(['{"end": true}'] if end else [])])


def waves(source, **options):
    live = Live.from_options(source=str(source), patience=60.0, **options)
    parts = {"model": Lorenz96(), "filter": EnKS(window=3), "members": 8, "cycles": CYCLES, "seed": 1000}
    return Study(**parts, readings=live, checkpoint=CheckpointPlan(cycles=3))
