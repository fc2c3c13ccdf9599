"""Comparisons that the checks use: bits, round trips through a file, global generators, averages over seeds."""

from __future__ import annotations

import io
import pickle
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from dafw.authoring.checks import ConformanceError, require
from dafw.core.ensemble import Memory
from dafw.core.space import Array, Kind, StateSpace

FALSE_ALARM = 1e-6
"""Probability that ``require_mean`` would reject a correct plugin if the seeds were random."""


def frozen(values: Any) -> bytes:
    """Return the bits of an array, a mapping of arrays, or None, for comparison before and after."""
    if isinstance(values, Mapping):
        return pickle.dumps({name: frozen(value) for name, value in sorted(values.items())})
    if values is None:
        return b"None"
    array = np.asarray(values)
    return pickle.dumps((array.shape, array.dtype.str, array.tobytes()))


def restored(memory: Memory | None) -> Memory | None:
    """Return the memory after a round trip through a file; raises ConformanceError if a file cannot hold it."""
    if memory is None:
        return None
    require(isinstance(memory, Mapping), f"a memory must map names to arrays, got a {type(memory).__name__}")
    file = io.BytesIO()
    try:
        np.savez(file, allow_pickle=False, **{name: np.asarray(value) for name, value in memory.items()})
        file.seek(0)
        with np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (ValueError, TypeError) as error:
        raise ConformanceError(f"a memory must hold nothing but arrays of numbers or text: {error}") from error


@contextmanager
def global_generators(seed: int = 0) -> Iterator[None]:
    """Seed the global generators of ``random`` and NumPy, and restore both at the end."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


@contextmanager
def no_global_draws() -> Iterator[None]:
    """Raise ConformanceError if the block draws from a global generator, or seeds one."""
    with global_generators():
        python, numpy = random.getstate(), pickle.dumps(np.random.get_state())  # noqa: NPY002
        yield
        require(random.getstate() == python, "it uses the global generator of the module random, not the one handed in")
        require(
            pickle.dumps(np.random.get_state()) == numpy,  # noqa: NPY002
            "it uses NumPy's global generator, not the one handed in",
        )


def state_of(rng: np.random.Generator) -> bytes:
    """Return the state of a generator."""
    return pickle.dumps(rng.bit_generator.state)


def require_same_bits(first: Any, second: Any, message: str) -> None:
    """Raise ConformanceError unless two arrays, memories or Nones agree to the last bit."""
    require(frozen(first) == frozen(second), message + _largest(first, second))


def require_close(found: Array, expected: Array, tolerance: float, message: str) -> None:
    """Raise ConformanceError unless both agree within ``tolerance`` times the largest expected magnitude (or 1)."""
    limit = tolerance * max(1.0, float(np.abs(expected).max(initial=0.0)))
    require(found.shape == expected.shape, f"{message}: shapes {found.shape} and {expected.shape}")
    off = float(np.abs(found - expected).max(initial=0.0))
    require(off <= limit, f"{message}: off by {off:.3g}, allowed {limit:.3g}")


def require_in_set(space: StateSpace, members: Array, what: str) -> None:
    """Raise ConformanceError if a number of the members (N, n) is out of its variable's range; ``what`` names them."""
    for variable in space.variables:
        values = members[:, space.slice(variable.name)]
        if variable.kind is Kind.NONNEGATIVE:
            require(values.min() >= 0.0, f"'{variable.name}' is nonnegative, {what} holds {values.min():.3g}")
        if variable.kind is Kind.POSITIVE:
            require(values.min() > 0.0, f"'{variable.name}' is positive, {what} holds {values.min():.3g}")
        if variable.kind is Kind.ANGLE:
            outside = values[(values < 0.0) | (values >= 2.0 * np.pi)]
            require(outside.size == 0, f"the angle '{variable.name}' lies in [0, 2 pi), {what} holds {outside[:1]}")


def require_mean(samples: Array, expected: Array, message: str) -> None:
    """Raise ConformanceError unless ``expected`` (k,) can be the mean of ``samples`` (S, k), one row per seed.

    The tolerance comes from the samples: their standard error times Student's t at a false-alarm probability of
    ``FALSE_ALARM`` for all k together. An allowance for rounding is added.
    """
    from scipy.stats import t

    n_seeds, k = samples.shape
    error = samples.std(axis=0, ddof=1) / np.sqrt(n_seeds)
    limit = t.isf(FALSE_ALARM / (2 * k), n_seeds - 1) * error + 1e-9 * max(1.0, float(np.abs(expected).max()))
    excess = np.abs(samples.mean(axis=0) - expected) / limit
    worst = int(np.argmax(excess))
    require(
        excess[worst] <= 1.0,
        f"{message}: mean over {n_seeds} seeds {samples.mean(axis=0)[worst]:.5g}, expected {expected[worst]:.5g} "
        f"within {limit[worst]:.2g}",
    )


def _largest(first: Any, second: Any) -> str:
    if first is None or second is None or isinstance(first, Mapping) or np.shape(first) != np.shape(second):
        return ""
    return f" (largest difference {float(np.abs(np.subtract(first, second)).max(initial=0.0)):.3g})"
