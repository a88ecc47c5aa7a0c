# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of the scene, in the order of their registration."""

from . import viewpoint
from .set_up import SetUpScene

CLASSES = (SetUpScene,)
HANDLERS = tuple(viewpoint.HANDLERS.items())
