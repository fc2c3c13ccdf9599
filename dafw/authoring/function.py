"""A model made from a plain function ``step(members, t, dt)``, for code that does not know dafw.

A package passes the function in its own Python code and registers the returned class. The function cannot be an
option: a configuration file may choose among installed plugins, but never name code to be run.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from dataclasses import make_dataclass
from typing import Any

import numpy as np

from dafw.core.errors import PluginError
from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import Array, StateSpace


class _FunctionModel(Model):
    """Base of all models made from functions."""

    step_function: Callable[..., Any]
    draw: Callable[[np.random.Generator], Any]
    parameters: tuple[str, ...]
    noise_sd: float

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return one draw for each member (N, n)."""
        return rng.draw(n_members, type(self).draw)

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the function's result for the members (N, n), plus the additive model error if there is one."""
        arguments = {name: getattr(self, name) for name in self.parameters}
        # A copy: plain functions often work in place.
        stepped = type(self).step_function(members.copy(), t, self.dt, **arguments)
        if self.noise_sd == 0.0:
            return stepped
        checked = self.checked(stepped, members.shape, "members after a step")
        return self.space.retract(checked, self.noise_sd * rng.standard_normal(members.shape))


def model_from_function(
    step: Callable[..., Any], *, space: StateSpace, initial: Callable[[np.random.Generator], Any], dt: float = 1.0
) -> type[Model]:
    """Return a model class whose step is the function ``step(members, t, dt)``, to be registered as a plugin.

    ``step`` gets the members (N, n), which it may overwrite, the time and the time step in seconds, and returns the
    members at t + dt. Its keyword-only parameters, each with a type and a default, become the plugin's options, next
    to ``dt`` and ``noise_sd``, the standard deviation of an additive model error. ``initial(generator)`` returns one
    draw (n,) from the first guess. Raises PluginError for a function of another form.

    >>> def decay(members, t, dt, *, rate: float = 0.1):
    ...     return members * (1.0 - rate * dt)
    >>> space = StateSpace([Variable("level", 3)])
    >>> Decay = model_from_function(decay, space=space, initial=lambda generator: generator.normal(size=3))
    >>> Decay(rate=0.5).step(np.ones((1, 3)), t=0.0, rng=None)
    array([[0.5, 0.5, 0.5]])
    """
    name = getattr(step, "__name__", type(step).__name__)
    parameters = inspect.signature(step).parameters.values()
    named = [parameter for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    positional = [parameter for parameter in parameters if parameter.kind is not parameter.KEYWORD_ONLY]
    if len(positional) != 3 or any(p.kind is p.VAR_KEYWORD for p in positional):
        given = ", ".join(str(parameter) for parameter in positional)
        raise PluginError(f"model function '{name}': expected {name}(members, t, dt, *, options), got {name}({given})")
    hints = typing.get_type_hints(step)
    fields: list[tuple[str, Any, Any]] = [
        ("dt", float, option(dt, "time step in seconds", above=0.0)),
        ("noise_sd", float, option(0.0, "standard deviation of the additive model error in a step", minimum=0.0)),
    ]
    for parameter in named:
        if parameter.name not in hints or parameter.default is parameter.empty:
            raise PluginError(f"model function '{name}': option '{parameter.name}' needs a type and a default")
        if parameter.name in ("dt", "noise_sd", "name", "space", "domain"):
            raise PluginError(f"model function '{name}': an option cannot be called '{parameter.name}'")
        fields.append((parameter.name, hints[parameter.name], option(parameter.default, f"parameter of {name}")))
    shared = {
        "space": space,
        "step_function": staticmethod(step),
        "draw": staticmethod(initial),
        "parameters": tuple(parameter.name for parameter in named),
        "__doc__": inspect.getdoc(step) or f"The function {name} as a model.",
    }
    made: type[Model] = make_dataclass(
        name, fields, bases=(_FunctionModel,), namespace=shared, module=getattr(step, "__module__", __name__)
    )
    return made
