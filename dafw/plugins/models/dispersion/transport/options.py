"""The options of the transport."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import option


@dataclass
class TransportOptions:
    """Options of the transport."""

    diffusion: float = option(0.8, "diffusion coefficient epsilon in m^2/s", minimum=0.0)
    scheme: str = option("galerkin", "galerkin, or supg: stabilised along the wind", choices=("galerkin", "supg"))
    tolerance: float = option(
        1e-12, "residual norm of the linear solver, relative to the right-hand side", above=0.0, maximum=1e-6
    )
    max_iterations: int = option(
        100, "iterations of the linear solver in one step, after which it is solved directly", minimum=1
    )
