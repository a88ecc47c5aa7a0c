# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of a terrain, in the order of their registration."""

from .detail_properties import RenderDetail, ViewportDetail
from .frame_terrain import FrameTerrain
from .move_world import MoveWorld
from .properties import CleanupSettings, SceneSettings, SourceFile, TerrainSettings
from .update_terrain import FreezeDetail, LockInterface, UpdateTerrain

CLASSES = (
    *(ViewportDetail, RenderDetail, CleanupSettings, SourceFile, TerrainSettings, SceneSettings),
    *(FrameTerrain, UpdateTerrain, LockInterface, FreezeDetail, MoveWorld),
)
HANDLERS = ()
