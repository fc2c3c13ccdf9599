"""The examples in the docstrings of the public interface are correct, and every public part has one."""

from __future__ import annotations

import doctest
import importlib

import numpy as np
import pytest

import dafw

SHOWN = (
    "Model",
    "Observer",
    "Policy",
    "Filter",
    "Readings",
    "StateSpace",
    "Variable",
    "Ensemble",
    "Route",
    "Observation",
    "Analysis",
)
INTERFACES = ("filter", "model", "observer", "policy", "readings")
MODULES = (
    *(f"core.interfaces.{name}" for name in INTERFACES),
    "core.space",
    "core.ensemble",
    "core.observation",
    "core.hookspecs",
    "testing",
)


@pytest.mark.parametrize("name", [*MODULES, "authoring.function"])
def test_the_examples_of_a_module_are_right(name):
    module = importlib.import_module(f"dafw.{name}")
    public = {each: getattr(dafw, each) for each in dafw.__all__} | {"np": np}
    result = doctest.testmod(module, extraglobs={**public, **vars(module)})
    assert result.attempted > 0 and result.failed == 0


@pytest.mark.parametrize("name", SHOWN)
def test_every_public_part_has_an_example(name):
    assert ">>> " in getattr(dafw, name).__doc__


def test_the_hook_has_an_example():
    assert "@hookimpl" in importlib.import_module("dafw.core.hookspecs").__doc__
