"""Proposals made of Student t kernels about centres, of several widths: drawn from, and their density.

The density of one proposal is the mean over its centres c and the widths h of ::

    t_5(z; c, h^2 C)

a multivariate t distribution of five degrees of freedom with location c and scale matrix h^2 C, whose heavy tails keep
the weights of importance sampling bounded. Angles wrap: what is drawn a turn away counts here, so that the density
integrates to one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import lgamma, log, pi
from typing import Any

import numpy as np

from dafw.core.ensemble import Memory
from dafw.core.space import Array
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.weights import effective_size, systematic

DEGREES = 5.0
WIDTHS = np.array([1.0, 0.3])
"""Relative widths: as wide as the samples ask for, and narrower, for a posterior that is narrower than the samples."""
SMALLEST_SD = 1e-6
"""Standard deviation of a coordinate that is added to that of the samples: they may all have the same value."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """B proposals: ``centres`` (B, c, k), and ``factors`` (B, k, k), the Cholesky factors of their C."""

    controls: Controls | None
    centres: Array
    factors: Array

    @classmethod
    def none(cls, k: int) -> Kernels:
        """Return no proposals for k coordinates."""
        return cls(None, np.empty((0, 1, k)), np.empty((0, k, k)))

    @classmethod
    def around(
        cls, controls: Controls, coordinates: Array, weights: Array, n_centres: int, rng: np.random.Generator
    ) -> Kernels:
        """Return one proposal about ``n_centres`` samples (P, k) drawn from the weights, with their covariance."""
        k = len(controls)
        offset = controls.offset(coordinates, coordinates[np.argmax(weights)])
        offset = offset - weights @ offset
        size = effective_size(weights)
        covariance = (offset.T * weights) @ offset / max(1.0 - 1.0 / size, 0.1)
        # The width that suits a normal distribution best (Silverman 1986, Sec. 4.3).
        width = (4.0 / (size * (k + 2.0))) ** (1.0 / (k + 4.0))
        factor = np.linalg.cholesky(width**2 * covariance + SMALLEST_SD**2 * np.eye(k))
        centres = coordinates[systematic(weights, n_centres, rng.random())]
        return cls(controls, centres[np.newaxis], factor[np.newaxis])

    def joined(self, other: Kernels) -> Kernels:
        """Return these proposals and others after them."""
        if not len(self.centres):
            return other
        return replace(
            other,
            centres=np.concatenate([self.centres, other.centres]),
            factors=np.concatenate([self.factors, other.factors]),
        )

    def draw(self, size: int, rng: np.random.Generator) -> Array:
        """Return draws (size, k) from the last proposal; the centres and widths take turns in random order."""
        centres, factor = self.centres[-1], self.factors[-1]
        which = rng.permutation(max(size, len(centres)))[:size] % len(centres)
        width = WIDTHS[rng.integers(len(WIDTHS), size=size)]
        normal = rng.standard_normal((size, factor.shape[0])) @ factor.T
        heavy = np.sqrt(DEGREES / rng.chisquare(DEGREES, size))
        return np.asarray(centres[which] + (width * heavy)[:, np.newaxis] * normal)

    def log_density(self, coordinates: Array) -> Array:
        """Return the log density (B, P) of every proposal at coordinates (P, k)."""
        n_proposals, _, k = self.centres.shape
        if not n_proposals or self.controls is None:
            return np.empty((0, len(coordinates)))
        offset = self.controls.offset(coordinates[:, np.newaxis], self.centres[:, np.newaxis])  # (B, P, c, k)
        # A sample that is a centre itself is left to the other kernels; a single centre counts all the same.
        others = (offset != 0.0).any(axis=3)
        others |= ~others.any(axis=2, keepdims=True)
        constant = lgamma(0.5 * (DEGREES + k)) - lgamma(0.5 * DEGREES) - 0.5 * k * log(DEGREES * pi)
        volume = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)[:, np.newaxis]
        inverse = np.linalg.inv(self.factors)
        parts = []
        for turn in self.controls.turns():
            whitened = np.einsum("bij,bpcj->bpci", inverse, offset + turn)
            distance = np.einsum("bpci,bpci->bpc", whitened, whitened)
            parts += [
                np.where(others, -0.5 * (DEGREES + k) * np.log1p(distance / (DEGREES * width**2)), -np.inf)
                - k * np.log(width)
                for width in WIDTHS
            ]
        kernels = np.logaddexp.reduce(np.concatenate(parts, axis=2), axis=2) - np.log(len(WIDTHS) * others.sum(axis=2))
        return np.asarray(kernels + constant - volume)

    def to_memory(self) -> dict[str, Any]:
        """Return the proposals as named arrays."""
        return {"centres": self.centres, "factors": self.factors}

    @classmethod
    def from_memory(cls, memory: Memory, controls: Controls) -> Kernels:
        """Return the proposals that ``to_memory`` made arrays of."""
        return cls(controls, np.asarray(memory["centres"]), np.asarray(memory["factors"]))
