# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of a caller's numbers, and of what holds them, to Python's types.

So keys, digests and JSON are the same for 50, 50.0 and numpy's float32(50).
"""

import dataclasses
from collections.abc import Iterable, Iterator
from numbers import Integral, Real
from types import NoneType
from typing import Any, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from .errors import TerrainError, check_kind, shown

EXPECTED = {bool: "True or False", int: "a whole number", float: "a number"}


def plain_number(value: Any, kind: Any, name: str) -> Any:
    """Return a value of an annotated `kind` with Python's numbers: bool, int, float, tuples of them, or None.

    A bool may also come as 0 or 1, an int as a whole float, and each of them as a numpy scalar; no bool is a number. A
    float may be infinite or NaN. Values of any other kind are returned as they are. Raises TerrainError for a value
    that does not fit its kind.

    Args:
        kind: the annotation, as int, float | None or tuple[int, int].
        name: subject of the error: "The criterion's max_depth".
    """
    if kind not in EXPECTED:
        return _plain_parts(value, kind, name)
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):  # a numpy scalar
        value = value.item()
    try:
        if kind is bool and isinstance(value, Integral) and value in (0, 1):
            return bool(value)
        if isinstance(value, Real) and not isinstance(value, bool):
            if kind is float:
                return float(value)
            if kind is int and (isinstance(value, Integral) or float(value).is_integer()):
                return int(value)  # type: ignore[call-overload]  # Real has no __int__ in typeshed
    except OverflowError:  # more than a float holds
        pass
    raise TerrainError(f"{name} is {shown(repr(value))}", expected=EXPECTED[kind])


def _plain_parts(value: Any, kind: Any, name: str) -> Any:
    """Return a value with Python's numbers, where `kind` is a tuple of kinds (tuple[float, float]) or an optional kind.

    Values of other kinds are returned as they are. Raises TerrainError, with `name` as its subject, for a wrong number
    and for a wrong count of them.
    """
    kinds = get_args(kind)
    if get_origin(kind) is not tuple:
        kinds = tuple(k for k in kinds if k is not NoneType)
        return value if value is None or len(kinds) != 1 else plain_number(value, kinds[0], name)
    if not set(kinds) <= EXPECTED.keys():
        return value
    parts = tuple(value) if np.iterable(value) else ()
    if len(parts) != len(kinds):
        raise TerrainError(f"{name} is {shown(repr(value))}", expected=f"{len(kinds)} numbers")
    return tuple(plain_number(part, part_kind, name) for part, part_kind in zip(parts, kinds, strict=True))


def keep_plain_numbers(settings: Any, owner: str) -> None:
    """Replace the numbers of a dataclass, even a frozen one, by Python's own, as its fields are annotated.

    Raises TerrainError for a value that `plain_number` refuses. owner: start of the error's subject, as "The
    criterion's".
    """
    for field in dataclasses.fields(settings):
        value = plain_number(getattr(settings, field.name), field.type, f"{owner} {field.name}")
        object.__setattr__(settings, field.name, value)


def plain_sequence(values: Any, kind: type | tuple[type, ...], name: str, expected: str) -> tuple:
    """Return a sequence of `kind`, or an iterator of them, as a tuple. Raises TerrainError for others, as a text.

    name: subject of the errors, as "The scatter's layers". expected: noun for the parts, as "Layer objects".
    """
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise TerrainError(f"{name} is {shown(repr(values))}", expected=f"a list of {expected}")
    parts = tuple(values)
    for part in parts:
        check_kind(part, kind, f"One of {name[0].lower()}{name[1:]}", expected)
    return parts


def matrix(values: ArrayLike, name: str) -> np.ndarray:
    """Return a 4 x 4 matrix as a new float64 array; numbers need not be finite. Raises TerrainError for others.

    name: the matrix's name in the error, as "placement".
    """
    checked = rows(values, 4, f"rows of the {name}")
    if len(checked) != 4:
        raise TerrainError(
            f"The rows of the {name} came as an array of the shape {checked.shape}", expected="4 x 4 numbers"
        )
    return checked.copy()


def vertical(scale: float, offset: float) -> tuple[float, float]:
    """Return a vertical scale and an offset in metres as floats. Raises TerrainError unless both are numbers."""
    return plain_number(scale, float, "The vertical scale"), plain_number(offset, float, "The vertical offset")


def vectors(values: ArrayLike, width: int, name: str) -> np.ndarray:
    """Return the vectors as float64 [n, width], contiguous. Raises TerrainError unless they are finite and fit `rows`.

    name: the vectors' name in the error, as "origins of rays".
    """
    checked = rows(values, width, name)
    finite = np.isfinite(checked)
    if not finite.all():
        first_wrong = int(np.argmin(finite.all(axis=1)))
        wrong = ", ".join(f"{value:g}" for value in checked[first_wrong])
        raise TerrainError(
            f"Number {first_wrong} of the {name} is ({wrong})", expected="finite metres", fix="correct or leave it out"
        )
    return checked


def rows(values: ArrayLike, width: int, name: str) -> np.ndarray:
    """Return vectors as float64 [n, width], contiguous; numbers need not be finite.

    values: [n, width], an iterator of vectors, a single vector [width], or nothing. Raises TerrainError for another
    shape and for values that are no numbers. name: the vectors' name in the error.
    """
    try:
        array = np.asarray(list(values) if isinstance(values, Iterator) else values)
        if array.dtype.kind in "cUS":
            raise TypeError  # a conversion would drop imaginary parts, and read texts
        array = np.ascontiguousarray(array, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TerrainError(f"The {name} are no numbers", expected=f"[n, {width}] metres") from None
    if array.ndim == 1 and array.size in (0, width):
        array = array.reshape(-1, width)
    if array.ndim != 2 or array.shape[1] != width:
        raise TerrainError(f"The {name} came as an array of the shape {array.shape}", expected=f"[n, {width}] metres")
    return array
