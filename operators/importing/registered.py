# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of imports, in the order of their registration."""

from . import pack_store, relative_paths, shared_origin, store_paths
from .add_terrain import AddTerrain
from .add_tiles import AddTiles, ImportTiles
from .import_terrain import ImportAdded, ImportTerrain
from .join_terrains import JoinTerrains
from .menus import AddTerrainFromFile, HeightMapDropped
from .pack_store import OfferPack, PackStore
from .render_loaded import RenderLoaded

CLASSES = (
    *(ImportTerrain, ImportAdded, AddTerrain, AddTiles, ImportTiles, JoinTerrains, AddTerrainFromFile),
    *(HeightMapDropped, PackStore, OfferPack, RenderLoaded),
)
HANDLERS = (
    *relative_paths.HANDLERS.items(),
    *store_paths.HANDLERS.items(),
    *shared_origin.HANDLERS.items(),  # after those that find stores
    ("save_pre", pack_store.on_save_pre),
    ("save_post", pack_store.on_save_post),
)
