# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about implausible values: undeclared no-data, and heights in another unit than metres."""

import math

import numpy as np

# Numbers that files use for missing samples: limits of 16-bit types, also with the wrong sign; nines; eights.
MARKS = {-32768.0, -32767.0, 32767.0, 32768.0, 65535.0, 65504.0, 55537.0, -8888.0, -88888.0}
MARKS |= {sign * (10.0**digits - 1.0) for digits in range(3, 11) for sign in (-1.0, 1.0)}
HUGE = 1e5  # beyond all heights on Earth in the units that files use
# Minimum distance of a mark from all other values, as a fraction of their range. Closer values count as heights.
APART, ZERO_APART = 0.1, 0.2
STEEP = 5.0  # ratio of relief to extent beyond which their units probably differ
MAX_MARKS, MAX_WARNINGS = 8, 3


class ValueCheck:
    """Search of a raster's values, block by block, for marks of missing samples at both ends of their range."""

    def __init__(self, stored: np.dtype) -> None:
        """Start without values; the ends of a type of 16 bits or more are suspected to mark missing samples."""
        limits = np.iinfo(stored) if stored.kind in "iu" and stored.itemsize > 1 else None
        self._ends = {float(limits.max), float(limits.min or limits.max)} if limits else set()
        self.marks: dict[float, int] = {}  # number of samples by mark
        self.low, self.high = math.inf, -math.inf  # range of all other values

    def add(self, rows: np.ndarray) -> None:
        """Search a block of values for marks of missing data at the ends of the range; NaN and infinities do not count.

        Other values extend the range.
        """
        finite = np.isfinite(rows)
        values = rows.ravel() if finite.all() else rows[finite]
        for end in (np.min, np.max):
            while values.size and self._is_mark(value := float(end(values))):
                others = values[values != end(values)]
                self.marks[value] = self.marks.get(value, 0) + values.size - others.size
                values = others
        if values.size:
            self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))

    def _is_mark(self, value: float) -> bool:
        """Return whether a value may mark missing samples: 0, a usual mark, an end of the type, or a huge number.

        Beyond MAX_MARKS marks no further huge number is one.
        """
        if value == 0.0 or value in MARKS or value in self._ends or value in self.marks:
            return True
        return abs(value) >= HUGE and len(self.marks) < MAX_MARKS  # heights in mm are huge, too, but many

    def warnings(self) -> list[str]:
        """Return warnings about marks that are apart from all other values, as undeclared no-data is.

        There are at most MAX_WARNINGS, and none without other values.
        """
        # marks: values that often mean no data, and how many samples have them. low, high: range of all other values.
        spread = self.high - self.low
        if not spread >= 0.0:  # all values are marks
            return []
        warnings = []
        for value, count in self.marks.items():
            gap = max(self.low - value, value - self.high)
            is_sea = value == 0.0 and spread == 0.0  # the sea around land of one height
            if is_sea or gap < (APART if value else ZERO_APART) * spread or gap <= 0.0:
                continue
            samples = f"{count:,} samples hold" if count > 1 else "1 sample holds"
            warnings.append(
                f"{samples} {value:.9g}, which stands apart from all others ({self.low:.6g} to {self.high:.6g}) and "
                "often means no data: if it does, import again and give it as the no-data value "
                f"(--no-data {value:.9g})."
            )
        return warnings[:MAX_WARNINGS]


def relief_warning(lowest: float, highest: float, extent: tuple[float, float], is_sized: bool) -> list[str]:
    """Return a warning, if any, about heights (metres) that are too large for the extent (metres).

    is_sized: whether the file or the user defines the extent; otherwise a sample is 1 m.
    """
    times = (highest - lowest) / max(extent)
    if times <= STEEP:
        return []
    unit = "the metres in one of the file's units as the height scale (--height-scale)"
    if is_sized:
        ways = f"If heights are not in metres, give {unit}; if that length is wrong, give the extent (--extent)."
    else:
        ways = f"The file names no size, so a sample is 1 m: give the extent in metres (--extent), or {unit}."
    return [f"The relief, {highest - lowest:.6g} m, is {times:,.0f} times the longer side, {max(extent):.6g} m. {ways}"]
