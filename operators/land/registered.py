# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of land, in the order of their registration."""

from .bake_land import BakeLand
from .cache import ClearLandCache
from .panel import AddLandMenu, LandList, LandPresets
from .presets import AddLandPreset, ApplyLandPreset
from .properties import GROUPS, OTHER_RULES, LandEntry, LandMask, LandSettings
from .render_wait import CancelWaiting
from .shape_land import FinishShaping, ShapeAndRender, ShapeLand
from .stack_list import AddLandEffect, AddLandRule, DuplicateLandEffect, MoveLandEffect, RemoveLandEffect
from .water_surface import AddWaterSurface

CLASSES = (
    *(*GROUPS.values(), *OTHER_RULES, LandMask, LandEntry, LandSettings),
    *(AddLandEffect, DuplicateLandEffect, RemoveLandEffect, MoveLandEffect, AddLandRule),
    *(ApplyLandPreset, AddLandPreset, ClearLandCache, ShapeLand, ShapeAndRender, FinishShaping, CancelWaiting),
    *(BakeLand, AddWaterSurface, LandList, LandPresets, AddLandMenu),
)
HANDLERS = ()
