"""Fields for a page: rounded to whole numbers of 16 or 8 bits, deflated, and written in base64."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

LARGEST = 11_000_000
"""Bytes that all fields of a page may take, in base64."""


def packed_fields(fields: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], int]:
    """Return fields (rows, nodes) as a page takes them, by name, and k, where every k-th row is kept.

    The finest of these that fits into ``LARGEST`` is chosen: all rows at 16 bits, all at 8 bits, every second, fourth,
    ... row at 8 bits, with the last row in any case. Each field has one scale, from its smallest to its largest value.
    """
    count = max((len(values) for values in fields.values()), default=0)
    for bits, every in _choices():
        rows = kept_rows(count, every)
        if bits == 16 and 2 * sum(values.size for values in fields.values()) > 8 * LARGEST:
            continue  # deflating never makes so little of it, and takes long
        found = {name: packed(values[rows], bits) for name, values in fields.items()}
        if every >= count or sum(len(one["data"]) for one in found.values()) <= LARGEST:
            return found, every
    raise AssertionError("the choices do not end")


def kept_rows(rows: int, every: int) -> list[int]:
    """Return every k-th of ``rows`` rows, and the last one."""
    return sorted({*range(0, rows, every), *([rows - 1] if rows else [])})


def packed(values: np.ndarray, bits: int) -> dict[str, Any]:
    """Return values (rows, nodes) as whole numbers of 8 or 16 bits, with ``low`` and ``step``: low + step * number.

    The largest number stands for a value that is not finite. ``error`` is the largest difference from the value. Each
    row holds differences from the row before, and of 16 bits the high bytes come first: this deflates better.
    """
    largest = 2**bits - 2
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    step = (high - low) / largest
    whole = np.rint(np.where(finite, values - np.float64(low), 0.0) / (step or 1.0))
    whole = np.where(finite, np.clip(whole, 0, largest), largest + 1).astype(np.uint16)
    differences = np.diff(whole.astype(np.int64), axis=0, prepend=0) % 2**bits
    planes = [differences] if bits == 8 else [differences >> 8, differences & 255]
    content = b"".join(plane.astype(np.uint8).tobytes() for plane in planes)
    return {
        "bits": bits,
        "low": low,
        "step": step,
        "error": 0.5 * step,
        "rows": values.shape[0],
        "nodes": values.shape[1],
        "data": deflated(content),
    }


def unpacked(field: Mapping[str, Any]) -> np.ndarray:
    """Return the values (rows, nodes) that a page makes of a packed field."""
    shape = (field["rows"], field["nodes"])
    content = np.frombuffer(zlib.decompress(base64.b64decode(field["data"])), dtype=np.uint8).astype(np.int64)
    planes = content.reshape(field["bits"] // 8, *shape)
    whole = np.cumsum(planes[0] if len(planes) == 1 else planes[0] * 256 + planes[1], axis=0) % 2 ** field["bits"]
    return np.where(whole == 2 ** field["bits"] - 1, np.nan, field["low"] + field["step"] * whole)


def deflated(content: bytes) -> str:
    """Return bytes deflated (RFC 1950) and in base64."""
    return base64.b64encode(zlib.compress(content, 6)).decode("ascii")


def deflated_numbers(values: np.ndarray, dtype: str) -> str:
    """Return numbers of a type such as ``<f4``, deflated and in base64."""
    return deflated(np.ascontiguousarray(values, dtype=dtype).tobytes())


def _choices() -> Iterator[tuple[int, int]]:
    """Yield bits and k, from the finest."""
    yield 16, 1
    yield 8, 1
    every = 2
    while True:
        yield 8, every
        every *= 2
