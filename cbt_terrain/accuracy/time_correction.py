# SPDX-License-Identifier: GPL-3.0-or-later
"""Correction of a cost curve by the times of recent updates, so that a time budget holds while a camera flies."""

import statistics
from collections import deque
from dataclasses import dataclass, field

from .cost_curve import CostCurve

MIN_UPDATES, MAX_UPDATES = 3, 5  # of which the median is taken: one slow update among them changes nothing
# The factor stays while the median is within this part of it: an update at a new error reuses less of the last one.
TOLERANCE = 0.05


@dataclass
class TimeCorrection:
    """The factor by which updates take longer than a cost curve predicts.

    Only the viewport corrects: a render's mesh depends on the curve alone.
    """

    factor: float = 1.0
    _ratios: deque = field(default_factory=lambda: deque(maxlen=MAX_UPDATES))

    def error_for_ms(self, curve: CostCurve, ms: float) -> float:
        """Return the finest error whose update is expected to take at most `ms` milliseconds, as the curve's method."""
        return curve.error_for_ms(ms / self.factor)

    def record(self, curve: CostCurve, error: float, ms: float) -> None:
        """Note that an update at an error took `ms` milliseconds, to correct the curve's times.

        Once there are MIN_UPDATES, of which the last MAX_UPDATES count, `factor` becomes the median of their times over
        the curve's if that differs from it by more than TOLERANCE; then these updates are forgotten.
        """
        _, expected_ms = curve.at(error)
        self._ratios.append(ms / expected_ms)
        median = statistics.median(self._ratios)
        if len(self._ratios) >= MIN_UPDATES and abs(median / self.factor - 1.0) > TOLERANCE:
            self.factor = median
            self._ratios.clear()
