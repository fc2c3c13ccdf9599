"""Linear advection on a circle: a model whose forecast is known in closed form.

::

    du/dt + c du/dx = 0 on [0, L), periodic;    u(x, t) = u(x - c t, 0)

The upwind scheme with the Courant number C = |c| dt / dx is first order, and exact (a shift by one cell) for C = 1::

    u_i <- (1 - C) u_i + C u_{i-1}        for c >= 0, else u_{i+1}

Courant, Isaacson and Rees (1952), doi:10.1002/cpa.3160050303. As a test of filters: Evensen (2004),
doi:10.1007/s10236-004-0096-8.

The model error of each member is error_sd q. It may be correlated in time: with the correlation a from one step to the
next and standard normal numbers w, q is kept in the model's memory, ::

    q_k = a q_{k-1} + sqrt(1 - a^2) w_k,    q_0 = 0

Evensen (2003), eq. 42, doi:10.1007/s10236-003-0036-9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Memory, Step
from dafw.core.errors import OptionError
from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import FIELD, Array, StateSpace, Variable

SEEN_BY_NOBODY = 10.0
"""Standard deviations from the mean beyond which a draw of a normal distribution practically never lies."""


@dataclass
class LinearAdvection(Model):
    """A linear model with a Gaussian first guess: with Gaussian readings the Kalman filter is exact.

    The first guess is a sum of waves with independent normal coefficients, of zero mean and unit variance everywhere:
    (a_0 + sum_k a_k cos(2 pi k x / L) + b_k sin(2 pi k x / L)) / sqrt(1 + waves), k = 1 ... waves.
    Raises OptionError for a Courant number above 1, where the scheme is unstable.
    """

    cells: int = option(100, "number of cells n", minimum=2)
    length: float = option(100.0, "length L of the circle in metres", above=0.0)
    speed: float = option(1.0, "speed c in m/s, positive or negative")
    dt: float = option(1.0, "length of a step in seconds", above=0.0)
    waves: int = option(10, "number of waves in the first guess, in addition to the constant", minimum=0)
    error_sd: float = option(0.0, "standard deviation of the model error added to every cell in a step", minimum=0.0)
    error_correlation: float = option(
        0.0,
        "correlation of the model error from one step to the next; if above 0, the error is a memory of the model",
        minimum=0.0,
    )

    def __post_init__(self) -> None:
        self.courant = abs(self.speed) * self.dt * self.cells / self.length
        if self.courant > 1.0 + 1e-12:
            raise OptionError(
                f"model 'linear_advection': the Courant number |speed| dt cells / length must be at most 1, "
                f"got {self.courant:.6g}"
            )
        if self.error_correlation >= 1.0:
            raise OptionError(
                f"model 'linear_advection': error_correlation must be below 1, got {self.error_correlation:g}"
            )
        self.x: Array = np.linspace(0.0, self.length, self.cells, endpoint=False)
        # The scheme itself never increases the largest absolute value, but model errors add up without bound.
        plausible = SEEN_BY_NOBODY if self.error_sd == 0.0 else np.inf
        places = self.x[:, np.newaxis]
        self.space = StateSpace([Variable("u", self.cells, FIELD, "1", places, "amplitude", plausible)])

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return draws (N, n) of the random waves."""
        phase = 2.0 * np.pi / self.length * np.outer(np.arange(1, self.waves + 1), self.x)
        shapes = np.concatenate([np.ones((1, self.cells)), np.cos(phase), np.sin(phase)])
        return rng.standard_normal((n_members, len(shapes))) @ shapes / np.sqrt(1.0 + self.waves)

    def initial_memory(self, members: Array) -> Memory | None:
        """Return the model error (N, n) before the first step: zero. Uncorrelated errors need no memory (None)."""
        return {"error": np.zeros(members.shape)} if self.error_correlation > 0.0 else None

    def step_with_memory(self, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Return the members (N, n) at t + dt, and their model errors."""
        if memory is None:
            return Step(self.step(members, t, rng))
        new = np.sqrt(1.0 - self.error_correlation**2) * rng.standard_normal(members.shape)
        error = self.error_correlation * np.asarray(memory["error"]) + new
        return Step(self._moved(members) + self.error_sd * error, {"error": error})

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt, with uncorrelated model errors."""
        moved = self._moved(members)
        return moved + self.error_sd * rng.standard_normal(members.shape) if self.error_sd else moved

    def _moved(self, members: Array) -> Array:
        upwind = np.roll(members, 1 if self.speed >= 0.0 else -1, axis=1)
        # In this form C = 1 moves the numbers without rounding them.
        return np.asarray((1.0 - self.courant) * members + self.courant * upwind)
