# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of the scene, in the order of their registration."""

from .set_up import SetUpScene

CLASSES = (SetUpScene,)
HANDLERS = ()
