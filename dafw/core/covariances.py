"""Algebra of error covariances, which are (m,) where they are diagonal, else (m, m)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dafw.core.space import Array


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Return covariances (m_i,) or (m_i, m_i) as one: (m,) where all are diagonal, else (m, m)."""
    if all(block.ndim == 1 for block in blocks):
        return np.concatenate(blocks) if blocks else np.empty(0)
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*(np.diag(block) if block.ndim == 1 else block for block in blocks)))


def whiten(covariance: Array, rows: Array) -> Array:
    """Return L^-1 applied to each of the rows (m,) or (N, m), where L L^T = covariance: unit error variance."""
    if covariance.ndim == 1:
        return np.asarray(rows / np.sqrt(covariance))
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(np.linalg.cholesky(covariance), rows.T, lower=True).T)


def whiten_both(covariance: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return ``whiten`` of two arrays of rows; the covariance is factorised only once."""
    if covariance.ndim == 1:
        sd = np.sqrt(covariance)
        return first / sd, second / sd
    rows = whiten(covariance, np.vstack([first, second]))
    split = len(rows) - (len(second) if second.ndim == 2 else 1)
    return rows[:split], rows[split:].reshape(second.shape)


def colour(covariance: Array, rows: Array) -> Array:
    """Return L applied to each of the rows (m,) or (N, m): standard normal numbers become noise of that covariance."""
    if covariance.ndim == 1:
        return np.asarray(rows * np.sqrt(covariance))
    return np.asarray(rows @ np.linalg.cholesky(covariance).T)
