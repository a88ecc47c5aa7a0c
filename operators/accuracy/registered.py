# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of measurements, in the order of their registration."""

from .measure import MeasureAccuracy
from .sweep import SweepAccuracy

CLASSES = (MeasureAccuracy, SweepAccuracy)
HANDLERS = ()
