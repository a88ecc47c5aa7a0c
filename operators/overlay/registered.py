# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of the overlay, in the order of their registration."""

from .panel import ShowOverlay

CLASSES = (ShowOverlay,)
HANDLERS = ()
