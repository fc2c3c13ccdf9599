"""Flux-corrected transport on the rotation of a slotted cylinder, a cone and a hump. See docs/physics.md.

LeVeque 1996, doi:10.1137/0733033: one turn about the middle of the unit square, 128 x 128 squares, dt = 0.001, pure
advection, as in Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks import Measurement, benchmark
from dafw.plugins.models.dispersion.mesh.tagged import OUTER, TaggedMesh
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.transport import Transport

# isort: split
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh
from mpi4py import MPI

RADIUS = 0.15
BODIES = {"slotted cylinder": (0.5, 0.75), "cone": (0.5, 0.25), "hump": (0.25, 0.5)}


@benchmark("transport.rotation")
def rotation(short: bool) -> Measurement:
    """L1 error of fct in space after one turn, over that of Galerkin; L1 and L2 errors and extremes of all, by body.

    The error in space is that against backward Euler with the same time step and no error in space.
    """
    cells, steps = (16, 60) if short else (128, 6283)
    dt = 2.0 * np.pi / steps
    errors: dict[str, Any] = {}
    for scheme in ("galerkin", "fct", "low order"):
        transport = Transport(
            unit_square(cells),
            TransportOptions(scheme="galerkin" if scheme == "galerkin" else "fct", diffusion=0.0),
            dt,
        )
        places = transport.matrices.places
        system: Any = transport.system(turning(transport))
        mass = np.add.reduceat(transport.matrices.before.data * dt, transport.matrices.row_starts)
        cloud, lowest, highest = bodies(*places.T), 0.0, 0.0
        begun = time.process_time()
        for _ in range(steps):
            cloud = (
                system._predictors._low_order.solve(mass / dt * cloud) if scheme == "low order" else system.step(cloud)
            )
            lowest, highest = min(lowest, cloud.min()), max(highest, cloud.max())
        seconds = time.process_time() - begun
        found = {"lowest": lowest, "highest": highest, "ms_per_step": 1e3 * seconds / steps}
        for name, exact in (("exact", bodies(*places.T)), ("backward Euler", turned(places, steps, dt))):
            off = np.abs(cloud - exact)
            found[f"L1, {name}"], found[f"L2, {name}"] = mass @ off, np.sqrt(mass @ off**2)
            for body, centre in BODIES.items():
                near = np.hypot(*(places - centre).T) < 1.5 * RADIUS
                found[f"L1, {name}, {body}"] = (mass * off)[near].sum()
        errors[scheme] = {key: float(f"{value:.3g}") for key, value in found.items()}
    ratio = errors["fct"]["L1, backward Euler"] / errors["galerkin"]["L1, backward Euler"]
    return Measurement(ratio, "of Galerkin's L1 error", 0.5, errors)


def bodies(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the concentration of the three bodies at places of any shape."""
    away = {name: np.hypot(x - a, y - b) / RADIUS for name, (a, b) in BODIES.items()}
    slotted = (away["slotted cylinder"] <= 1.0) & ((np.abs(x - 0.5) >= 0.025) | (y >= 0.85))
    hump = 0.25 * (1.0 + np.cos(np.pi * np.minimum(away["hump"], 1.0)))
    return slotted + np.maximum(1.0 - away["cone"], 0.0) + hump


def turned(places: np.ndarray, steps: int, dt: float) -> np.ndarray:
    """Return what backward Euler makes of the bodies without any error in space, by Fourier series in the angle."""
    from scipy.interpolate import RegularGridInterpolator

    radii, angles = np.linspace(0.0, 0.72, 721), np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)
    ring = bodies(0.5 + radii[:, None] * np.cos(angles), 0.5 + radii[:, None] * np.sin(angles))
    factor = (1.0 + 1j * np.arange(angles.size // 2 + 1) * dt) ** -steps
    after = np.fft.irfft(np.fft.rfft(ring, axis=1) * factor, angles.size, axis=1)
    closed = np.concatenate([after, after[:, :1]], axis=1)
    value = RegularGridInterpolator((radii, np.append(angles, 2.0 * np.pi)), closed)
    x, y = (places - 0.5).T
    found: np.ndarray = value(np.stack([np.hypot(x, y), np.arctan2(y, x) % (2.0 * np.pi)], axis=1))
    return found


def unit_square(cells: int) -> TaggedMesh:
    """Return the unit square in ``cells`` x ``cells`` squares of two triangles each."""
    mesh = dolfinx_mesh.create_unit_square(MPI.COMM_SELF, cells, cells)
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx_mesh.exterior_facet_indices(mesh.topology)
    tags = np.full(facets.size, OUTER, dtype=np.int32)
    return TaggedMesh(mesh, dolfinx_mesh.meshtags(mesh, 1, facets, tags))


def turning(transport: Transport) -> Any:
    """Return the wind that turns about the middle once in 2 pi."""
    wind = fem.Function(fem.functionspace(transport.matrices.space.mesh, ("Lagrange", 1, (2,))))
    wind.interpolate(lambda p: np.array([0.5 - p[1], p[0] - 0.5]))
    return wind
