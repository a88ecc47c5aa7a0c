# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of a terrain, in the order of their registration."""

from .detail_properties import RenderDetail, ViewportDetail
from .frame_terrain import FrameTerrain
from .freeze_detail import FreezeDetail
from .properties import CleanupSettings, SceneSettings, TerrainSettings
from .update_terrain import LockInterface, UpdateTerrain

CLASSES = (
    *(ViewportDetail, RenderDetail, CleanupSettings, TerrainSettings, SceneSettings),
    *(FrameTerrain, UpdateTerrain, LockInterface, FreezeDetail),
)
HANDLERS = ()
