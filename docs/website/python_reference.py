"""The reference of what can be imported from ``dafw`` and ``dafw.testing``, made from the docstrings."""

from __future__ import annotations

import inspect

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
"""Every public name of ``dafw``, by subject."""


def python_names() -> str:
    """Return the reference in Markdown; raises ValueError if a public name is in no group, or in two."""
    named = [name for group in GROUPS.values() for name in group.split()]
    if sorted(named) != sorted(dafw.__all__):
        raise ValueError(f"the groups of names are not those of dafw.__all__: {set(named) ^ set(dafw.__all__)}")
    parts = []
    for title, group in GROUPS.items():
        parts += [f"## {title}", directives("dafw", group.split())]
        if "open_run" in group:
            parts += ["## What a dataset can do: `.dafw`", directives("dafw.core.accessor", ["RunAccessor"])]
    parts += ["## The checks: `dafw.testing`", directives("dafw.testing", dafw.testing.__all__)]
    return "\n\n".join(parts) + "\n"


def directives(module: str, names: list[str]) -> str:
    """Return the directives that document names of a module."""
    made = []
    for name in names:
        value = getattr(__import__(module, fromlist=[name]), name)
        kind = "class" if inspect.isclass(value) else "function" if inspect.isroutine(value) else "data"
        kind = "exception" if inspect.isclass(value) and issubclass(value, Exception) else kind
        if isinstance(value, dict):  # its docstring would be that of all dicts
            made += [f".. py:data:: {module}.{name}", ""]
            continue
        made += [f".. auto{kind}:: {module}.{name}"]
        made += ["   :members:"] if kind == "class" else ["   :no-value:"] if kind == "data" else []
        made += [""]
    return "\n".join(["```{eval-rst}", *made, "```"])
