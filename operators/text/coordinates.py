# SPDX-License-Identifier: GPL-3.0-or-later
"""Two coordinates from a text that a user typed or pasted from a map, a table or the panel."""

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from ...cbt_terrain.errors import TerrainError, shown

EAST_FIRST, NORTH_FIRST, NO_ORDER = "EAST_FIRST", "NORTH_FIRST", "NO_ORDER"
EXAMPLES = 'two numbers, such as "47.42, 10.98" or "2600000 1200000"'
MAX_LENGTH = 200
# Names of a coordinate, in lower case, each with the sign of its numbers; those that only degrees have.
EASTWARD = {"e": 1, "w": -1, "x": 1, "east": 1, "west": -1, "easting": 1, "lon": 1, "lng": 1, "long": 1, "longitude": 1}
NORTHWARD = {"n": 1, "s": -1, "y": 1, "north": 1, "south": -1, "northing": 1, "lat": 1, "latitude": 1}
OF_DEGREES = {"w", "s", "west", "south", "lon", "lng", "long", "longitude", "lat", "latitude"}
# Signs for one character that keyboards, maps and tables write in several ways.
SAME = {"\u2212": "-", "\u2013": "-", "\u2019": "'", "\u2032": "'", "\u2033": '"', "\u201d": '"', "\u00ba": "\u00b0"}
SAME |= dict.fromkeys("\u00a0\u2009\u202f", " ")

_DEGREES = re.compile(
    r"""([+-]?\d+(?:[.,]\d+)?)\s*°(?:\s*(\d+(?:[.,]\d+)?)\s*'(?!'))?(?:\s*(\d+(?:[.,]\d+)?)\s*(?:"|''))?"""
)
_GROUPED = r"\d{1,3}(?:%s\d{3})+"
# Ways to write numbers: the character between digits of a number that is no part of it, the decimal sign, and a pattern
# of what separates two numbers.
_WAYS = (
    ("", ".", r"[\s,;/]+"),  # 47.42,10.98
    ("'", ".", r"[\s,;/]+"),  # 2'600'000 1'200'000
    (",", ".", r"[\s;/]+|,\s+"),  # 2,600,000.5, 1,200,000.5
    (".", ",", r"[\s;/]+|,\s+"),  # 2.600.000,5 1.200.000,5
    ("", ",", r"[\s;/]+|,\s+"),  # 47,42 10,98
    (" ", ".", r"\s*[,;/]\s*"),  # 2 600 000, 1 200 000
)


class Coordinates(NamedTuple):
    """Two numbers of a text.

    Attributes:
        first, second: in the order of the text, positive to the east and to the north.
        order: EAST_FIRST or NORTH_FIRST by their names, NO_ORDER without names.
        is_degrees: whether their names or signs are those of latitude and longitude.
    """

    first: float
    second: float
    order: str = NO_ORDER
    is_degrees: bool = False


def parse_coordinates(text: str) -> Coordinates:
    """Return the two coordinates in a text. Raises TerrainError for a text that has none, or that has two meanings."""
    plain = "".join(SAME.get(sign, sign) for sign in text[: MAX_LENGTH + 1]).strip(" \t\r\n,;()[]")
    if not plain:
        raise TerrainError("There are no coordinates", expected=EXAMPLES)
    names = re.findall("[a-z]+", plain.lower())
    numbers_only = re.sub("[A-Za-z]+[:=.]?", " ", plain).strip(" ,;")
    read = _read_degrees if "°" in plain else _read_numbers
    pair = None if len(text) > MAX_LENGTH else read(numbers_only)
    if pair is None or not all(map(math.isfinite, pair)):
        raise _unreadable(text)
    return _with_names(pair, names, "°" in plain, text)


def _unreadable(text: str) -> TerrainError:
    """Return the error for a text that has not two coordinates."""
    return TerrainError(f"The text {shown(text, 60)!r} cannot be read as coordinates", expected=EXAMPLES)


def _with_names(pair: tuple[float, float], names: list[str], is_degrees: bool, text: str) -> Coordinates:
    """Return two numbers as Coordinates; names such as "N" or "lon" in their text give their order, sign and unit.

    names: in lower case, none, or one for each number. Raises TerrainError for names that do not fit.
    """
    if not names:
        return Coordinates(*pair, is_degrees=is_degrees)
    if len(names) == 2:
        for order, axes in ((EAST_FIRST, (EASTWARD, NORTHWARD)), (NORTH_FIRST, (NORTHWARD, EASTWARD))):
            # -1 for west and south, None for a name of another axis. "-5 W" is refused: it may mean either side.
            signs = [axis.get(name) for axis, name in zip(axes, names, strict=True)]
            if None in signs or any(sign == -1 and number < 0.0 for sign, number in zip(signs, pair, strict=True)):
                continue
            first, second = (sign * number for sign, number in zip(signs, pair, strict=True))
            return Coordinates(first, second, order, is_degrees or not OF_DEGREES.isdisjoint(names))
    raise _unreadable(text)


def _read_degrees(text: str) -> tuple[float, float] | None:
    """Return two angles with degree signs, maybe with minutes and seconds, as degrees; None for another text."""
    found = [match.groups() for match in _DEGREES.finditer(text)]
    if len(found) != 2 or re.sub(r"[\s,;/]+", "", _DEGREES.sub("", text)):
        return None
    angles = []
    for parts in found:
        degrees, minutes, seconds = (float((part or "0").replace(",", ".")) for part in parts)
        is_divided = parts[1] is not None or parts[2] is not None
        if minutes >= 60.0 or seconds >= 60.0 or is_divided and not degrees.is_integer():
            return None
        angles.append(math.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, -1 if "-" in parts[0] else 1))
    return angles[0], angles[1]


def _read_numbers(text: str) -> tuple[float, float] | None:
    """Return two numbers in the first of the known ways to write them; None for another text.

    Raises TerrainError where commas may separate thousands as well as decimals: 47,420 10,980.
    """
    pairs = [pair for way in _WAYS if (pair := _read_pair(text, *way)) is not None]
    # Without a point or an apostrophe commas are ambiguous if two ways read different numbers, except if the first way
    # reads the text: then its comma separates two whole numbers, as in 47,10.
    if "." not in text and "'" not in text and len(set(pairs)) > 1 and _read_pair(text, *_WAYS[0]) is None:
        raise TerrainError(
            f"The commas in {shown(text, 60)!r} may separate decimals or thousands",
            fix="write the numbers with decimal points and without separators of thousands",
        )
    return pairs[0] if pairs else None


def _read_pair(text: str, group: str, decimal: str, separator: str) -> tuple[float, float] | None:
    """Return the two numbers of a text that is written in one way, None for another text.

    group: sign between thousands, "" for none. decimal: sign before decimals. separator: pattern of what is between the
    numbers.
    """
    whole = _GROUPED % re.escape(group) + r"|\d+" if group else r"\d+"
    is_number: Callable = re.compile(rf"[+-]?(?:{whole})(?:{re.escape(decimal)}\d*)?").fullmatch
    words = [word for word in re.split(separator, text) if word]
    if len(words) != 2 or not all(map(is_number, words)):
        return None
    first, second = (float(word.replace(group, "").replace(decimal, ".") if group else word.replace(decimal, "."))
                     for word in words)  # fmt: skip
    return first, second
