# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake maps of a terrain into images in the background, while the window stays usable."""

from typing import TYPE_CHECKING

import bpy

from ...cbt_terrain.attributes.folder import image_files
from ...cbt_terrain.height_operators.derived_store import raster_of
from .. import jobs
from ..job_operator import JobOperator
from ..session import session
from . import images as map_images

if TYPE_CHECKING:
    from ...cbt_terrain.attributes.bake import Baked
    from .baking import MapRequest


class BakeMaps(JobOperator, bpy.types.Operator):
    """Save attributes, such as normals or colours, as images as fine as the height map: shading then does not depend on
    the triangles. Only missing and outdated images are made"""

    bl_idname = "adaptive_terrain.bake_maps"
    bl_label = "Bake Maps"
    bl_options = {"REGISTER", "UNDO"}  # without an undo step, the next Undo would take the folder from the terrain

    kind = jobs.BAKE
    shows_error_on_panel = False

    def stops_on_escape(self) -> bool:
        """Return True: Esc cancels the job at any time."""
        return True

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Visit the frames that decide how fine the maps have to be, then bake them on a thread; return the Baked."""
        from .request import visit_for_request

        request = yield from jobs.visit_frames(job, visit_for_request(context.object, context.scene))
        job.progress(0.0)
        yield from jobs.wait_for_kernels(job)
        return (yield from jobs.run_on_thread(job, lambda: _shape_and_bake(request, job)))

    def finish(self, _context, obj, baked: "Baked") -> None:
        """Have Blender read the baked images again that it had loaded, and report the bake.

        Images that it had not loaded are loaded when a material is built.
        """
        from .baking import summary

        map_images.reserve_folder(obj)  # again: an undo may have removed the folder's name from the settings
        map_images.reload(map_images.map_folder(obj), _image_files(baked))
        self.report({"INFO"}, summary(baked, obj.name))


def _shape_and_bake(request: "MapRequest", job: jobs.BackgroundJob) -> "Baked":
    """Shape the land of a request if that is not done, and bake its maps, on the job's thread. Raises TerrainError."""
    from .baking import bake_maps

    with session.engine_lock:
        field = raster_of(request.store, request.land, session.open_field, verified=True)
    return bake_maps(request, field, job.progress, session.engine_lock)


def _image_files(baked: "Baked") -> set[str]:
    """Return the file names by which Blender's images may show the maps: of single tiles, and patterns of all tiles."""
    return image_files(baked.index) | {entry["file"] for entry in baked.index["maps"].values()}
