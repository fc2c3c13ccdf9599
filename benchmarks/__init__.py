"""Measurements of speed and accuracy, with the values that dafw must reach: ``python -m benchmarks [NAME...]``.

A benchmark is a function in a file of this folder::

    @benchmark("l96.etkf_rmse")
    def etkf_rmse(short: bool) -> Measurement:
        '''One sentence that says what is measured.'''

``short`` asks for the smallest case that shows that the benchmark works; its value has no meaning. Two things to be
compared are timed alternately in one run, and the result is the median of several ratios. ``--json FILE`` writes the
results to a file.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Measurement:
    """The result of a benchmark; the value is compared with ``baseline``, and ``detail`` explains it."""

    value: float
    unit: str
    baseline: float
    detail: Mapping[str, Any] = field(default_factory=dict)


type Benchmark = Callable[[bool], Measurement]

_BENCHMARKS: dict[str, Benchmark] = {}


def benchmark(name: str) -> Callable[[Benchmark], Benchmark]:
    """Register a function under a name."""

    def register(function: Benchmark) -> Benchmark:
        if name in _BENCHMARKS:
            raise ValueError(f"two benchmarks are named '{name}'")
        _BENCHMARKS[name] = function
        return function

    return register


def benchmarks() -> dict[str, Benchmark]:
    """Return all benchmarks of this folder by name."""
    for module in pkgutil.iter_modules(__path__):
        if module.name != "__main__":
            importlib.import_module(f"{__name__}.{module.name}")
    return dict(sorted(_BENCHMARKS.items()))


def machine() -> str:
    """Return a description of the machine: processor, cores, system, Python."""
    processor = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text(encoding="utf-8").splitlines()
        processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), processor)
    return f"{processor}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
