# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of the entries of a store's JSON file, which may have been edited or damaged."""

import math
import re
from collections.abc import Callable
from typing import Any

from ..errors import shown
from .codes import MAX_EXPONENT, MIN_EXPONENT, exponent_of
from .georeference import LARGEST_EXTENT, SMALLEST_EXTENT
from .lattice import fit
from .shared_pages import NAMES

_DATA_NAME = re.compile(r"data-[0-9a-f]{32}")
# Arguments of `fit` for a raster's lattice.
LATTICE = ("width", "height", "step_x", "step_y")
JsonValue = Any  # of any type: these functions check it
# Samples of the largest raster (`Lattice.is_addressable`).
MAX_SAMPLES = 2**60


def is_data_name(name: str) -> bool:
    """Return whether a store's folder of arrays can have this name."""
    return _DATA_NAME.fullmatch(name) is not None


def _is_number(value: JsonValue, low: float = -1e300, high: float = 1e300) -> bool:
    """Return whether a JSON value is a number (no boolean) within limits."""
    return type(value) in (int, float) and low <= value <= high


def _is_count(value: JsonValue, low: int) -> bool:
    """Return whether a JSON value is a whole number from `low` to MAX_SAMPLES."""
    return type(value) is int and low <= value <= MAX_SAMPLES


def _is_extent(cells: int, step: JsonValue) -> bool:
    """Return whether `cells` steps, metres each, are a possible extent."""
    return _is_number(step) and SMALLEST_EXTENT < step * cells < LARGEST_EXTENT


def _is_lattice(value: JsonValue) -> bool:
    """Return whether a value has the sizes and steps of a raster that a lattice can address."""
    if not isinstance(value, dict) or sorted(value) != sorted(LATTICE):
        return False
    width, height = value["width"], value["height"]
    if not (_is_count(width, 2) and _is_count(height, 2)):
        return False
    fits_limits = _is_extent(width - 1, value["step_x"]) and _is_extent(height - 1, value["step_y"])
    return fits_limits and fit(**value).is_addressable


def _is_provenance(value: JsonValue) -> bool:
    """Return whether a value is an object; its "settings" are one, and their "source" is a text, if they exist."""
    if not isinstance(value, dict) or not isinstance(value.get("settings", {}), dict):
        return False
    return isinstance(value.get("settings", {}).get("source", ""), str)


def _is_text(value: JsonValue) -> bool:
    """Return whether a JSON value is a text."""
    return isinstance(value, str)


def _is_report_value(value: JsonValue) -> bool:
    """Return whether a report may hold a value: a text, a finite number, true or false, or a list of them."""
    return all(type(v) in (str, bool) or _is_number(v) for v in (value if isinstance(value, list) else [value]))


def _is_report(value: JsonValue) -> bool:
    """Return whether a value is an object of report values, in which "warnings" is a list of texts if it is there."""
    if not isinstance(value, dict) or not all(map(_is_report_value, value.values())):
        return False
    warnings = value.get("warnings", [])
    return isinstance(warnings, list) and all(map(_is_text, warnings))


# Limit of errors in ranges of heights: 1 for a bilinear surface, a few dozen for curvatures.
LARGEST_ERROR = 1000.0
LARGEST = 1e39  # metres: above all float32, and without overflow in squares and sums


def _is_exponents(value: JsonValue) -> bool:
    """Return whether a JSON value is a list of exponents of error codes. Its length is checked in `check_entries`."""
    return isinstance(value, list) and all(type(e) is int and MIN_EXPONENT <= e <= MAX_EXPONENT for e in value)


def _is_steps(value: JsonValue) -> bool:
    """Return whether a value is null, or the first number, scale and offset of `codes.Steps`.

    The first number is the smallest of uint8 and uint16 (0), int8 or int16.
    """
    if value is None:
        return True
    if not isinstance(value, list) or len(value) != 3 or value[0] not in (0, -128, -32768):
        return False
    return type(value[0]) is int and value[1] != 0 and all(_is_number(v, -1e30, 1e30) for v in value)


MAX_FINER_BITS, MAX_FINER_TILES = 8, 1 << 22  # of finer tiles

_LAYER = re.compile(r"[a-z][a-z0-9_]{0,40}")
MAX_LAYERS = 64


def _is_layers(value: JsonValue) -> bool:
    """Return whether a value is an object of at most MAX_LAYERS layers: names of files, and texts for units."""
    if not isinstance(value, dict) or len(value) > MAX_LAYERS:
        return False
    return all(_LAYER.fullmatch(name) and _is_text(unit) for name, unit in value.items())


def _is_place(value: JsonValue) -> bool:
    """Return whether a value has the six numbers of an affine map from metres to coordinates that can be inverted."""
    if not isinstance(value, list) or len(value) != 6 or not all(map(_is_number, value)):
        return False
    a, b, _, d, e, _ = value
    return 0.0 < abs(a * e - b * d) < math.inf


def _is_finer(value: JsonValue) -> bool:
    """Return whether a value describes finer tiles: number, bits, and the scales of their errors and ranges."""
    if not isinstance(value, dict) or sorted(value) != ["bits", "exponent", "range_base", "range_step", "tiles"]:
        return False
    bits, tiles = value["bits"], value["tiles"]
    if type(bits) is not int or type(tiles) is not int or not _is_exponents([value["exponent"]]):
        return False
    is_scale = _is_number(value["range_base"], -LARGEST, LARGEST) and _is_number(value["range_step"], 0.0, LARGEST)
    return is_scale and 1 <= bits <= MAX_FINER_BITS and 0 < tiles <= MAX_FINER_TILES


def _is_shared(value: JsonValue) -> bool:
    """Return whether a value is a list of names of arrays with shared pages."""
    return isinstance(value, list) and all(name in NAMES for name in value)


_HEIGHT = (lambda value: _is_number(value, -LARGEST, LARGEST), "a finite number of metres")
_DISTANCE = (lambda value: _is_number(value, 0.0, LARGEST), "a finite number of metres, at least 0")
_SLOPE = (lambda value: _is_number(value, 0.0, 1e60), "a finite number, at least 0")
_Entry = tuple[Callable[[JsonValue], bool], str]  # a check, and the expected value in words
_ENTRIES: dict[str, _Entry] = {
    "data": (lambda value: isinstance(value, str) and is_data_name(value), "data- and 32 hex digits"),
    "sum": (_is_text, "a text"),
    "digest": (_is_text, "a text"),
    "key": (_is_text, "a text"),
    "crs": (_is_text, "a text"),
    "lattice": (_is_lattice, f"{', '.join(LATTICE)} of a raster"),
    "holes": (lambda value: type(value) is bool, "true or false"),
    "exponents": (_is_exponents, f"whole numbers between {MIN_EXPONENT} and {MAX_EXPONENT}"),
    "steps": (_is_steps, "null, or the first number, the scale and the offset of a source's steps, of 1e30 at most"),
    "range_base": _HEIGHT,
    "range_step": _DISTANCE,
    "min_height": _HEIGHT,
    "max_height": _HEIGHT,
    "steepest_x": _SLOPE,
    "steepest_y": _SLOPE,
    "source_max": _DISTANCE,
    "filled": (lambda value: _is_count(value, 0), "a count"),
    "origin": (
        lambda value: isinstance(value, list) and len(value) == 3 and all(map(_is_number, value)),
        "three finite numbers",
    ),
    "provenance": (_is_provenance, "an object with the settings of the import"),
    "report": (_is_report, "an object with the figures and warnings of the import"),
}
# Entries that only some stores have.
_OPTIONAL: dict[str, _Entry] = {
    "layers": (_is_layers, f"an object of at most {MAX_LAYERS} layers and their units"),
    "finer": (_is_finer, f"the numbers of finer tiles, bits of 1 to {MAX_FINER_BITS}"),
    "shared": (_is_shared, f"some of {', '.join(NAMES)}"),
    "place": (_is_place, "six finite numbers that map metres to coordinates one to one"),
}


def check_entries(content: dict) -> None:
    """Raise ValueError that names the first entry of store.json that is missing, invalid or contradicts others.

    _ENTRIES must be there, _OPTIONAL may be; each has a test and a text for the expected value. Others are ignored.
    """
    for name, (is_valid, expected) in (_ENTRIES | {k: v for k, v in _OPTIONAL.items() if k in content}).items():
        if name not in content:
            raise ValueError(f"{name!r} is missing, expected {expected}")
        if not is_valid(content[name]):
            raise ValueError(f"its {name!r} is {shown(repr(content[name]))}, expected {expected}")
    low, high, exponents = content["min_height"], content["max_height"], content["exponents"]
    if low > high:
        raise ValueError(f"its 'min_height' {low} is above its 'max_height' {high}")
    lattice = fit(**content["lattice"])
    extent = lattice.step_x * lattice.width + lattice.step_y * lattice.height
    # The largest possible error, with a margin far above the rounding of heights; on the border of a hole it is a
    # length in the plane.
    limit = exponent_of(LARGEST_ERROR * (high - low) + 1e-3 * max(abs(low), abs(high)) + extent)
    if len(exponents) != lattice.groups + 1 or max(exponents) > limit:
        raise ValueError(f"its 'exponents' are {exponents}, expected {lattice.groups + 1} of {limit} at most")
