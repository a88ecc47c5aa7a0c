# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of an error on one terrain from one view: a curve through measured points, and its inverse."""

import itertools
import json
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

from ..errors import TerrainError

UNITS = ("px", "m")
# Beyond the measured points an answer is a guess; it goes this far and no further.
FINER, COARSER = 4.0, 16.0
# Answers are rounded to this many digits, so that machines whose logarithms differ in the last bit ask for the same.
DIGITS = 4
SAME = 1e-9  # fraction of a value that absorbs rounding
# Measured values are between these, and their ratios are still finite.
SMALLEST, LARGEST = 1e-30, 1e30


@dataclass(frozen=True)
class CostCurve:
    """Straight lines between measured points, with both axes logarithmic; at least two points.

    `unit`: the error's unit, "px" or "m". `error`: the requested errors, strictly decreasing. `triangles`, `ms`: the
    cost of a warm update; neither falls from one point to the next. Raises TerrainError for anything else.
    """

    unit: str
    error: tuple[float, ...]
    triangles: tuple[float, ...]
    ms: tuple[float, ...]

    def __post_init__(self) -> None:
        """Raise TerrainError unless errors fall, costs do not, and there are two points or more."""
        if self.unit not in UNITS:
            raise TerrainError(f"The cost curve's unit is {self.unit!r}", expected="px or m")
        for name in ("error", "triangles", "ms"):
            object.__setattr__(self, name, _positive_numbers(name, getattr(self, name)))
        if not 2 <= len(self.error) == len(self.triangles) == len(self.ms):
            lengths = f"{len(self.error)} errors, {len(self.triangles)} triangle counts and {len(self.ms)} times"
            raise TerrainError(f"The cost curve has {lengths}", expected="the same number of each, two or more")
        if any(a <= b for a, b in itertools.pairwise(self.error)):
            raise TerrainError(f"The cost curve's errors are {self.error}", expected="each smaller than the one before")
        for name in ("triangles", "ms"):
            if any(a > b for a, b in itertools.pairwise(getattr(self, name))):
                raise TerrainError(f"The cost curve's {name} fall where the error gets finer", fix="measure it again")

    @classmethod
    def through(cls, unit: str, points: Iterable[tuple[float, float, float]]) -> "CostCurve":
        """Return the curve through measured (error, triangles, ms), in any order.

        Errors measured more than once give their median. Where a finer error was measured to cost less, which is noise,
        the points are levelled to the nearest monotone curve (least squares of the logarithms). Raises TerrainError for
        fewer than two different errors and for values outside of SMALLEST .. LARGEST.
        """
        costs_by_error: dict[float, list] = {}
        for error, *costs in points:
            costs_by_error.setdefault(error, []).append(costs)
        errors = sorted(costs_by_error, reverse=True)
        medians = [[statistics.median(pair[k] for pair in costs_by_error[error]) for error in errors] for k in (0, 1)]
        names = "triangles", "ms"
        triangles, ms = (
            tuple(_make_monotone(_positive_numbers(name, costs))) for name, costs in zip(names, medians, strict=True)
        )
        return cls(unit, tuple(errors), triangles, ms)

    def at(self, error: float) -> tuple[float, float]:
        """Return (triangles, ms) at an error; beyond the measured points, along the slope at that end.

        A cost that overflows is infinite. Raises TerrainError for an error that is not finite and above 0.
        """
        if not 0 < error < math.inf:
            raise TerrainError(f"The error is {error} {self.unit}", expected="a finite number above 0")
        return self._cost(self.triangles, error), self._cost(self.ms, error)

    def error_for_ms(self, ms: float) -> float:
        """Return the finest error whose update takes at most `ms`, rounded up to four digits.

        It is between a quarter of the finest measured error and 16 times the coarsest; the latter is returned even if
        its update takes longer. Raises TerrainError unless `ms` is above 0; infinity is allowed.
        """
        if not ms > 0:
            raise TerrainError(f"The budget is {ms} milliseconds", expected="more than 0")
        finest, coarsest = self.error[-1] / FINER, self.error[0] * COARSER
        affordable = [i for i, cost in enumerate(self.ms) if cost <= ms]  # measured points within the budget
        segment = min(affordable[-1], len(self.ms) - 2) if affordable else 0  # starts at the point of this index
        slope = self._slope(self.ms, segment)
        # A chosen segment is level only at an end of the curve: beyond that end all errors cost the same.
        if slope == 0 or ms == math.inf:
            return finest if affordable else coarsest
        log_error = math.log(ms / self.ms[segment]) / slope + math.log(self.error[segment])
        if log_error <= math.log(finest):
            return finest
        return min(_round_up(math.exp(log_error)), coarsest) if log_error < math.log(coarsest) else coarsest

    def to_json(self) -> str:
        """Return the curve as JSON text, which is saved with the terrain's settings."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "CostCurve":
        """Read a curve that `to_json` wrote; raises TerrainError where the text is damaged."""
        try:
            data = json.loads(text)
        except (TypeError, ValueError, RecursionError) as reason:
            raise TerrainError(f"The cost curve is damaged ({reason})", fix="measure it again") from None
        names = list(cls.__dataclass_fields__)
        if not isinstance(data, dict) or sorted(data) != sorted(names):
            raise TerrainError("The cost curve is damaged", expected=", ".join(names), fix="measure it again")
        return cls(**data)

    def _cost(self, costs: tuple[float, ...], error: float) -> float:
        """Return the cost at an error by the power law between the two measured points around it.

        costs: those of the measured points, in the order of `error`.
        """
        # The first segment that reaches down to the error, or the last one.
        segment = next((i for i, e in enumerate(self.error[1:-1]) if e <= error), len(self.error) - 2)
        # From the segment's coarser end, unless the error is at its finer end or beyond that: then the costs of
        # measured points are exact.
        start = segment + 1 if error <= self.error[segment + 1] else segment
        try:
            return costs[start] * (error / self.error[start]) ** self._slope(costs, segment)
        except OverflowError:
            return math.inf

    def _slope(self, costs: tuple[float, ...], i: int) -> float:
        """Return the logarithm of cost over logarithm of error between points i and i + 1; 0 or less."""
        return math.log(costs[i + 1] / costs[i]) / math.log(self.error[i + 1] / self.error[i])


def _positive_numbers(name: str, values: Sequence) -> tuple[float, ...]:
    """Return the values as floats, each within SMALLEST and LARGEST.

    Raises TerrainError for anything else. name: the values' name in the error.
    """
    try:
        numbers = tuple(float(v) for v in values if not isinstance(v, str | bool))
        is_valid = len(numbers) == len(values) and all(SMALLEST <= n <= LARGEST for n in numbers)
    except (TypeError, ValueError, OverflowError):
        is_valid = False
    if not is_valid:
        expected = f"finite numbers above 0, from {SMALLEST:g} to {LARGEST:g}"
        raise TerrainError(f"The cost curve's {name} are {values!r}", expected=expected)
    return numbers


def _make_monotone(values: Sequence[float]) -> list[float]:
    """Return the nearest values that never fall.

    The geometric mean replaces neighbours in the wrong order (pool adjacent violators; Barlow et al. 1972).
    """
    blocks: list[list[float]] = []
    for value in values:
        blocks.append([value])
        while len(blocks) > 1 and _geometric_mean(blocks[-2]) > _geometric_mean(blocks[-1]):
            last = blocks.pop()
            blocks[-1] += last
    return [_geometric_mean(block) for block in blocks for _ in block]


def _geometric_mean(values: list[float]) -> float:
    """Return the geometric mean; a single value keeps its bits."""
    return values[0] if len(values) == 1 else statistics.geometric_mean(values)


def _round_up(value: float) -> float:
    """Round a positive value up to DIGITS digits; down if it exceeds such a number only by a rounding error (SAME)."""
    digits = DIGITS - 1 - math.floor(math.log10(value))
    scaled = math.ceil(value * 10.0**digits * (1 - SAME))
    return float(f"{scaled}e{-digits}")
