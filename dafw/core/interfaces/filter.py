"""Filter: how the readings change the belief."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble, Forecast, Memory
from dafw.core.errors import ConfigurationError, ContractError, DivergenceError
from dafw.core.observation import Observation
from dafw.core.plugin import Plugin, described
from dafw.core.space import Array, StateSpace

if TYPE_CHECKING:
    from dafw.core.window import Window


class Filter(Plugin):
    """How the readings change the belief.

    ``accuracy`` says how the mean and covariance of an analysis agree with the Kalman filter's for a linear model with
    Gaussian errors: ``exact`` for the given sample, ``statistical`` in the limit of many members, ``none``: no claim.
    ``localization_option`` names the option that is the localization radius in metres, if there is one.
    ``inflation_option`` names the option that is the factor on the anomalies; None if there is none, or if the
    filter's ``inflation`` means something else.

    ``weighs_first_guess``: the filter needs to know how likely a first guess is (``Model.log_first_guess``).
    ``uses_coarser``: it needs a cheaper version of the model (``Model.coarser``).

    A filter that looks back defines ``analyse_window`` instead of ``analyse``. Its ``window`` is the number of cycles
    that it looks back over, the present one included; None: all since the start. ``past_beliefs`` says whether it
    needs the belief at the beginning of every cycle of the window, or (with ``window`` None) only that at the
    beginning of the first, which takes far less memory.

    >>> class Midway(Filter):
    ...     def analyse(self, forecast, predicted, observation, rng):
    ...         missed = (observation.values - predicted).mean(axis=1, keepdims=True)
    ...         return Analysis(forecast.space.retract(forecast.members, 0.5 * missed))
    >>> belief = Ensemble([[0.0], [2.0]], StateSpace([Variable("level", 1)]))
    >>> seen = Observation([3.0], Selection(indices=np.array([0]), covariance=np.array([1.0])))
    >>> Midway().update(belief, np.array(belief.members), seen, None, None).members
    array([[1.5],
           [2.5]])
    """

    kind = "filter"
    window: int | None = 0
    smallest_ensemble: ClassVar[int] = 2
    accuracy: ClassVar[str] = "statistical"
    localization_option: ClassVar[str | None] = None
    weighs_first_guess: bool = False
    uses_coarser: bool = False
    inflation_option: ClassVar[str | None] = "inflation"
    past_beliefs: ClassVar[Literal["all", "first"]] = "all"

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return the analysis of a forecast whose members predict the readings ``predicted`` (N, m)."""
        raise NotImplementedError(f"{self.label} must define analyse(forecast, predicted, observation, rng)")

    def initial_memory(self, n_members: int) -> Memory | None:
        """Return the memory that the first analysis is given."""
        return None

    def analyse_with_memory(
        self,
        forecast: Ensemble,
        predicted: Array,
        observation: Observation,
        memory: Memory | None,
        rng: np.random.Generator,
    ) -> Analysis:
        """Return the analysis of a filter that remembers."""
        return self.analyse(forecast, predicted, observation, rng)

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the analysis of a filter that looks back over a window of cycles; ``window.memory`` is its memory.

        The analysis may hold revised beliefs at earlier times, and the model's memory that belongs to the new members.
        """
        raise NotImplementedError(f"{self.label} has a window and must define analyse_window(window, rng)")

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether a filter that looks back wants to be called in a cycle although that has no new readings.

        ``memory`` is what its last analysis returned. A filter may have stopped there because its time was up, or may
        have put readings off until a later cycle.
        """
        return False

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError if the filter cannot work with a state space or a number of members."""

    def require_members(self, n_members: int) -> None:
        """Raise ConfigurationError if the filter cannot work with so few members."""
        if n_members < self.smallest_ensemble:
            raise ConfigurationError(
                f"{self.label} needs at least {self.smallest_ensemble} members, the study has {n_members}"
            )

    def update(
        self,
        forecast: Ensemble,
        predicted: Array,
        observation: Observation,
        memory: Memory | None,
        rng: np.random.Generator,
    ) -> Analysis:
        """Analyse and check. Without readings the analysis is the forecast, moved into the range of each variable.

        Raises ContractError if the analysis breaks the interface, DivergenceError if the filter's linear algebra
        fails or its numbers are far beyond what the model can produce.
        """
        if observation.values.size == 0:
            return self._unchanged(forecast, memory)
        predicted = self.checked(predicted, (len(forecast), observation.values.size), "predicted readings")
        predicted.setflags(write=False)
        try:
            analysis = self.analyse_with_memory(forecast, predicted, observation, memory, rng)
        except np.linalg.LinAlgError as error:
            raise self._algebra_failed(forecast, error) from error
        return self._checked_analysis(analysis, forecast)

    def look_back(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Analyse a window and check, as ``update`` does.

        Without new readings the analysis is the forecast, unless the last one was ``unfinished``.
        """
        forecast = window.forecast.ensemble
        if window.observation.values.size == 0 and not window.late and not self.unfinished(window.memory):
            return self._unchanged(forecast, window.memory)
        try:
            analysis = self.analyse_window(window, rng)
        except np.linalg.LinAlgError as error:
            raise self._algebra_failed(forecast, error) from error
        checked = self._checked_analysis(analysis, forecast)
        there = range(window.cycles[0].number, window.cycles[-1].number + 1)
        for cycles, belief in checked.revised.items():
            what = f"the belief revised after {cycles} cycles"
            if cycles not in there:
                raise ContractError(
                    f"{self.label}: {what} lies outside its window, which goes back to cycle {there.start}"
                )
            if not isinstance(belief, Forecast):
                raise ContractError(f"{self.label}: {what} must be a Forecast, got {type(belief).__name__}")
            self.checked_members(belief.ensemble.members, forecast.members.shape, what, forecast.space)
        return checked

    def _unchanged(self, forecast: Ensemble, memory: Memory | None) -> Analysis:
        """Return the forecast, moved into the range of each variable (angles to [0, 2 pi), for example)."""
        members = forecast.space.retract(forecast.members, np.zeros(forecast.space.size))
        return Analysis(members, memory, weights=forecast.weights)

    def _algebra_failed(self, forecast: Ensemble, error: Exception) -> DivergenceError:
        """Return an error that names the most extreme number of the forecast."""
        return DivergenceError(
            f"{self.label}: its linear algebra failed ({error}); the forecast's most extreme number is "
            f"{described(forecast.space, forecast.members)}"
        )

    def _checked_analysis(self, analysis: Analysis, forecast: Ensemble) -> Analysis:
        """Return the analysis with its members as float64 (N, n); raises ContractError or DivergenceError."""
        if not isinstance(analysis, Analysis):
            raise ContractError(f"{self.label}: expected an Analysis, got {type(analysis).__name__}")
        shape, what = forecast.members.shape, "members after the analysis"
        members = self.checked_members(analysis.members, shape, what, forecast.space)
        self.checked_diagnostics(analysis.diagnostics)
        if analysis.weights is not None:
            try:
                forecast.with_members(members, analysis.weights)
            except ContractError as error:
                raise ContractError(f"{self.label}: {error}") from error
        return analysis if members is analysis.members else replace(analysis, members=members)
