"""Model: how the state evolves, and what a first guess of it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Forecast, Memory, Step, handed_over
from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.plugin import Plugin
from dafw.core.rng import MemberStreams
from dafw.core.sharing import Shared
from dafw.core.space import Array, StateSpace


class Model(Plugin):
    """How the state evolves from t to t + dt, and what a first guess of it is.

    Authors set ``space`` and ``dt`` (seconds), and ``domain`` where the state has places, and define ``initial`` and
    ``step`` (or ``step_with_memory``).

    >>> class Decay(Model):
    ...     space, dt = StateSpace([Variable("level", 2)]), 1.0
    ...     def initial(self, n_members, rng): return rng.standard_normal((n_members, 2))
    ...     def step(self, members, t, rng): return 0.5 * members
    >>> Decay().forecast(Ensemble([[2.0, 4.0]], Decay.space), None, None).ensemble.members
    array([[1., 2.]])
    """

    kind = "model"
    space: StateSpace
    dt: float
    domain: Domain | None = None

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return draws (N, n) from the first guess; row i from ``rng[i]`` alone."""
        raise NotImplementedError(f"{self.label} must define initial(n_members, rng)")

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt, model error included."""
        raise NotImplementedError(f"{self.label} must define step(members, t, rng)")

    def settled(self, members: Array) -> Array:
        """Return members (N, n) at the start with their fields recomputed from their parameters.

        A filter that moves the place of a release calls this to get the cloud of the new place. By default no field
        depends on a parameter.
        """
        return members

    def log_first_guess(self, members: Array) -> Array:
        """Return the log density (N,) of the first guess at members (N, n) at the start.

        It is the density of the numbers that the fields are recomputed from. It integrates to one, since importance
        sampling mixes it with other densities. Impossible members have minus infinity.
        Filters that weight members need it. Raises ConfigurationError unless a model defines it.
        """
        raise ConfigurationError(
            f"{self.label} does not tell how likely its first guesses are, which the filter needs: it must define "
            f"log_first_guess(members)"
        )

    def require_log_first_guess(self) -> None:
        """Raise ConfigurationError if the model does not define ``log_first_guess``; called before a run begins."""
        if type(self).log_first_guess is Model.log_first_guess:
            self.log_first_guess(np.empty((0, 0)))

    def coarser(self) -> Model:
        """Return a cheaper version of the model, for filters that search with it and report with the model itself.

        It has the same variables and time step; those with places may have them elsewhere. Raises ConfigurationError
        unless a model defines it.
        """
        raise ConfigurationError(f"{self.label} has no coarser version, which the filter or the policy needs")

    def notes(self) -> list[str]:
        """Return sentences for the log about what the model was built from."""
        return []

    def share_with(self, shared: Shared) -> None:
        """Use ``shared`` for what this model has in common with the other models of a run.

        Called when a run is prepared, before anything is computed. A model that has nothing to share does nothing.
        """

    def distribute(self, communicator: Any) -> None:
        """Distribute the work of every step among the ranks of an MPI communicator; called before anything is computed.

        Afterwards all ranks make the same calls in the same order, and each gets the full result. Raises
        ConfigurationError unless a model overrides it: without that it works in one process.
        """
        raise ConfigurationError(f"{self.label} works in one process: run it without mpirun")

    def require_available(self) -> None:
        """Raise ConfigurationError if something that the options name does not exist; called before a run begins."""

    def pinned_options(self) -> Mapping[str, Any]:
        """Return options that override the configured ones, so that other processes make exactly the same model.

        They settle what the configuration leaves open: instead of "the newest basis", the name of that basis.
        """
        return {}

    def initial_memory(self, members: Array) -> Memory | None:
        """Return the memory that the first step of these members (N, n) needs; arrays have the members on axis 0."""
        return None

    def step_with_memory(self, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Return the step of a model that remembers."""
        return Step(self.step(members, t, rng))

    def steps_with_memory(
        self, members: Array, memory: Memory | None, t: float, rng: MemberStreams, n_steps: int
    ) -> Sequence[Step]:
        """Return one or more of the next ``n_steps`` steps, as many as are best made at once.

        Override it where several steps together take less time; the bits must be those of single steps. ``rng`` holds
        the streams of the first step, ``rng.later(k)`` those of step k, counted from 0.
        """
        return [self.step_with_memory(members, memory, t, rng)]

    def first_guess(self, n_members: int, rng: MemberStreams) -> Forecast:
        """Draw, check and wrap the initial ensemble; raises ContractError."""
        members = self.checked(self.initial(n_members, rng), (n_members, self.space.size), "initial members")
        return Forecast(Ensemble(members, self.space), self.initial_memory(members))

    def checked_log_density(self, members: Array, *, drawn: bool = False) -> Array:
        """Return ``log_first_guess`` (N,) of members (N, n); raises ContractError for another shape, NaN or +infinity.

        Members that the model has ``drawn`` as first guesses are possible: for -infinity the error is raised, too.
        """
        density = np.asarray(self.log_first_guess(members), dtype=np.float64)
        if density.shape != (len(members),):
            raise ContractError(f"{self.label}: log_first_guess must return ({len(members)},), got {density.shape}")
        if not (density < np.inf).all():
            raise ContractError(f"{self.label}: log_first_guess must return numbers below infinity, got {density}")
        if drawn and (impossible := np.flatnonzero(density == -np.inf)).size:
            raise ContractError(
                f"{self.label}: log_first_guess calls {impossible.size} of {len(members)} first guesses impossible "
                f"that the model itself has drawn, such as that of member {impossible[0]}; it must be the density of "
                f"what initial draws"
            )
        return density

    def forecast(self, ensemble: Ensemble, memory: Memory | None, rng: MemberStreams) -> Forecast:
        """Step the ensemble by dt; raises ContractError if the result has another shape or is not finite."""
        return self.stepped(ensemble, self.step_with_memory(ensemble.members, memory, ensemble.time, rng))

    def stepped(self, ensemble: Ensemble, step: Step) -> Forecast:
        """Check and wrap the result of a step of the ensemble, made in any process; the members keep their weights.

        Raises ContractError, and DivergenceError if numbers are far beyond what the model can produce.
        """
        members = self.checked_members(step.members, ensemble.members.shape, "members after a step", self.space)
        self.checked_diagnostics(step.diagnostics)
        stepped = Ensemble(handed_over(members), self.space, ensemble.time + self.dt, ensemble.weights)
        return Forecast(stepped, step.memory, step.diagnostics)
