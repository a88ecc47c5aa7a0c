# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles in view: during a large import those that views need are loaded, and renders wait for those that they see.

Until a large import is complete, its store has every n-th sample. Parts of the raster, its tiles, are loaded in more
detail. Where a mosaic has finer files, these are loaded afterwards, in parts called squares.
"""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.view.linear import inverse, product
from .. import jobs
from ..bridge import camera as cameras
from ..bridge.evaluated import raster_placement_of
from ..bridge.scene_paths import absolute_path
from ..land import render_wait
from ..session import session
from ..terrain import request, sight
from ..text.numbers import length_text
from ..text.translations import phrase
from .imported import imported_of

if TYPE_CHECKING:
    from ...cbt_terrain.importing.import_process import ImportJob
    from ...cbt_terrain.importing.view_needs import SeenLand

REST_S = 1.0  # without a change of a view, before tiles are loaded for it
RAY_DISTANCES = np.geomspace(1e-3, 4.0, 128)  # at which a ray may meet the ground, in diagonals of the terrain
_loaders: dict[int, "TileLoader"] = {}  # of running imports, by the session_uid of their terrains


class TileLoader:
    """Loads tiles into the incomplete store of a terrain beside the import that completes it, by one child at a time.

    Attributes:
        child: the process that loads tiles for viewports, None without one.
    """

    def __init__(self, settings: ImportSettings, store: str) -> None:
        """Prepare for an incomplete store. settings: of the quick import. store: absolute path."""
        self._settings, self._store = settings, Path(store)
        self.child: ImportJob | None = None
        self._has_failed = False
        self._shown: object = self  # key of the last view; no view has this one
        self._since = 0.0  # monotonic seconds since when that view has been shown
        self._served = self._shown  # key of the last view whose tiles were requested

    def start(self, obj, depsgraph, *modes: str) -> "ImportJob | None":
        """Start `child` if views lack tiles, and return it; None if they lack none.

        modes: VIEWPORT or RENDER, whose views count. Raises TerrainError if the store cannot be read or the child
        cannot start.
        """
        from ...cbt_terrain.importing.view_needs import MAX_SQUARES, missing_squares, missing_tiles

        tiles: set[int] = set()
        lands = []
        for mode in modes:
            with suppress(TerrainError):  # as without a camera: then no view needs any
                lands.append(_seen_by(obj, depsgraph, mode))
                tiles.update(missing_tiles(self._store, lands[-1]))
        squares = () if tiles else missing_squares(self._store, lands, MAX_SQUARES)
        self.child = self._load(tiles, squares) if tiles or squares else None
        return self.child

    def _load(self, tiles: Iterable[int], squares: Iterable[int]) -> "ImportJob":
        """Start a child that loads further tiles and squares, by their numbers, and those that were loaded.

        Raises TerrainError.
        """
        from ...cbt_terrain.importing.import_process import ImportJob
        from ...cbt_terrain.importing.refining import with_loaded

        return ImportJob(with_loaded(self._settings, self._store, tiles, squares), self._store)

    def turn(self, obj) -> bool:
        """Load tiles for a view that rests; return whether a child has just added some.

        Call it often on the main thread. It starts no further child after one has failed. obj: the terrain, None if it
        is gone.
        """
        if self.child is not None:
            progress = self.child.poll()
            if not progress.done:
                return False
            self.child, self._has_failed = None, progress.error is not None  # the import reports the cause
            self._served = self  # no view's key: serve this view again, as squares with finer files come after tiles
            return not self._has_failed
        if obj is None or self._has_failed or jobs.is_rendering():
            return False
        shown = session.record_of(obj).live_key  # changes with the viewports' views
        if shown != self._shown:
            self._shown, self._since = shown, time.monotonic()
        elif shown != self._served and time.monotonic() - self._since >= REST_S:
            self._served = shown
            with suppress(TerrainError):
                self.start(obj, bpy.context.evaluated_depsgraph_get(), request.VIEWPORT)
        return False

    def wait_for(self, obj, depsgraph) -> bool:
        """Load the tiles that a render lacks, on its thread; return whether it then needs no further detail.

        False also if they cannot be found or loaded: only the complete import then helps. Raises TerrainError after
        Esc. depsgraph: the render's.
        """
        from ...cbt_terrain.importing.view_needs import is_fine_enough, missing_squares, missing_tiles

        if self.child is not None:
            render_wait.wait_for_import(self.child)
        while True:
            try:
                seen = _seen_by(obj, depsgraph, request.RENDER)
                tiles = missing_tiles(self._store, seen)
                squares = () if tiles else missing_squares(self._store, [seen])
                if not tiles and not squares:
                    return is_fine_enough(self._store, [seen])
                child = self._load(tiles, squares)
            except TerrainError:
                return False  # the update reports it
            try:
                render_wait.wait_for_import(child)
            finally:
                child.cancel()
            if child.poll().error is not None:
                return False

    def load_for_render(self, obj, depsgraph) -> bool:
        """Return whether a render needs no further detail; start `child` for tiles that it lacks unless one runs.

        False while a child runs, which `turn` polls, and after one has failed: only the complete import then helps.
        Raises TerrainError if the store cannot be read.
        """
        from ...cbt_terrain.importing.view_needs import is_fine_enough

        if self.child is not None or self._has_failed:
            return False
        has_started = self.start(obj, depsgraph, request.RENDER) is not None  # tiles are missing
        # Without missing tiles the store may still be too coarse, as loaded tiles may leave out samples of the source.
        return not has_started and is_fine_enough(self._store, [_seen_by(obj, depsgraph, request.RENDER)])


@contextmanager
def loading(uid: int, settings: ImportSettings, store: str) -> Iterator[TileLoader]:
    """Yield the TileLoader of a terrain while its import runs. uid: session_uid of the object.

    settings: of the quick import. store: absolute path of the incomplete store.
    """
    loader = _loaders[uid] = TileLoader(settings, store)
    try:
        yield loader
    finally:
        del _loaders[uid]
        if loader.child is not None:
            loader.child.cancel()


def loader_of(obj) -> TileLoader | None:
    """Return the TileLoader of an incomplete terrain, None if no import with one runs for it."""
    return _loaders.get(obj.session_uid)


def _seen_by(obj, depsgraph, mode: str) -> "SeenLand":
    """Return the land that a terrain's views see in a mode, VIEWPORT or RENDER. Raises TerrainError."""
    return seen_land(request.gather(obj, depsgraph, mode, about_middle=True))


def seen_land(found: request.Request) -> "SeenLand":
    """Return the views of a terrain, and what else determines the tiles that they need.

    found: the request of an update, in whose space the raster's middle is the origin. An error of 0 pixels counts as 1.
    """
    from ...cbt_terrain.importing.view_needs import SeenLand

    scale = found.vertical_scale, found.vertical_offset
    return SeenLand(found.views, found.placement, found.criterion.error_px or 1.0, *scale)


def loaded_here(context, obj) -> str:
    """Return the detail of an incomplete terrain where the viewport or the camera looks, as `Loaded to 80 m here`.

    It is that of the whole terrain, as `Loaded to 640 m`, if no tiles are loaded or the view cannot be read, and "" for
    a complete one: more does not fit into the row. context: of a panel, in a viewport or another editor.
    """
    from ...cbt_terrain.importing.refining import loaded_at

    imported = imported_of(obj.adaptive_terrain)
    if imported is None or imported.loaded_m is None:
        return ""
    text = phrase("Loaded to {}", length_text(imported.loaded_m[0]))  # metres between the samples of the whole store
    if imported.refined_m is None:  # no tiles are loaded
        return text
    try:
        target = _target_of(context, obj)  # the ground in the middle of the view: metres from the raster's middle
        step = loaded_at(session.open_field(absolute_path(obj.adaptive_terrain.store)), *target)
    except (TerrainError, np.linalg.LinAlgError):
        return text
    # None: the complete store has taken its place by now.
    return phrase("Loaded to {} here", length_text(step)) if step else ""


def _target_of(context, obj) -> tuple[float, float]:
    """Return where the middle of a viewport, or of the camera without one, meets the terrain; else the eye's x and y.

    Both are metres from the raster's middle, which is the result without viewport and camera. Raises TerrainError, and
    LinAlgError for a transform that cannot be inverted.
    """
    space = context.space_data
    if space is not None and space.type == "VIEW_3D":
        region = next(region for region in context.area.regions if region.type == "WINDOW")
        view = cameras.view_from_region(space, region, space.region_3d)
    elif (camera := sight.camera_of(obj, context.scene)) is not None:
        view = sight.view_of_camera(context.scene, camera)
    else:
        return 0.0, 0.0
    field, settings = session.open_field(absolute_path(obj.adaptive_terrain.store)), obj.adaptive_terrain
    from_camera, lattice = inverse(product(view.world_to_camera, raster_placement_of(obj))), field.lattice
    eye, ahead = from_camera[:3, 3], -from_camera[:3, 2]
    west, south, east, north = lattice.rectangle()
    diagonal = np.hypot(east - west, north - south) / np.linalg.norm(ahead)  # in lengths of `ahead`
    points = eye + ahead * (RAY_DISTANCES * diagonal)[:, None]  # along the ray; the first one below the ground counts
    points = points[((points[:, :2] >= (west, south)) & (points[:, :2] <= (east, north))).all(axis=1)]
    columns = np.rint((points[:, 0] - west) / lattice.step_x).astype(np.int64)
    rows = np.rint((points[:, 1] - south) / lattice.step_y).astype(np.int64)
    heights = field.heights(rows, columns) * settings.vertical_scale + settings.vertical_offset
    below = np.flatnonzero(points[:, 2] <= heights)
    x, y = points[below[0], :2] if len(below) else eye[:2]
    return float(x), float(y)
