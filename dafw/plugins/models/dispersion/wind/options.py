"""The options of the wind and of its reduced basis."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.errors import ConfigurationError
from dafw.core.options import option


@dataclass
class BasisOptions:
    """Options of the reduced basis: which winds are solved for it, and how far it is trusted."""

    directions: int = option(
        32, "number of directions, over the full circle, of the winds that the basis is made from", minimum=4
    )
    levels: int = option(5, "number of intensities in each direction, denser towards calm", minimum=1)
    max_intensity: float = option(
        12.0, "intensity of the strongest wind that the basis is made from, in m/s", above=0.0
    )
    modes: int = option(160, "largest number of modes; an enriched basis has up to twice as many", minimum=1)
    tolerance: float = option(
        0.01,
        "estimated relative L2 error of the velocity above which the full equations are solved",
        above=0.0,
        maximum=1.0,
    )
    enrich: bool = option(
        False,
        "add the winds that runs solved in full to the basis of later runs: these are faster, but the same seed then "
        "gives other bits; false: the basis stays as it was made",
    )
    digest: str = option(
        "",
        "digest of the basis to use, recorded by an earlier run; empty: the basis as made or, with enrich, the newest",
    )


@dataclass
class WindOptions:
    """Options of the steady wind."""

    viscosity: float = option(25.0, "effective (eddy) viscosity in m^2/s", above=0.0)
    closure: str = option(
        "constant",
        "constant, or proportional: viscosity * intensity / reference_intensity",
        choices=("constant", "proportional"),
    )
    reference_intensity: float = option(
        5.0, "wind intensity in m/s at which the proportional closure has the given viscosity", above=0.0
    )
    boundary: str = option(
        "uniform",
        "uniform: the wind is prescribed on the whole outer boundary; outflow: not where it leaves (do-nothing)",
        choices=("uniform", "outflow"),
    )
    tolerance: float = option(
        1e-8,
        "accepted residual norm, relative to the residual norm of a wind that is zero inside",
        above=0.0,
        maximum=1e-2,
    )
    max_iterations: int = option(12, "largest number of factorisations in one run of Newton's method", minimum=1)
    max_steps: int = option(
        40, "largest number of runs of Newton's method in one continuation from Stokes flow", minimum=1
    )
    solver: str = option(
        "newton",
        "newton; accelerated: starts from a reduced basis, same tolerance; reduced: in the basis, to its tolerance",
        choices=("newton", "accelerated", "reduced"),
    )
    keep_factorisation: bool = option(True, "newton: use a factorisation again as long as it reduces the residual well")
    basis: BasisOptions = option(BasisOptions, "the reduced basis that the accelerated and the reduced solver use")


def require_uniform(options: WindOptions) -> None:
    """Raise ConfigurationError unless the boundary suits the solver."""
    if options.solver != "newton" and options.boundary != "uniform":
        raise ConfigurationError(
            f"wind: solver '{options.solver}' expects boundary 'uniform', got '{options.boundary}': there the part of "
            "the boundary that prescribes the wind changes with the direction, and one basis does not fit all; choose "
            "solver 'newton'"
        )


def require_constant(options: WindOptions) -> None:
    """Raise ConfigurationError unless the viscosity is the same for all intensities, so that it can be estimated."""
    if options.closure != "constant":
        raise ConfigurationError(
            f"estimate: the viscosity can be estimated with the closure 'constant' only, got '{options.closure}', with "
            "which all winds have the same pattern; list what else is unknown, such as model.estimate=[diffusion]"
        )


def require_one_process(options: WindOptions) -> None:
    """Raise ConfigurationError unless the solver works on a mesh that is divided among several ranks."""
    if options.solver != "newton":
        raise ConfigurationError(
            f"wind: solver '{options.solver}' works in one process, expected 'newton' on a mesh that is divided among "
            "several"
        )
