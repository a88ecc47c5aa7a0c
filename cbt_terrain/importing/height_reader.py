# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of a raster as heights in metres, with the figures that a report needs."""

from dataclasses import dataclass, field

import numpy as np

from ..field import cleaning
from ..field.lands import LANDS
from ..rasters.raster import ImportSettings, Raster
from ..rasters.rounding import half_step
from .plausibility import ValueCheck


@dataclass
class HeightReader:
    """Conversion of values to heights; it collects figures of all values that were converted.

    Attributes:
        raster: the source, whose largest errors of position (`moved`) and of datums (`shifted`) are figures, too.
        check: gets all values of a raster that was not resampled.
        missing: number of missing samples so far.
        largest: largest absolute height, metres.
        converted: largest rounding error of float32, metres.
    """

    raster: Raster
    settings: ImportSettings
    check: ValueCheck = field(init=False)
    missing: int = 0
    largest: float = 0.0
    converted: float = 0.0

    def __post_init__(self) -> None:
        self.check = ValueCheck(np.dtype(self.raster.stored))

    def heights(self, values: np.ndarray) -> np.ndarray:
        """Return values [rows, columns] as heights, float32 metres with NaN where missing or infinite.

        The line of a raster of one row or column is repeated. Raises TerrainError for a height beyond 1e30 m.
        """
        scale, offset = scaling_of(self.raster, self.settings)
        if self.raster.original is None:
            self.check.add(values)
        if scale != 1.0 or offset != 0.0:
            with np.errstate(over="ignore", invalid="ignore"):
                values = values.astype(np.float64) * scale + offset
        if self.raster.width == 1 or self.raster.height == 1:
            values = cleaning.repeat_single_line(values)
        heights, absent = cleaning.clean_rows(values, self.settings.name)
        self.missing += absent
        if absent < heights.size:
            self.largest = max(self.largest, cleaning.largest_of(heights))
            # Measure the rounding to float32 if any value differs besides the absent ones: NaN differs from itself.
            if not np.can_cast(values.dtype, np.float32) and np.count_nonzero(values != heights) > absent:
                self.converted = max(self.converted, float(np.nanmax(np.abs(values - heights))))
        return heights

    def figures(self) -> dict:
        """Return the findings of all values so far as JSON, for `add`.

        These are the largest height, the largest errors, the marks of missing samples, and the range of other "values".
        """
        check = self.check
        return {
            "largest": self.largest,
            "converted": self.converted,
            "moved": self.raster.moved,
            "shifted": self.raster.shifted,
            "marks": list(check.marks.items()),
            "values": [check.low, check.high],
        }

    def add(self, figures: dict, missing: int) -> None:
        """Add the `figures` and the number of missing samples of another reader of the same raster."""
        self.missing += missing
        self.largest = max(self.largest, figures["largest"])
        self.converted = max(self.converted, figures["converted"])
        self.raster.moved = max(self.raster.moved, figures["moved"])
        self.raster.shifted = max(self.raster.shifted, figures["shifted"])
        for value, count in figures["marks"]:
            self.check.marks[value] = self.check.marks.get(value, 0) + count
        low, high = figures["values"]
        self.check.low, self.check.high = min(self.check.low, low), max(self.check.high, high)

    def source_max(self) -> float:
        """Return the largest distance, metres, by which rounding and resampling have moved the heights."""
        raster = self.raster
        if self.settings.source in LANDS:
            return 0.0
        scaling = scaling_of(raster, self.settings)
        # Half the step between stored values; that of a float type grows with the height, so the largest one counts.
        step = half_step(tuple(rounding.scaled(*scaling) for rounding in raster.roundings), self.largest)
        # `moved` by resampled positions and `shifted` by conversions of datums are in the unit of the file's values.
        return step + self.converted + (raster.moved + raster.shifted) * abs(scaling[0])


def scaling_of(raster: Raster, settings: ImportSettings) -> tuple[float, float]:
    """Return the scale and the offset, metres, from a source's values to heights."""
    scale = 1.0 if settings.height_scale is None else settings.height_scale
    return raster.scale * scale, raster.offset * scale + settings.height_offset
