"""The reference of what can be imported from ``dafw`` and ``dafw.testing``, made from the docstrings."""

from __future__ import annotations

import inspect
from importlib import import_module

import dafw
import dafw.testing

GROUPS = {
    "Run and open studies": (
        "run Study advance Cycle Parts State ForecastPlan forecast_scores open_run open_sweep open_forecasts"
    ),
    "The kinds of plugins": "Model Observer Policy Filter Readings Executor PluginSpec hookimpl option REQUIRED",
    "States": "StateSpace Variable FIELD NONNEGATIVE POSITIVE ANGLE Domain",
    "What plugins are given and return": (
        "Ensemble Forecast Analysis Step Vehicle Route Diagnostic Window PastCycle Outlook Request Taken Batch Stepped "
        "step_members"
    ),
    "Observations": "Observation ObservationOperator Selection Interpolation whiten colour",
    "Models from functions and programs": "model_from_function ProgramModel",
    "Errors": (
        "DafwError RequestError ConfigurationError OptionError PluginError ContractError ComputationError SolverError "
        "DivergenceError RunError"
    ),
}
"""The public names of ``dafw``, by subject."""


def python_names() -> str:
    """Return the reference in Markdown; a public name that is in no group comes last."""
    named = {name for group in GROUPS.values() for name in group.split()}
    groups = GROUPS | {"More": " ".join(name for name in dafw.__all__ if name not in named)}
    parts = []
    for title, group in groups.items():
        if group:
            parts += [f"## {title}", directives("dafw", group.split())]
        if "open_run" in group:
            parts += ["## What a dataset can do: `.dafw`", directives("dafw.core.accessor", ["RunAccessor"])]
    parts += ["## The checks: `dafw.testing`", directives("dafw.testing", dafw.testing.__all__)]
    return "\n\n".join(parts) + "\n"


def directives(module: str, names: list[str]) -> str:
    """Return the directives that document names of a module."""
    made = []
    for name in names:
        value = getattr(import_module(module), name)
        kind = "class" if inspect.isclass(value) else "function" if inspect.isroutine(value) else "data"
        kind = "exception" if inspect.isclass(value) and issubclass(value, Exception) else kind
        if isinstance(value, dict):  # its docstring would be that of all dicts
            made += [f".. py:data:: {module}.{name}", ""]
            continue
        made += [f".. auto{kind}:: {module}.{name}"]
        made += ["   :members:"] if kind == "class" else ["   :no-value:"] if kind == "data" else []
        made += [""]
    return "\n".join(["```{eval-rst}", *made, "```"])
