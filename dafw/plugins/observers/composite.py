"""Several observers at once: their readings are stacked, their errors are independent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dafw.core.ensemble import Route
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator, stack
from dafw.core.options import REQUIRED, option
from dafw.core.registry import registry
from dafw.core.space import StateSpace


@dataclass
class Composite(Observer):
    """Combines other observers, for example a drone and stations."""

    parts: dict[str, Any] = option(
        REQUIRED, "the observers under names of your choice, each a mapping with the plugin's name and options"
    )

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a station and a drone."""
        return {"parts": {"pole": {"name": "stations", "positions": [[10.0, 10.0]]}, "drone": {"name": "drone"}}}

    def __post_init__(self) -> None:
        if not self.parts:
            raise ConfigurationError("observer 'composite': parts must name at least one observer")
        self._observers: list[Observer] = []
        for own_name, part in self.parts.items():
            if not isinstance(part, dict):
                raise ConfigurationError(f"observer 'composite': part '{own_name}' must be a mapping, got {part!r}")
            self._observers.append(registry().create("observer", part))

    def suit(self, space: StateSpace, dt: float) -> None:
        """Raise ConfigurationError if a part does not fit the state space or the time step."""
        for observer in self._observers:
            observer.suit(space, dt)

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return all parts' operators stacked, in the order of the configuration."""
        return stack(tuple(observer.look(space, route, t) for observer in self._observers))
