# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of the panels, in the order of their registration."""

from .object_menu import ObjectMenu
from .panels import CLASSES as PANELS
from .status_row import ShowMessage

CLASSES = (ShowMessage, *PANELS, ObjectMenu)
HANDLERS = ()
