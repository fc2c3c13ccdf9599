"""The options of the transport."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.errors import ConfigurationError
from dafw.core.options import option


@dataclass
class TransportOptions:
    """Options of the transport."""

    diffusion: float = option(0.8, "diffusion coefficient epsilon in m^2/s", minimum=0.0)
    scheme: str = option(
        "galerkin",
        "galerkin, supg: stabilised along the wind, or fct: flux-corrected, never below zero",
        choices=("galerkin", "supg", "fct"),
    )
    outflow: str = option(
        "zero",
        "outer boundary: zero concentration, or open: gas leaves with the wind and none comes in",
        choices=("zero", "open"),
    )
    solver: str = option(
        "iterative",
        "galerkin and supg: iterative (BiCGStab), or direct: a sparse LU per wind, quicker where winds stay",
        choices=("iterative", "direct"),
    )
    tolerance: float = option(
        1e-12, "iterative: residual norm of the linear solver, relative to the right-hand side", above=0.0, maximum=1e-6
    )
    max_iterations: int = option(
        100, "iterative: iterations of the linear solver in one step, after which it is solved directly", minimum=1
    )


def require_one_process(options: TransportOptions) -> None:
    """Raise ConfigurationError unless the transport works on a mesh that is divided among several ranks."""
    for name, chosen, usable in (
        ("scheme", options.scheme, ("galerkin", "supg")),
        ("outflow", options.outflow, ("zero",)),
        ("solver", options.solver, ("iterative",)),
    ):
        if chosen not in usable:
            raise ConfigurationError(
                f"transport: {name} '{chosen}' works in one process, expected '{"' or '".join(usable)}' on a mesh that "
                "is divided among several"
            )
