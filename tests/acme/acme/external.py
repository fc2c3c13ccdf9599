"""A model that is an external program."""

import sys
from dataclasses import dataclass
from pathlib import Path

from dafw import ProgramModel, StateSpace, Variable, option


@dataclass
class Solver(ProgramModel):
    """Runs solver.py, one process for each member."""

    command = (sys.executable, "-I", "-S", str(Path(__file__).with_name("solver.py")))

    rate: float = option(0.1, "decay rate in 1/s", minimum=0.0)
    dt: float = option(1.0, "time step in seconds", above=0.0)

    def __post_init__(self):
        self.space = StateSpace([Variable("temperature", 3, units="K")])

    def initial(self, n_members, rng):
        """Return draws (N, n) from the first guess."""
        return rng.standard_normal((n_members, 3))

    def arguments(self):
        """Return what follows the command."""
        return (str(self.rate),)
