"""Units of readings, understood by pint: ``ppm``, ``mg/m3``, ``mg m-3``, ``umol mol-1``, ``1e-6``, ``degC``."""

from __future__ import annotations

import re
from functools import cache
from math import isclose, isfinite
from typing import Any

import numpy as np

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.files.table import shown

LONGEST = 60
"""Characters that a unit may have."""
POWER = re.compile(r"(?<=[^\W\d_])([-+]?\d+)(?![\w.])")
"""The exponent in spellings like ``m-3`` and ``m3``; it stands at the end of a word of letters."""
EXPONENT = re.compile(r"(?<![\w.])(\d+(?:\.\d*)?)[eE]([-+]?\d+)(?![\w.])")
WHOLE = re.compile(r"(?<![\w.])(\d+)(?![\w.])")


@cache
def _registry() -> Any:
    import pint

    registry = pint.UnitRegistry(cache_folder=None)
    registry.define("ppb = 1e-9 = _ = ppbv")
    registry.define("@alias ppm = ppmv")
    return registry


@cache
def _quantity(text: str) -> Any:
    """Return one of the unit as a quantity of pint; raises ReadingsError, which names it, if there is no such unit."""
    if len(text) > LONGEST or not text.isprintable():
        raise ReadingsError(f"the unit {shown(text)} is not known")
    registry = _registry()
    # 1e-6 becomes a plain decimal number before letters are given exponents; whole numbers become decimal ones, so
    # that powers of powers overflow at once instead of being computed.
    spelt = EXPONENT.sub(lambda found: _decimal(found), text.strip())
    spelt = WHOLE.sub(r"\1.0", POWER.sub(r"**\1", spelt))
    try:
        found = registry.parse_expression(spelt) if spelt else registry.Quantity(1.0, "")
        found = found if hasattr(found, "units") else registry.Quantity(float(found), "")
        if not 0.0 < float(found.magnitude) < float("inf"):
            raise ValueError(text)
    except Exception:  # pint raises errors of many kinds for what is no unit, some of them Python's own
        raise ReadingsError(f"the unit {shown(text)} is not known") from None
    return found


def _decimal(found: re.Match[str]) -> str:
    try:
        return f"{float(found[0]):.20f}" if float(found[0]) < 1.0 else f"{float(found[0]):f}"
    except (ValueError, OverflowError):
        return found[0]


def require_unit(text: str) -> None:
    """Raise ReadingsError, which names the unit, if pint does not know it."""
    if text not in ("", "1"):
        _quantity(text)


@cache
def linear(unit: str, wanted: str) -> tuple[float, float]:
    """Return (a, b) so that a number v in ``unit`` is a + b v in ``wanted``; exactly (0, 1) for the same unit.

    Both may be quantities, such as ``250 mg m-3``. Raises ReadingsError if one is not known, they do not measure the
    same, or a number of one is no linear function of that of the other, as with decibels.
    """
    import pint

    if unit == wanted:
        return 0.0, 1.0
    ours, theirs = _quantity(unit), _quantity(wanted)
    if ours.units == theirs.units and ours.magnitude == theirs.magnitude:
        return 0.0, 1.0
    registry = _registry()
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused below
            zero, one, two = (
                float(registry.Quantity(number * ours.magnitude, ours.units).to(theirs.units).m / theirs.magnitude)
                for number in (0.0, 1.0, 2.0)
            )
    except (pint.PintError, ArithmeticError):
        raise ReadingsError(f"the unit {shown(unit)} cannot be converted into {shown(wanted)}") from None
    rounding = 1e-9 * max(abs(zero), abs(one))
    if not (isfinite(zero) and isfinite(one) and isclose(two - one, one - zero, rel_tol=1e-6, abs_tol=rounding)):
        raise ReadingsError(f"the unit {shown(unit)} is no linear function of {shown(wanted)}")
    return zero, one - zero
