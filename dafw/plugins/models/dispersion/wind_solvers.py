"""Makes the wind solver that ``model.wind.solver`` names."""

from __future__ import annotations

from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.reduced_wind.accelerated import AcceleratedWindSolver
from dafw.plugins.models.dispersion.reduced_wind.choice import basis_for
from dafw.plugins.models.dispersion.reduced_wind.reduced import ReducedWindSolver
from dafw.plugins.models.dispersion.wind.options import WindOptions, require_one_process, require_uniform
from dafw.plugins.models.dispersion.wind.solver import WindSolver


def wind_solver(tagged_mesh: TaggedMesh, options: WindOptions) -> WindSolver:
    """Return the solver that ``options.solver`` names; all but ``newton`` read a reduced basis or make it.

    Raises ConfigurationError if the boundary or a mesh that is divided among several ranks does not suit the solver, or
    if the basis that is asked for by its digest is not there.
    """
    require_uniform(options)
    if options.solver == "newton":
        return WindSolver(tagged_mesh, options)
    if tagged_mesh.mesh.comm.size > 1:
        require_one_process(options)
    kind = AcceleratedWindSolver if options.solver == "accelerated" else ReducedWindSolver
    return kind(tagged_mesh, options, basis_for(tagged_mesh, options))
