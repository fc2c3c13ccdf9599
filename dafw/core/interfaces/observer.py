"""Observer: what instruments would read, and how well."""

from __future__ import annotations

from dafw.core.ensemble import Ensemble, Route
from dafw.core.errors import ContractError
from dafw.core.observation import ObservationOperator
from dafw.core.plugin import Plugin
from dafw.core.space import Array, StateSpace


class Observer(Plugin):
    """What instruments would read, and how well.

    >>> class First(Observer):
    ...     def operator(self, space, route, t):
    ...         return Selection(indices=np.array([0]), covariance=np.array([0.01]))
    >>> space = StateSpace([Variable("level", 2)])
    >>> First().look(space, Route(), 0.0).apply(np.array([[2.0, 4.0]]))
    array([[2.]])
    """

    kind = "observer"

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return H and R of the readings of a state in ``space`` taken along ``route``.

        The route begins at t (seconds) and takes ``route.dt`` seconds. The observer may report numbers about it in the
        ``diagnostics`` of the operator.
        """
        raise NotImplementedError(f"{self.label} must define operator(space, route, t)")

    def suit(self, space: StateSpace, dt: float) -> None:
        """Raise ConfigurationError if the options do not fit a state space and a time step (seconds)."""

    def look(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Ask for the operator and check that it is one; raises ContractError."""
        operator = self.operator(space, route, t)
        if not isinstance(operator, ObservationOperator):
            raise ContractError(f"{self.label}: expected an ObservationOperator, got {type(operator).__name__}")
        self.checked_diagnostics(operator.diagnostics)
        return operator

    def read(self, operator: ObservationOperator, ensemble: Ensemble) -> Array:
        """Return what each member would read (N, m), checked; raises ContractError."""
        return self.checked(operator.apply(ensemble.members), (len(ensemble), operator.size), "predicted readings")
