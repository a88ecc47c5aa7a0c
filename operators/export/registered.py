# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of exports, in the order of their registration."""

from .bake_terrain import BakeTerrain
from .export_terrain import ExportTerrain
from .export_tiles import ExportHeights, ExportHeightTiles, ExportTileset
from .map_camera import MapCamera
from .render_map import RenderMap

CLASSES = (BakeTerrain, ExportTerrain, ExportHeights, ExportHeightTiles, ExportTileset, MapCamera, RenderMap)
HANDLERS = ()
