"""A policy that flies to and fro."""

from dataclasses import dataclass

import numpy as np

from dafw import Policy, Route, option


@dataclass
class Patrol(Policy):
    """Every vehicle flies a number of steps east, then as many west; if its way is blocked, it waits."""

    steps: int = option(3, "steps in one direction", minimum=1)

    def initial_memory(self, vehicle):
        """Return the number of steps flown so far: none."""
        return {"flown": np.array(0)}

    def decide_with_memory(self, belief, vehicle, memory, rng):
        """Return the next leg of every vehicle."""
        flown = int(memory["flown"])
        leg = np.array([vehicle.reach if flown // self.steps % 2 == 0 else -vehicle.reach, 0.0])
        paths = []
        for position in vehicle.positions:
            free = vehicle.airspace is None or vehicle.airspace.is_free(position, position + leg)
            paths.append(np.array([position, position + leg if free else position]))
        return Route(tuple(paths), memory={"flown": np.array(flown + 1)})
