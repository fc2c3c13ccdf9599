"""Local correction: what no parameter explains is corrected in the field, near the readings only.

It wraps another filter, the base, which never sees the corrections. Each member of the belief is a member of the base
plus one field e, the same for all members::

    c_i = max(0, b_i + e)

Between two readings the model carries members with and without the correction; the weighted mean of the differences is
the e of the next cycle, whatever parameters the base has moved its members to. So a correction travels with the wind.

A reading y_k at the place x_k, of which the corrected members predict h_ik, changes e by a localized Kalman gain ::

    d_k   = y_k - mean_i h_ik                          innovation, at most one expected standard deviation S_kk^(1/2)
    S_kl  = s^2 rho_kl cov_i(h_ik, h_il) + R_kl + delta_kl (a^2 + (r max(|y_k|, |mean h_k|))^2)
    e(x) += sum_k K_k(x) d_k,    K = C S^-1,           C_k(x) = s^2 rho(x, x_k) cov_i(c_i(x), h_ik)
    |change of e(x)| <= sum_k rho(x, x_k) |d_k|

rho is the function of Gaspari and Cohn (1999, Eq. 4.10, doi:10.1002/qj.49712555417) of the way around buildings between
the two places; it is zero from ``radius`` on. By the last line the integral of the field changes by no more than the
readings say: by the sum of |d_k| times the integrals of rho. Where no member has gas, none is made.

A correction has to prove itself. Before the readings change it, e is multiplied by the share a that they confirm ::

    a = (1 + sum_k (y_k - mean h_ik(b)) u_k / r_k) / (1 + sum_k u_k^2 / r_k), at least 0 and at most 1
    u_k = mean h_ik(c) - mean h_ik(b)

that is, by a least-squares fit with one assumed confirmation. So what was corrected while the base was still wrong is
dropped once the base is right.

The scale s^2 says how much larger the model's error is than the members' spread. It is estimated from the innovations
of the past cycles, with v_k = cov(h_k, h_k) and all that is not the members' in r_k = S_kk - s^2 v_k ::

    s^2 = sum_k g_k (d_k^2 - r_k) v_k / (1 + sum_k g_k v_k^2),   g_k = exp(-age / forgetting) / (v_k + r_k)^2

and is 0 if that is negative: where the base explains the readings to within R, a and r, nothing is corrected. This is
the least-squares fit of d^2 = s^2 v + r with one assumed reading that says s = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Analysis, Diagnostic, Ensemble, Forecast, Memory
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Filter
from dafw.core.options import option
from dafw.core.registry import registry
from dafw.core.space import FIELD, NONNEGATIVE, Array, IntArray, StateSpace, Variable
from dafw.core.spans import cycles_of
from dafw.core.window import Window
from dafw.plugins.filters.localization import gaspari_cohn, not_negative
from dafw.plugins.filters.wrapped import BASE, MODEL, part_of


@dataclass
class Local(Filter):
    """Another filter, and on top of it corrections of the field near the readings."""

    accuracy = "none"
    past_beliefs = "first"
    inflation_option = None

    base: dict[str, Any] = option({"name": "amis"}, "the filter that is corrected: a mapping with its name and options")
    radius: float = option(
        40.0, "metres, by the way around buildings, from which on a reading changes nothing", above=0
    )
    absolute: float = option(0.002, "size of errors that are not corrected, in units of the readings", minimum=0.0)
    relative: float = option(0.1, "the same, relative to the larger of reading and prediction", minimum=0.0)
    largest: float = option(3.0, "largest factor s on the members' spread", above=0.0)
    forgetting: float = option(20.0, "seconds after which an innovation counts 1/e for the factor", above=0.0)
    variable: str | None = option(None, "state variable that is corrected; null: the first with places")

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a base that needs few runs of the model."""
        return {"base": {"name": "amis", "enough": 0.5, "steps": 600, "archive": 3}}

    def __post_init__(self) -> None:
        self._base: Filter = registry().create("filter", self.base)
        if self._base.window not in (0, None) or (self._base.window is None and self._base.past_beliefs != "first"):
            raise ConfigurationError(
                f"filter 'local': the base {self._base.label} needs past beliefs, which are corrected ones; "
                f"expected a filter that looks back to the start and needs the first belief only, such as amis, or "
                f"one that does not look back"
            )
        self.window = 1 if self._base.window == 0 else None
        self.weighs_first_guess = self._base.weighs_first_guess

    def require_members(self, n_members: int) -> None:
        """Raise ConfigurationError if the base cannot work with so few members."""
        self._base.require_members(n_members)

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError if the base does not suit, or no variable can be corrected."""
        self._base.suit(space, n_members)
        self._variable(space)

    def initial_memory(self, n_members: int) -> Memory | None:
        """Return the base's memory."""
        memory = self._base.initial_memory(n_members)
        return None if memory is None else {f"{BASE}{name}": array for name, array in memory.items()}

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether the base has more to do."""
        return self._base.unfinished(part_of(memory, BASE))

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the base's analysis with the correction so far, as the model carried it, and the new one."""
        corrected = window.forecast.ensemble
        space, time = corrected.space, corrected.time
        forecast, memory = self._base_forecast(window)
        base = self._base_analysis(window, forecast, rng)
        correction = np.zeros(space.size)
        part = space.slice(self._variable(space).name)
        correction[part] = corrected.average(corrected.members[:, part] - forecast.ensemble.members[:, part])
        plain = corrected.with_members(base.members, base.weights)
        confirmed = self._confirmed(window, plain, correction)
        correction *= confirmed
        now = plain.with_members(space.retract(base.members, correction), base.weights)
        sums = np.array([0.0, 1.0])  # of the fraction that is s^2
        if "sums" in memory:
            sums = sums + np.exp((memory["time"] - time) / self.forgetting) * (memory["sums"] - sums)
        change, factor, sums = self._change(window, now, sums)
        # A base that needs no correction stays as it is, to the last bit.
        moved = (correction + change).any()
        members = space.retract(base.members, correction + change) if moved else base.members
        model_memory = forecast.memory if base.model_memory is None else base.model_memory
        kept: dict[str, Any] = {"members": base.members, "done": np.array(window.cycles[-1].number + 1)}
        kept |= {"sums": sums, "time": np.array(time)} | ({} if base.weights is None else {"weights": base.weights})
        kept |= {f"{BASE}{name}": array for name, array in (base.memory or {}).items()}
        kept |= {f"{MODEL}{name}": array for name, array in (model_memory or {}).items()}
        added = np.abs(now.average(members[:, part] - base.members[:, part])).sum()
        diagnostics = {
            **base.diagnostics,
            "local_factor": Diagnostic(factor, long_name="factor on the members' spread in the local correction"),
            "local_confirmed": Diagnostic(confirmed, long_name="share of the past correction that readings confirm"),
            "local_correction": Diagnostic(added, long_name="sum over nodes of the local correction's absolute value"),
        }
        return replace(base, members=members, memory=kept, model_memory=model_memory, diagnostics=diagnostics)

    def _variable(self, space: StateSpace) -> Variable:
        """Return the variable that is corrected; raises ConfigurationError if there is none."""
        of_name = space.variables if self.variable is None else (space[self.variable],)
        fitting = [v for v in of_name if v.coordinates is not None and v.kind in (FIELD, NONNEGATIVE)]
        if not fitting:
            names = ", ".join(f"'{v.name}' ({v.kind.value})" for v in of_name)
            raise ConfigurationError(
                f"{self.label}: expected a variable with places, of the kind field or nonnegative, got {names}"
            )
        return fitting[0]

    def _base_forecast(self, window: Window) -> tuple[Forecast, Memory]:
        """Return the base's members, without corrections, at the end of the present cycle, and this filter's memory."""
        memory: Memory = window.memory or {}
        number = window.cycles[-1].number
        if "done" not in memory:
            return window.forecast, memory
        before = Ensemble(memory["members"], window.forecast.ensemble.space, float(memory["time"]))
        before = before.with_members(before.members, memory.get("weights"))
        start = Forecast(before, part_of(memory, MODEL))
        return window.rerun(start, int(memory["done"]), number + 1).forecast, memory

    def _base_analysis(self, window: Window, forecast: Forecast, rng: np.random.Generator) -> Analysis:
        """Return the base's analysis of its own forecast."""
        of_base = part_of(window.memory, BASE)
        seen = window.observation
        predicted = seen.operator.apply(forecast.ensemble.members)
        if self._base.window == 0:
            return self._base.update(forecast.ensemble, predicted, seen, of_base, rng)
        predicted.setflags(write=False)
        inner = replace(window, forecast=forecast, predicted=predicted, memory=of_base)
        return self._base.look_back(inner, rng)

    def _readings(self, window: Window, belief: Ensemble) -> tuple[IntArray, Array, Array]:
        """Return which readings (m,) are used, what the members of a belief predict for them (N, m), and R (m, m).

        They have a place, and are no means over earlier cycles. R includes the errors that are not corrected.
        """
        seen, operator = window.observation, window.observation.operator
        places = np.empty((seen.values.size, 0)) if operator.coordinates is None else operator.coordinates
        at_once = cycles_of(operator, window.rerun.dt) == 1
        used = np.flatnonzero(np.isfinite(places).all(axis=1) & (places.shape[1] > 0) & at_once)
        predicted = operator.apply(belief.members)[:, used]
        R = operator.covariance if operator.covariance.ndim == 2 else np.diag(operator.covariance)  # noqa: N806
        largest = np.maximum(np.abs(seen.values[used]), np.abs(belief.average(predicted)))
        return used, predicted, R[np.ix_(used, used)] + np.diag(self.absolute**2 + (self.relative * largest) ** 2)

    def _confirmed(self, window: Window, plain: Ensemble, correction: Array) -> float:
        """Return the share a of the correction (n,) of the belief ``plain`` that the present readings confirm."""
        if not correction.any():
            return 1.0
        used, predicted, R = self._readings(window, plain)  # noqa: N806
        corrected = window.observation.operator.apply(plain.space.retract(plain.members, correction))[:, used]
        mean, r = plain.average(predicted), np.diag(R)
        added = plain.average(corrected) - mean
        wanted = window.observation.values[used] - mean
        return float(np.clip((1.0 + (wanted * added / r).sum()) / (1.0 + (added**2 / r).sum()), 0.0, 1.0))

    def _change(self, window: Window, belief: Ensemble, sums: Array) -> tuple[Array, float, Array]:
        """Return what the present readings change of the correction (n,), the factor s, and the sums with them."""
        space, operator = belief.space, window.observation.operator
        factor = float(np.sqrt(np.clip(sums[0] / sums[1], 0.0, self.largest**2)))
        change = np.zeros(space.size)
        used, predicted, R = self._readings(window, belief)  # noqa: N806
        if not len(used):
            return change, factor, sums
        places, values = np.asarray(operator.coordinates)[used], window.observation.values[used]
        mean, anomalies = belief.average(predicted), self._anomalies(belief, predicted)
        part = space.slice(self._variable(space).name)
        domain = window.rerun.domain
        between = self._nearness(domain, places, places)
        spread = not_negative(between * (anomalies.T @ anomalies))
        missed, v, r = values - mean, np.diag(spread), np.diag(R)
        weight = 1.0 / (v + r) ** 2
        sums = sums + np.array([(weight * (missed**2 - r) * v).sum(), (weight * v**2).sum()])
        if factor == 0.0:
            return change, factor, sums
        S = factor**2 * spread + R  # noqa: N806
        expected = np.sqrt(np.diag(S))
        missed = np.clip(missed, -expected, expected)
        near = self._nearness(domain, places, np.asarray(self._variable(space).coordinates))
        C = factor**2 * near * (anomalies.T @ self._anomalies(belief, belief.members[:, part]))  # noqa: N806
        limit = np.abs(missed) @ near
        change[part] = np.clip(np.linalg.solve(S, missed) @ C, -limit, limit)
        return change, factor, sums

    def _anomalies(self, belief: Ensemble, values: Array) -> Array:
        """Return values (N, k) of the members less their mean, scaled so that A^T A is the covariance."""
        shares = np.full(len(belief), 1.0 / len(belief)) if belief.weights is None else belief.weights
        rest = 1.0 - shares @ shares
        if rest <= 1e-12:
            return np.zeros_like(values)
        return np.sqrt(shares / rest)[:, np.newaxis] * (values - belief.average(values))

    def _nearness(self, domain: Domain | None, places: Array, others: Array) -> Array:
        """Return rho (m, k) between places (m, d) and others (k, d)."""
        rows = []
        for place in places:
            if domain is None or others.shape[1] != 2:
                rows.append(np.linalg.norm(others - place, axis=1))
            else:
                rows.append(domain.distances(place, others, self.radius))
        return gaspari_cohn(np.array(rows) / (0.5 * self.radius))
