"""The twin experiment: the readings are those that the observer would take of a truth, with noise.

y = H(truth) + e,    e ~ N(0, R)    with the covariance R that the readings' noise has (not what the filter is told)

With a ``lag`` T the sensors are slow, of the first order: instead of what it meets, c = H(truth), a sensor shows z,

    dz/dt = (c - z) / T,    z(0) = 0        y = z + e

solved exactly along its way, with c held from each of its readings back to the one before. The belief's observer does
not know of it. After 3 T a sensor that stands still shows 95 % of a sudden change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.covariances import colour
from dafw.core.ensemble import Memory, handed_over
from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import Request, Taken
from dafw.core.observation import Observation
from dafw.core.options import option
from dafw.core.sensor_response import reading_times
from dafw.core.space import Array


@dataclass
class Twin(Readings):
    """Reads the study's truth along the route; no reading is late."""

    needs_truth = True

    lag: float = option(
        0.0,
        "time constant of sensors that follow what they meet slowly, s; 0: at once. The filter is not told",
        minimum=0,
    )

    def initial_memory(self) -> Memory | None:
        """Return the memory of sensors in clean air; it has an entry for each sensor that took a reading."""
        return None if self.lag == 0.0 else {}

    def take_with_memory(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Return the one observation at the end of the cycle."""
        if request.truth is None:
            raise ContractError(f"{self.label} reads a truth, and the study has none")
        operator = request.operator
        shown = operator.apply(request.truth.members)[0]
        if self.lag > 0.0:
            shown, memory = self._lagged(shown, request, memory or {})
        noise = colour(operator.noise, rng.standard_normal(operator.size))
        return Taken([Observation(handed_over(shown + noise), operator, request.end)], memory)

    def _lagged(self, met: Array, request: Request, memory: Memory) -> tuple[Array, Memory]:
        """Return what sensors show (m,) that meet ``met`` (m,), and the memory: for each what it shows and when (s)."""
        sensors = request.operator.sensors
        if sensors is None and request.operator.size:
            raise ConfigurationError(
                f"{self.label}: lag = {self.lag:g} s needs to know which sensor takes a reading, which the observer "
                f"does not tell (ObservationOperator.sensors)"
            )
        memory, shown = dict(memory), np.empty_like(met)
        times = reading_times(sensors or (), request.start, request.end)
        for number, (sensor, time) in enumerate(zip(sensors or (), times, strict=True)):
            before, last = memory.get(sensor, (0.0, 0.0))
            shown[number] = met[number] + (before - met[number]) * np.exp(-(time - last) / self.lag)
            memory[sensor] = np.array([shown[number], time])
        return shown, memory
