# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: weights of a height operator at each sample, from a painted image and from rules about its input ground."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import TerrainError, shown
from ..plain_numbers import keep_plain_numbers
from .mask_reads import MASK_ATTRIBUTES
from .tiles import Level, Window

HEIGHT, SLOPE, ASPECT = ("height", "slope", "aspect")
UNITS = {HEIGHT: "m", SLOPE: "degrees", ASPECT: ""} | {name: effect.unit for name, effect in MASK_ATTRIBUTES.items()}
# Quantities with edges in powers of ten, since they range over many of them. The panel's limits reach to float32's end.
LOGARITHMIC = ("flow", "discharge")
LIMITS = (
    {HEIGHT: 1e9, SLOPE: 90.0, ASPECT: 1.0} | dict.fromkeys(MASK_ATTRIBUTES, 1e15) | dict.fromkeys(LOGARITHMIC, 1e39)
)
STEEPEST = 1e30  # metres a metre
BAND_ROWS = 256


@dataclass(frozen=True)
class GroundRule:
    """A weight of 1 from `low` to `high`, 0 outside, and a smooth step of width `edge` centred on each limit.

    Without an edge the limits are inside: snow from 0 to 0 selects ground without snow. The ground is the operator's
    input. Quantities are height in metres; slope in degrees; aspect, the cosine of the angle between downhill and
    `direction` (degrees clockwise from north; 0 on level ground); and MASK_ATTRIBUTES in their units. An edge has the
    same unit, for those in LOGARITHMIC in powers of ten.
    """

    of: str
    low: float = -math.inf
    high: float = math.inf
    edge: float = 0.0
    direction: float = 0.0

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "A mask rule's")

    def check(self, where: str) -> None:
        """Raise TerrainError for an invalid rule. where: subject of the error, as "The mask of entry 2"."""
        if self.of not in LIMITS:
            raise TerrainError(
                f"{where} has a rule about {shown(repr(self.of))}", expected=f"one of: {', '.join(LIMITS)}"
            )
        limit, rule = LIMITS[self.of], f"{where} has a rule about {self.of}"
        finite = [value for value in (self.low, self.high) if not math.isinf(value)]
        if any(math.isnan(v) or abs(v) > limit for v in finite) or not 0.0 <= self.edge <= 2 * limit:
            raise TerrainError(
                f"{rule} from {self.low:g} to {self.high:g} with an edge of {self.edge:g}",
                expected=f"numbers from {-limit:g} to {limit:g} {UNITS[self.of]}".rstrip(),
            )
        if self.low > self.high:
            raise TerrainError(f"{rule} from {self.low:g} to {self.high:g}", expected="a low limit below the high one")
        if not -3600.0 <= self.direction <= 3600.0:
            raise TerrainError(f"{rule} towards {self.direction:g} degrees", expected="-3600 to 3600 degrees")


@dataclass(frozen=True)
class HeightMask:
    """The product of an image, all rules and a factor from 0 to 1.

    `image`: file of one channel over the raster's extent, first row in the north, where white means 1; "" for none.
    """

    image: str = ""
    rules: tuple[GroundRule, ...] = ()
    factor: float = 1.0

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "A mask's")

    @property
    def versions(self) -> tuple[int, ...]:
        """Return the versions of the attributes that the rules read, which are parts of keys."""
        return tuple(MASK_ATTRIBUTES[rule.of].version for rule in self.rules if rule.of in MASK_ATTRIBUTES)

    def check(self, where: str) -> None:
        """Raise TerrainError for an invalid mask. where: subject of the error, as "The mask of entry 2"."""
        if not 0.0 <= self.factor <= 1.0:
            raise TerrainError(f"{where} has a factor of {self.factor}", expected="0 to 1")
        for rule in self.rules:
            rule.check(where)


def compute_mask(
    mask: HeightMask,
    image: np.ndarray | None,
    level: Level,
    heights: Callable[[Window], np.ndarray],
    attributes: Mapping[str, np.ndarray] | None = None,
    window: Window | None = None,
) -> np.ndarray:
    """Return the weights of a window of a level, float32 [rows, columns], 0 to 1.

    image: float32 [rows, columns], row 0 south, or None. heights(window): returns float32 metres of the ground.
    attributes: values of MASK_ATTRIBUTES, float32 [rows, columns] of the window (mask_reads.py). window: None for the
    whole level.
    """
    window, attributes = window or level.whole, attributes or {}
    out = np.full([part.stop - part.start for part in window], mask.factor, np.float32)
    for first in range(0, len(out), BAND_ROWS):  # bands of rows, so that temporary arrays are small
        rows = slice(first, min(first + BAND_ROWS, len(out)))
        level_rows = slice(window[0].start + rows.start, window[0].start + rows.stop)
        if image is not None:
            out[rows] *= _image_at(image, level, level_rows, window[1])
        ground_rules = [rule for rule in mask.rules if rule.of not in MASK_ATTRIBUTES]
        if ground_rules:
            out[rows] *= _weigh_ground(ground_rules, level, level_rows, window, heights)
        for rule in mask.rules:
            if rule.of in MASK_ATTRIBUTES:
                out[rows] *= _weigh_attribute(rule, attributes[rule.of][rows])
    return out


def _image_at(image: np.ndarray, level: Level, rows: slice, columns: slice) -> np.ndarray:
    """Return the image's values at samples of a level, bilinear between pixel centres, float32 [rows, columns].

    The image extends over the whole raster, as painted images of splat layers do. rows, columns: samples of the
    level.
    """
    south, north, v = _pixels(np.arange(rows.start, rows.stop), level.rows, image.shape[0])
    west, east, u = _pixels(np.arange(columns.start, columns.stop), level.columns, image.shape[1])

    def interpolate_rows(numbers: np.ndarray) -> np.ndarray:
        """Interpolate the image's rows of these numbers at the columns of the level."""
        lines = image[numbers]
        return lines[:, west] + (lines[:, east] - lines[:, west]) * u

    low, high = interpolate_rows(south), interpolate_rows(north)
    return low + (high - low) * v[:, None]


def _pixels(samples: np.ndarray, count: int, pixels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels on both sides of samples along an axis, and the fraction of the way from the first one.

    samples: their numbers. count: samples of the whole axis. pixels: the image's pixels along it.
    """
    position = np.clip(samples * (pixels / (count - 1)) - 0.5, 0.0, pixels - 1.0)
    first = np.minimum(position.astype(np.int64), pixels - 1)
    return first, np.minimum(first + 1, pixels - 1), (position - first).astype(np.float32)


def _weigh_ground(
    rules: list[GroundRule], level: Level, rows: slice, window: Window, heights: Callable[[Window], np.ndarray]
) -> np.ndarray:
    """Return the product of rules about height, slope and aspect at some rows of a window of a level.

    rows: of the level. heights: function that returns the heights in a window, metres. The result is float32 [rows,
    columns], 0 to 1.
    """
    # Slopes read a row beyond these, if the window has one.
    wide = slice(max(rows.start - 1, window[0].start), min(rows.stop + 1, window[0].stop))
    ground = heights((wide, window[1]))
    inner = slice(rows.start - wide.start, rows.stop - wide.start)
    north, east = np.gradient(ground, np.float32(level.step_y), np.float32(level.step_x))
    north, east = north[inner], east[inner]
    tangent = np.sqrt(north * north + east * east)
    out = np.ones_like(tangent)
    for rule in rules:
        if rule.of == HEIGHT:
            out *= _weigh_interval(ground[inner], rule.low, rule.high, rule.edge)
        elif rule.of == SLOPE:
            out *= _weigh_mapped(tangent, rule, _tangent)  # `_tangent` maps the limits, in degrees, to slopes
        else:
            # Aspect is the cosine of the angle between downhill and the rule's direction.
            angle = math.radians(rule.direction)
            downhill = -(east * np.float32(math.sin(angle)) + north * np.float32(math.cos(angle)))
            cosine = np.divide(downhill, tangent, out=np.zeros_like(tangent), where=tangent > 0)
            out *= _weigh_interval(cosine, rule.low, rule.high, rule.edge)
    return out


def _weigh_interval(values: np.ndarray, low: float, high: float, edge: float) -> np.ndarray:
    """Return weights, 1 between the limits `low` and `high` and 0 beyond.

    At each limit is the middle of a smooth step of width `edge`, with the weight 0.5. Without an edge, values at the
    limits have the weight 1.
    """
    half = 0.5 * edge
    return _step(values, low - half, low + half) * _step(-values, -high - half, -high + half)


def _weigh_attribute(rule: GroundRule, values: np.ndarray) -> np.ndarray:
    """Return the weights of attribute values by a rule, 0 to 1; an edge of LOGARITHMIC ones is in powers of ten."""
    if rule.of not in LOGARITHMIC:
        return _weigh_interval(values, rule.low, rule.high, rule.edge)
    # Limits become exponents of ten, as the edge is.
    low, high = (math.log10(limit) if limit > 0.0 else -math.inf for limit in (rule.low, rule.high))
    return _weigh_mapped(values, replace(rule, low=low, high=high), _power)  # `_power` turns exponents into limits


def _weigh_mapped(values: np.ndarray, rule: GroundRule, to_value: Callable[[float], float]) -> np.ndarray:
    """Weigh values by a rule's limits and edge in degrees or as exponents of ten, which `to_value` maps to values.

    Only limits are mapped, and each half of an edge is interpolated in the values: functions of all values would have
    last bits that differ between machines.
    """
    half = 0.5 * rule.edge  # for each limit the values at the start, in the middle and at the end of its edge
    low, high = ([to_value(limit + side) for side in (-half, 0.0, half)] for limit in (rule.low, rule.high))
    return _step_through(values, low) * _step_through(-values, [-limit for limit in reversed(high)])


def _step_through(values: np.ndarray, knots: list[float]) -> np.ndarray:
    """Return a smooth step that is 0, 0.5 and 1 at three knots; a hard one if they are one number in float32."""
    if not np.float32(knots[0]) < np.float32(knots[2]):
        return (values >= np.float32(knots[1])).astype(np.float32)
    return _smoothstep(np.interp(values, knots, (0.0, 0.5, 1.0)).astype(np.float32))


def _power(exponent: float) -> float:
    """Return 10^exponent; for an infinite exponent a number below or above all values that a mask reads."""
    return -STEEPEST if exponent == -math.inf else 10.0 ** min(exponent, 30.0)


def _tangent(degrees: float) -> float:
    """Return the slope of an angle in degrees; STEEPEST at 90 and more, -STEEPEST at -90 and less."""
    return math.copysign(STEEPEST, degrees) if abs(degrees) >= 90.0 else math.tan(math.radians(degrees))


def _step(values: np.ndarray, first: float, last: float) -> np.ndarray:
    """Return a smooth step from 0 at `first` to 1 at `last`, float32; a hard one if they are one number in float32."""
    if not np.float32(first) < np.float32(last):
        return (values >= np.float32(first)).astype(np.float32)
    return _smoothstep(
        np.clip((values - np.float32(first)) * np.float32(1.0 / (last - first)), 0.0, 1.0, dtype=np.float32)
    )


def _smoothstep(t: np.ndarray) -> np.ndarray:
    """Return the smooth step from 0 to 1 of values 0 to 1."""
    return t * t * (3.0 - 2.0 * t)
