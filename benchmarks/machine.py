"""How quick the machine is: SciPy's sparse LU on systems of the size that a step of the transport solves.

Times in docs/ are those of some machine, and machines differ by a factor of four. These benchmarks use no code of dafw
but the mesh, so their values say what other values would be elsewhere. The baselines are those of the machine for
which the goals of real time were set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.cycle import SMALL
from dafw.core.composition import compose, study_part
from dafw.core.experiment import study_from

PLAIN = ("model.wind.solver=newton", "pictures=false")


def implicit_step(points: np.ndarray, triangles: np.ndarray) -> Any:
    """Return the matrix (n, n) of an implicit step of advection and diffusion with linear elements.

    Args:
        points: (n, 2) the nodes in metres.
        triangles: (T, 3) the nodes of each triangle.
    """
    from scipy.sparse import coo_matrix

    corners = points[triangles]
    sides = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * np.abs(np.linalg.det(sides))
    gradients = np.einsum("aj,tij->tai", np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]), np.linalg.inv(sides))
    mass = areas[:, np.newaxis, np.newaxis] * (np.ones((3, 3)) + np.eye(3)) / 12.0
    diffusion = areas[:, np.newaxis, np.newaxis] * gradients @ gradients.transpose(0, 2, 1)
    advection = np.repeat((gradients @ np.array([3.0, 1.0]))[:, np.newaxis], 3, axis=1)
    local = mass + 0.5 * (diffusion + areas[:, np.newaxis, np.newaxis] * advection / 3.0)
    rows, columns = np.repeat(triangles, 3, axis=1), np.tile(triangles, (1, 3))
    return coo_matrix((local.ravel(), (rows.ravel(), columns.ravel())), shape=(len(points), len(points))).tocsc()


def median_ms(work: Callable[[], Any], repeats: int) -> float:
    """Return the median time of a call in milliseconds."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return 1e3 * float(np.median(times))


def _solve(overrides: Sequence[str], repeats: int, baseline: float) -> Measurement:
    """Return the time of a solve; the details have that of a factorisation, and of each of ten solves together."""
    from scipy.sparse.linalg import splu

    study = study_from(study_part(compose([*overrides, *PLAIN])))
    parts, _ = study.prepare()
    domain, points = parts.model.domain, parts.model.space.variables[0].coordinates
    if domain is None or domain.triangles is None or points is None:
        raise TypeError("the study has no mesh")
    matrix = implicit_step(np.asarray(points), np.asarray(domain.triangles))

    def factorised() -> Any:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    factors, right = factorised(), np.random.default_rng(0).standard_normal((len(points), 10))
    detail = {
        "unknowns": len(points),
        "factorisation_ms": round(median_ms(factorised, 1 + repeats // 10), 3),
        "each_of_ten_together_ms": round(median_ms(lambda: factors.solve(right), repeats) / 10, 4),
    }
    return Measurement(median_ms(lambda: factors.solve(right[:, 0]), repeats), "ms", baseline, detail)


@benchmark("machine.solve_2k7")
def solve_2k7(short: bool) -> Measurement:
    """Time of a solve with SciPy's sparse LU on 2,715 nodes: how quick the machine is."""
    return _solve(SMALL if short else ("experiment=enie2d_literal",), 5 if short else 300, 0.10)


@benchmark("machine.solve_10k")
def solve_10k(short: bool) -> Measurement:
    """The same on 10,045 nodes."""
    return _solve(SMALL if short else ("experiment=enie2d_paper",), 5 if short else 300, 0.45)
