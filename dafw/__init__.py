"""dafw: a laboratory for data-assimilation studies.

Everything that a study or a plugin package needs can be imported from here; it is loaded on first use.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# HDF5 would refuse to open a file that a run is writing, and reads this when it is loaded: so before netCDF4 is.
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")

if TYPE_CHECKING:
    from dafw.authoring.function import model_from_function
    from dafw.authoring.program import ProgramModel
    from dafw.core.checkpoints.plan import CheckpointPlan
    from dafw.core.covariances import colour, whiten
    from dafw.core.cycle import Cycle, Parts, State, advance
    from dafw.core.domain import Domain
    from dafw.core.ensemble import Analysis, Diagnostic, Ensemble, Forecast, Route, Step, Vehicle
    from dafw.core.errors import (
        CheckpointError,
        ComputationError,
        ConfigurationError,
        ContractError,
        DafwError,
        DivergenceError,
        OptionError,
        PluginError,
        RequestError,
        RunError,
        SolverError,
    )
    from dafw.core.executors import Executor
    from dafw.core.executors.batches import Batch, Stepped, step_members
    from dafw.core.forecasts.forecast_file import open_forecasts
    from dafw.core.forecasts.plan import ForecastPlan
    from dafw.core.hookspecs import PluginSpec, hookimpl
    from dafw.core.interfaces import Filter, Model, Observer, Policy, Readings
    from dafw.core.interfaces.readings import Request, Taken
    from dafw.core.observation import Interpolation, Observation, ObservationOperator, Selection
    from dafw.core.options import REQUIRED, option
    from dafw.core.runs import open_run
    from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE, StateSpace, Variable
    from dafw.core.study import Study
    from dafw.core.sweeps import open_sweep
    from dafw.core.window import Outlook, PastCycle, Window
    from dafw.studies.forecast_scores import forecast_scores
    from dafw.studies.from_python import run

_HOMES = {
    "dafw.core.cycle": ("Cycle", "Parts", "State", "advance"),
    "dafw.core.domain": ("Domain",),
    "dafw.core.ensemble": ("Analysis", "Diagnostic", "Ensemble", "Forecast", "Route", "Step", "Vehicle"),
    "dafw.core.executors": ("Executor",),
    "dafw.core.executors.batches": ("Batch", "Stepped", "step_members"),
    "dafw.core.checkpoints.plan": ("CheckpointPlan",),
    "dafw.core.covariances": ("colour", "whiten"),
    "dafw.core.errors": (
        "CheckpointError",
        "ComputationError",
        "ConfigurationError",
        "ContractError",
        "DafwError",
        "DivergenceError",
        "OptionError",
        "PluginError",
        "RequestError",
        "RunError",
        "SolverError",
    ),
    "dafw.core.forecasts.forecast_file": ("open_forecasts",),
    "dafw.core.forecasts.plan": ("ForecastPlan",),
    "dafw.core.hookspecs": ("PluginSpec", "hookimpl"),
    "dafw.core.interfaces": ("Filter", "Model", "Observer", "Policy", "Readings"),
    "dafw.core.interfaces.readings": ("Request", "Taken"),
    "dafw.core.observation": (
        "Interpolation",
        "Observation",
        "ObservationOperator",
        "Selection",
    ),
    "dafw.core.options": ("REQUIRED", "option"),
    "dafw.core.runs": ("open_run",),
    "dafw.core.study": ("Study",),
    "dafw.core.sweeps": ("open_sweep",),
    "dafw.core.window": ("Outlook", "PastCycle", "Window"),
    "dafw.core.space": ("ANGLE", "FIELD", "NONNEGATIVE", "POSITIVE", "StateSpace", "Variable"),
    "dafw.authoring.function": ("model_from_function",),
    "dafw.authoring.program": ("ProgramModel",),
    "dafw.studies.forecast_scores": ("forecast_scores",),
    "dafw.studies.from_python": ("run",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "ANGLE",
    "FIELD",
    "NONNEGATIVE",
    "POSITIVE",
    "REQUIRED",
    "Analysis",
    "Batch",
    "CheckpointError",
    "CheckpointPlan",
    "ComputationError",
    "ConfigurationError",
    "ContractError",
    "Cycle",
    "DafwError",
    "Diagnostic",
    "DivergenceError",
    "Domain",
    "Ensemble",
    "Executor",
    "Filter",
    "Forecast",
    "ForecastPlan",
    "Interpolation",
    "Model",
    "Observation",
    "ObservationOperator",
    "Observer",
    "OptionError",
    "Outlook",
    "Parts",
    "PastCycle",
    "PluginError",
    "PluginSpec",
    "Policy",
    "ProgramModel",
    "Readings",
    "Request",
    "RequestError",
    "Route",
    "RunError",
    "Selection",
    "SolverError",
    "State",
    "StateSpace",
    "Step",
    "Stepped",
    "Study",
    "Taken",
    "Variable",
    "Vehicle",
    "Window",
    "advance",
    "colour",
    "forecast_scores",
    "hookimpl",
    "model_from_function",
    "open_forecasts",
    "open_run",
    "open_sweep",
    "option",
    "run",
    "step_members",
    "whiten",
]


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it."""
    if name not in _HOME:
        raise AttributeError(f"module 'dafw' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
