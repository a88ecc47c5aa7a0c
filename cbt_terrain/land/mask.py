# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: how much of an effect is wanted where, by a painted image and by rules over the ground that it finds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import TerrainError, shown
from ..plain_numbers import keep_plain_numbers
from .mask_reads import ATTRIBUTES
from .tiles import Level, Window

HEIGHT, SLOPE, ASPECT = ("height", "slope", "aspect")
UNITS = {HEIGHT: "m", SLOPE: "degrees", ASPECT: ""} | {name: effect.unit for name, effect in ATTRIBUTES.items()}
# Of these an edge is in powers of ten: they go from a square metre to a continent, and a panel's to float32's end.
BY_TENS = ("flow", "discharge")
LIMITS = {HEIGHT: 1e9, SLOPE: 90.0, ASPECT: 1.0} | dict.fromkeys(ATTRIBUTES, 1e15) | dict.fromkeys(BY_TENS, 1e39)
STEEPEST = 1e30  # metres a metre
BAND_ROWS = 256


@dataclass(frozen=True)
class GroundRule:
    """1 from `low` to `high` of the quantity `of`, 0 beyond; over `edge`, half on each side of a limit, in between.
    Without an edge a limit itself is inside: ground without snow is that with snow from 0 to 0.

    `of`: height in metres; slope in degrees; aspect, the cosine of the angle between downhill and `direction` (degrees,
    clockwise from north), which is 0 on level ground; or one of ATTRIBUTES in its own unit, of those in BY_TENS with
    an edge in powers of ten. The ground is that which the effect finds.
    """

    of: str
    low: float = -math.inf
    high: float = math.inf
    edge: float = 0.0
    direction: float = 0.0

    def __post_init__(self):
        keep_plain_numbers(self, "A mask rule's")

    def check(self, where: str) -> None:
        """Raise TerrainError for what cannot be; `where`: whose rule it is."""
        if self.of not in LIMITS:
            known = ", ".join(LIMITS)
            raise TerrainError(f"{where} has a rule about {shown(repr(self.of))}; expected one of: {known}.")
        limit = LIMITS[self.of]
        known = [value for value in (self.low, self.high) if not math.isinf(value)]
        if any(math.isnan(v) or abs(v) > limit for v in known) or not 0.0 <= self.edge <= 2 * limit:
            raise TerrainError(
                f"{where} has a rule about {self.of} from {self.low:g} to {self.high:g} with an edge of {self.edge:g}; "
                f"expected numbers within {-limit:g} and {limit:g} {UNITS[self.of]}".rstrip()
                + "."
            )
        if self.low > self.high:
            raise TerrainError(
                f"{where} has a rule about {self.of} from {self.low:g} to {self.high:g}; expected a low limit below "
                "the high one."
            )
        if not -3600.0 <= self.direction <= 3600.0:
            raise TerrainError(
                f"{where} has a rule about {self.of} towards {self.direction:g} degrees; expected a direction within "
                "3600 degrees."
            )


@dataclass(frozen=True)
class Mask:
    """`image`: a file of one channel, white where all of the effect is wanted, over the raster's extent with its first
    row in the north; "" for none. It counts times all `rules`, times `factor`."""

    image: str = ""
    rules: tuple[GroundRule, ...] = ()
    factor: float = 1.0

    def __post_init__(self):
        keep_plain_numbers(self, "A mask's")

    @property
    def versions(self) -> tuple[int, ...]:
        """Of the effects that the rules read."""
        return tuple(ATTRIBUTES[rule.of].version for rule in self.rules if rule.of in ATTRIBUTES)

    def check(self, where: str) -> None:
        if not 0.0 <= self.factor <= 1.0:
            raise TerrainError(f"{where} has a factor of {self.factor}; expected 0 to 1.")
        for rule in self.rules:
            rule.check(where)


def whole_mask(
    mask: Mask,
    image: np.ndarray | None,
    level: Level,
    heights: Callable[[Window], np.ndarray],
    read: Mapping[str, np.ndarray] | None = None,
    window: Window | None = None,
) -> np.ndarray:
    """float32 [rows, columns] of a window of a level, 0 to 1.

    image: float32 [rows, columns], row 0 south, or None. heights(window) gives float32 metres of the ground. read: what
    rules about ATTRIBUTES read, float32 [rows, columns] of the window (mask_reads.py). window: None for all.
    """
    window = window or level.whole
    out = np.full([part.stop - part.start for part in window], mask.factor, np.float32)
    for first in range(0, len(out), BAND_ROWS):
        rows = slice(first, min(first + BAND_ROWS, len(out)))
        at = slice(window[0].start + rows.start, window[0].start + rows.stop)
        if image is not None:
            out[rows] *= _image_at(image, level, at, window[1])
        of_shape = [rule for rule in mask.rules if rule.of not in ATTRIBUTES]
        if of_shape:
            out[rows] *= _ruled(of_shape, level, at, window, heights)
        for rule in mask.rules:
            if rule.of in ATTRIBUTES:
                out[rows] *= _read(rule, read[rule.of][rows])
    return out


def _image_at(image: np.ndarray, level: Level, rows: slice, columns: slice) -> np.ndarray:
    """Bilinear between the middles of pixels, over the raster's extent, as painted rules of splat layers."""
    south, north, v = _pixels(np.arange(rows.start, rows.stop), level.rows, image.shape[0])
    west, east, u = _pixels(np.arange(columns.start, columns.stop), level.columns, image.shape[1])

    def along(row: np.ndarray) -> np.ndarray:
        line = image[row]
        return line[:, west] + (line[:, east] - line[:, west]) * u

    low, high = along(south), along(north)
    return low + (high - low) * v[:, None]


def _pixels(at: np.ndarray, count: int, pixels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of samples of `count`: the pixels on both sides, and how far they are from the first to the second."""
    place = np.clip(at * (pixels / (count - 1)) - 0.5, 0.0, pixels - 1.0)
    first = np.minimum(place.astype(np.int64), pixels - 1)
    return first, np.minimum(first + 1, pixels - 1), (place - first).astype(np.float32)


def _ruled(
    rules: list[GroundRule], level: Level, rows: slice, window: Window, heights: Callable[[Window], np.ndarray]
) -> np.ndarray:
    """The product of rules of height, slope and aspect at some rows of a window of a level."""
    wide = slice(max(rows.start - 1, window[0].start), min(rows.stop + 1, window[0].stop))
    ground = heights((wide, window[1]))
    inner = slice(rows.start - wide.start, rows.stop - wide.start)
    north, east = np.gradient(ground, np.float32(level.step_y), np.float32(level.step_x))
    north, east = north[inner], east[inner]
    tangent = np.sqrt(north * north + east * east)
    out = np.ones_like(tangent)
    for rule in rules:
        if rule.of == HEIGHT:
            out *= _between(ground[inner], rule.low, rule.high, rule.edge)
        elif rule.of == SLOPE:
            out *= _between_places(tangent, rule, _tangent)
        else:
            angle = math.radians(rule.direction)
            downhill = -(east * np.float32(math.sin(angle)) + north * np.float32(math.cos(angle)))
            cosine = np.divide(downhill, tangent, out=np.zeros_like(tangent), where=tangent > 0)
            out *= _between(cosine, rule.low, rule.high, rule.edge)
    return out


def _between(values: np.ndarray, low: float, high: float, edge: float) -> np.ndarray:
    half = 0.5 * edge
    return _rising(values, low - half, low + half) * _rising(-values, -high - half, -high + half)


def _read(rule: GroundRule, values: np.ndarray) -> np.ndarray:
    if rule.of not in BY_TENS:
        return _between(values, rule.low, rule.high, rule.edge)
    powers = (math.log10(limit) if limit > 0.0 else -math.inf for limit in (rule.low, rule.high))
    return _between_places(values, replace(rule, **dict(zip(("low", "high"), powers, strict=True))), _power)


def _between_places(values: np.ndarray, rule: GroundRule, place: Callable[[float], float]) -> np.ndarray:
    """Limits and edges are in degrees or in powers of ten, whose `place` among the values is given. Soft edges are
    straight in the values on each side of a limit: these need no function that differs from machine to machine."""
    half = 0.5 * rule.edge
    low, high = ([place(limit + side) for side in (-half, 0.0, half)] for limit in (rule.low, rule.high))
    down = [-limit for limit in reversed(high)]
    return _rising_by(values, low) * _rising_by(-values, down)


def _rising_by(values: np.ndarray, at: list[float]) -> np.ndarray:
    """As `_rising`, half at the second of three places."""
    if not np.float32(at[0]) < np.float32(at[2]):
        return (values >= np.float32(at[1])).astype(np.float32)
    return _smooth(np.interp(values, at, (0.0, 0.5, 1.0)).astype(np.float32))


def _power(tens: float) -> float:
    """10 to the power `tens`; what is below any number that is measured, or above, for those without end."""
    return -STEEPEST if tens == -math.inf else 10.0 ** min(tens, 30.0)


def _tangent(degrees: float) -> float:
    return math.copysign(STEEPEST, degrees) if abs(degrees) >= 90.0 else math.tan(math.radians(degrees))


def _rising(values: np.ndarray, first: float, last: float) -> np.ndarray:
    """0 up to `first`, 1 from `last` on, float32, smooth in between; where they are one number in float32, a step."""
    if not np.float32(first) < np.float32(last):
        return (values >= np.float32(first)).astype(np.float32)
    return _smooth(np.clip((values - np.float32(first)) * np.float32(1.0 / (last - first)), 0.0, 1.0, dtype=np.float32))


def _smooth(part: np.ndarray) -> np.ndarray:
    return part * part * (3.0 - 2.0 * part)
