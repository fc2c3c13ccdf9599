"""Thermometers at equal distances."""

from dataclasses import dataclass

import numpy as np

from dafw import Observer, Selection, StateSpace, Variable, option


@dataclass
class Probe(Observer):
    """Reads the temperature in cells at equal distances."""

    every: int = option(5, "cells from one thermometer to the next", minimum=1)
    noise_sd: float = option(0.1, "standard deviation of a reading's error, K", above=0.0)

    @classmethod
    def check_space(cls):
        """Return a state space with a temperature."""
        return StateSpace([Variable("pressure", 2), Variable("temperature", 12, units="K")])

    def operator(self, space, route, t):
        """Return the readings of all thermometers."""
        cells = np.arange(space.size)[space.slice("temperature")][:: self.every]
        return Selection(indices=cells, covariance=np.full(len(cells), self.noise_sd**2))
