"""How long making a reduced basis takes, and how much memory a run needs, from what was measured on other meshes."""

from __future__ import annotations

import numpy as np

from dafw.plugins.models.dispersion.wind.options import BasisOptions

MEASURED = ((2_715, 39.0), (10_045, 104.0), (39_369, 720.0))
"""Nodes, and seconds for the default basis on two cores without other work (docs/fast-winds.md, docs/cluster.md)."""
PROCESS, PER_NODE = 0.5e9, 5e4
"""Bytes of a process with a reduced basis, without and for each node: 0.6 GB on 2,715 nodes, 7 to 10 GB on 153,364."""


def seconds_of_basis(nodes: int, options: BasisOptions) -> float:
    """Return about how many seconds a basis takes on two cores, for a mesh with so many nodes.

    Between the meshes that were measured the logarithms are interpolated; two thirds of the time are proportional to
    the number of winds, a third to that of modes.
    """
    sizes, seconds = np.log(np.array(MEASURED)).T
    slopes = np.diff(seconds) / np.diff(sizes)
    size = np.log(max(nodes, 1))
    if size > sizes[-1]:
        logarithm = seconds[-1] + slopes[-1] * (size - sizes[-1])
    elif size < sizes[0]:
        logarithm = seconds[0] + slopes[0] * (size - sizes[0])
    else:
        logarithm = np.interp(size, sizes, seconds)
    usual = BasisOptions()
    winds = options.directions * options.levels / (usual.directions * usual.levels)
    return float(np.exp(logarithm) * (2.0 * winds + options.modes / usual.modes) / 3.0)


def bytes_of_process(nodes: int) -> float:
    """Return about how many bytes the libraries, the mesh and the solvers of a run take, without its ensemble."""
    return PROCESS + PER_NODE * nodes
