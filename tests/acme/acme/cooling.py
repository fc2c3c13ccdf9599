"""A model that knows nothing of dafw: a function."""

import numpy as np

from dafw import NONNEGATIVE, StateSpace, Variable, model_from_function


def cooling(members, t, dt, *, rate: float = 0.1):
    """Newton's law of cooling, in place."""
    members *= np.exp(-rate * dt)
    return members


Cooling = model_from_function(
    cooling,
    space=StateSpace([Variable("temperature", 6, NONNEGATIVE, units="K")]),
    initial=lambda generator: 20.0 * generator.random(6),
)
