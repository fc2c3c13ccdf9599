"""The restart ensemble Kalman filter: one update of the control variables at the start, then a run to the present.

An ensemble Kalman filter that updates state and parameters together leaves a state that no run of the model has. Here
the readings update the controls at the start alone, by the covariances between them and the predictions, and the model
is run again from there. So state and parameters of every member belong together: the state is what the model makes of
the parameters.

With the anomalies a of the controls and the predictions' Y in units of the errors, in the basis B of
dafw.plugins.filters.ienks, the update is that of the ensemble transform Kalman filter::

    H  = (N - 1) I + Y Y^T
    w  = H^-1 Y dy,    T = sqrt(N - 1) H^-1/2
    x  = c + (w + B T) a

which is the first iteration of ``ienks`` with B for all N - 1 weights. So what is not linear in the controls counts as
uncertain, which a single step from members that lie far apart needs. For a linear model and Gaussian errors it is
exact. ``readings: new`` takes the readings since the last analysis and the start as updated by those before; ``all``
takes all readings and the first guess in every analysis.

Gu and Oliver (2007), doi:10.2118/108438-PA; for a tracer: doi:10.3390/geosciences10070276 (2020). These perturb the
readings. We transform, because that draws nothing and needs fewer members; with perturbed readings and all of them it
is ``esmda`` with one iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.options import option
from dafw.plugins.filters.ienks import Weights, newton_step
from dafw.plugins.filters.rerunning import Rerunning, Run, Work


@dataclass
class RestartEnKF(Rerunning):
    """A deterministic update of the control variables at the start, and a run to the present."""

    accuracy = "exact"
    window = None
    inflation_option = "inflation"

    readings: str = option(
        "new", "what an analysis uses: all readings, or those since the last one", choices=("new", "all")
    )

    @property
    def uses_new_only(self) -> bool:
        """Whether an analysis uses the new readings only and revises the past."""
        return self.readings == "new"

    def moved_start(self, work: Work, rng: np.random.Generator) -> Run:
        """Return the run of c + (w + B T) a."""
        place = Weights(work)
        run = place.run(place.basis)
        w, T = newton_step(place.weights, run)  # noqa: N806
        return place.run(w + place.basis @ T, last=True)
