"""Look ahead: fly towards the place where the members will disagree most when the vehicle arrives."""

from dataclasses import dataclass

import numpy as np

from dafw import Policy, Route, option


@dataclass
class Lookout(Policy):
    """Compares straight flights in several directions over a few cycles; flies the first leg of the best."""

    looks_ahead = True

    cycles: int = option(5, "cycles to look ahead", minimum=1)
    directions: int = option(8, "directions that are compared", minimum=1)

    def plan(self, outlook, rng):
        """Return one leg for each vehicle."""
        space, vehicle = outlook.belief.ensemble.space, outlook.vehicle
        variable, part = space.variables[0], space.slice(space.variables[0].name)
        spreads = [state.ensemble.spread[part] for state in outlook.ahead(self.cycles).states]
        paths = []
        for position in vehicle.positions:
            best, leg = 0.0, position[np.newaxis]
            for angle in 2.0 * np.pi * np.arange(self.directions) / self.directions:
                step = vehicle.reach * np.array([np.cos(angle), np.sin(angle)])
                way = position + np.arange(1, self.cycles + 1)[:, np.newaxis] * step
                gain = sum(spread[node] for spread, node in zip(spreads, variable.nearest(way), strict=True))
                free = vehicle.airspace is None or vehicle.airspace.is_free(position, way[0])
                if gain > best and free:
                    best, leg = gain, np.array([position, way[0]])
            paths.append(leg)
        return Route(tuple(paths))
