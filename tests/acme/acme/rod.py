"""A rod that is heated at random and loses heat at its ends."""

from dataclasses import dataclass

import numpy as np

from dafw import Model, StateSpace, Variable, option


@dataclass
class Rod(Model):
    """Explicit finite differences; the numbers are temperatures above that of the room."""

    cells: int = option(20, "number of cells", minimum=3)
    diffusivity: float = option(0.2, "share of a difference that is levelled in a step", minimum=0.0, maximum=0.5)
    heating: float = option(0.1, "standard deviation of the heating in a step, K", minimum=0.0)
    dt: float = option(1.0, "time step in seconds", above=0.0)

    def __post_init__(self):
        places = np.stack([np.linspace(0.0, 10.0, self.cells), np.zeros(self.cells)], axis=1)
        self.space = StateSpace([Variable("temperature", self.cells, units="K", coordinates=places)])

    def initial(self, n_members, rng):
        """Return draws (N, n) from the first guess: one bump of unknown height."""
        return rng.standard_normal((n_members, 1)) * np.sin(np.linspace(0.0, np.pi, self.cells))

    def step(self, members, t, rng):
        """Return the members (N, n) at t + dt."""
        padded = np.pad(members, ((0, 0), (1, 1)))
        spread = self.diffusivity * (padded[:, 2:] - 2.0 * members + padded[:, :-2])
        return members + spread + self.heating * rng.standard_normal(members.shape)
