# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of maps, in the order of their registration."""

from .operators import BakeMaps
from .properties import MapSettings

CLASSES = (MapSettings, BakeMaps)
HANDLERS = ()
