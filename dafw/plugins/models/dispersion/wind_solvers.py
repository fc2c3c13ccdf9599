"""The door behind which the wind solvers stand: ``model.wind.solver`` says which one."""

from __future__ import annotations

from dafw.core.errors import ConfigurationError
from dafw.plugins.models.dispersion.mesh import TaggedMesh
from dafw.plugins.models.dispersion.wind import WindOptions, WindSolver, require_uniform


def wind_solver(tagged_mesh: TaggedMesh, options: WindOptions) -> WindSolver:
    """Return the solver that ``options.solver`` names; the cheap ones make a reduced basis or read it from the cache.

    Raises ConfigurationError where the boundary does not suit the solver, or a partitioned mesh not a cheap one.
    """
    require_uniform(options)
    if options.solver == "newton":
        return WindSolver(tagged_mesh, options)
    if tagged_mesh.mesh.comm.size > 1:
        raise ConfigurationError(not_partitioned(options.solver))
    if options.solver == "accelerated":
        from dafw.plugins.models.dispersion.accelerated import AcceleratedWindSolver

        return AcceleratedWindSolver(tagged_mesh, options)
    from dafw.plugins.models.dispersion.reduced import ReducedWindSolver

    return ReducedWindSolver(tagged_mesh, options)


def not_partitioned(solver: str) -> str:
    """Return why a solver does not work on several ranks."""
    return f"wind: solver '{solver}' works in one process, expected 'newton' on a mesh that is cut among several"
