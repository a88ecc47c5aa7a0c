# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of attributes, in the order of their registration."""

from .panel import AttributeList
from .properties import GROUPS, EffectsSettings

CLASSES = (*GROUPS.values(), EffectsSettings, AttributeList)
HANDLERS = ()
