"""Lorenz-96: a chaotic system of a few dozen numbers on a circle, the usual test case of ensemble filters.

::

    dx_i/dt = (x_{i+1} - x_{i-2}) x_{i-1} - x_i + F,    i modulo n

The time integration is the classical fourth-order Runge-Kutta scheme. One unit of the model's time corresponds to about
five days of weather. The framework treats it as one second, so ``dt = 0.05`` and a run's time are in model units.

Lorenz (1996), Predictability - a problem partly solved; the setting of n = 40, F = 8, dt = 0.05 is that of Sakov and
Oke (2008), doi:10.1175/2007MWR2021.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from dafw.core.ensemble import freeze
from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import Array, IntArray, StateSpace, Variable


@cache
def _around(size: int) -> IntArray:
    """Return the indices -2, -1, 0, ..., n - 1, 0: of rows in this order, neighbours are slices."""
    return np.arange(-2, size + 1) % size


def tendency(x: Array, forcing: float) -> Array:
    """Return dx/dt of states x (n, N), one a column."""
    wide = x.take(_around(len(x)), axis=0)
    change = wide[3:] - wide[:-3]
    change *= wide[1:-2]
    change -= x
    change += forcing
    return change


def runge_kutta_4(x: Array, forcing: float, dt: float) -> Array:
    """Return the states (n, N) after a step of length dt."""
    k1 = tendency(x, forcing)
    k2 = tendency(x + 0.5 * dt * k1, forcing)
    k3 = tendency(x + 0.5 * dt * k2, forcing)
    k4 = tendency(x + dt * k3, forcing)
    k2 += k3
    k2 *= 2.0
    k1 += k2
    k1 += k4
    k1 *= dt / 6.0
    return x + k1


@lru_cache(maxsize=8)
def spun_up(size: int, forcing: float, dt: float, n_steps: int) -> Array:
    """Return the state (n,) after ``n_steps`` steps from a fixed wave."""
    state = forcing + np.sin(2.0 * np.pi * np.arange(size) / size)[:, np.newaxis]
    for _ in range(n_steps):
        state = runge_kutta_4(state, forcing, dt)
    return freeze(state[:, 0])


@dataclass
class Lorenz96(Model):
    """The model without error.

    The first guess is N(b, first_guess_sd^2 I). Its mean b is the same for every seed: the state after ``spinup``
    steps from a fixed wave, which lies on the attractor. The truth is drawn from the first guess, too, so the spread of
    the first belief matches its error.
    """

    size: int = option(40, "number n of variables on the circle", minimum=4)
    forcing: float = option(8.0, "forcing F; the model is chaotic from about 5 on")
    dt: float = option(0.05, "length of a step in the model's units of time, which are treated as seconds", above=0.0)
    first_guess_sd: float = option(1.0, "standard deviation of the first guess", minimum=0.0)
    spinup: int = option(
        400, "number of steps from a fixed wave to the state that is the mean of the first guess", minimum=0
    )

    def __post_init__(self) -> None:
        # The sum of x^2 decreases wherever it exceeds n F^2. The first guess may lie beyond that: without spin-up its
        # mean is at most F + 1, and the root mean square of a draw's n deviations stays below four standard deviations.
        largest = np.sqrt(self.size) * (abs(self.forcing) + 1.0 + 4.0 * self.first_guess_sd)
        self.space = StateSpace([Variable("x", self.size, long_name="Lorenz-96 variable", plausible=float(largest))])

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return draws (N, n) around the spun-up state."""
        centre = spun_up(self.size, self.forcing, self.dt, self.spinup)
        return centre + self.first_guess_sd * rng.standard_normal((n_members, self.size))

    def log_first_guess(self, members: Array) -> Array:
        """Return the log density (N,) of normal distributions about the spun-up state."""
        if self.first_guess_sd == 0.0:
            return np.zeros(len(members))
        misfit = (members - spun_up(self.size, self.forcing, self.dt, self.spinup)) / self.first_guess_sd
        constant = self.size * np.log(self.first_guess_sd * np.sqrt(2.0 * np.pi))
        return np.asarray(-0.5 * np.einsum("ij,ij->i", misfit, misfit) - constant)

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt."""
        # With the members on the last axis neighbours are whole rows, which is twice as fast.
        return runge_kutta_4(np.ascontiguousarray(members.T), self.forcing, self.dt).T
