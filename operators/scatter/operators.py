# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Scatter: an object with points on a terrain, and the collections of files of older versions."""

import bpy
from bpy.app.handlers import persistent

from ...cbt_terrain.errors import TerrainError
from ..bridge.scene_paths import store_path
from ..bridge.writer import new_child
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from . import starter
from .dry_ground import keep_dry
from .fitting import FULL_OF_CONES, REACH_HEIGHTS, first_spacing, put_numbers, scale_of
from .instancing import add_modifier, collection_of
from .request import is_scatter, scatters_of

CONES = "CONES"


class AddScatter(TerrainObjectOperator, bpy.types.Operator):
    """Add points that stay at the same places on the terrain, in a number that suits the camera. Then choose a
    collection whose objects stand on them"""

    bl_idname = "adaptive_terrain.scatter_add"
    bl_label = "Add Scatter"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Kind",
        description="Objects of the starter collection to scatter",
        items=[*starter.KIND_ITEMS, (CONES, "Cones", "Until you choose a collection of your own")],
        default=CONES, options={"SKIP_SAVE"},
    )  # fmt: skip

    def invoke(self, context, _event):
        """Add the scatter without waiting for kernels; the live update makes the points."""
        return self._add(context, waits=not context.object.adaptive_terrain.live)

    def execute(self, context):
        """Add the scatter and its points before returning: a script calls it."""
        return self._add(context, waits=True)

    @cancelled_by_errors
    def _add(self, context, *, waits: bool):
        """Add a scatter to the active terrain, fitted to its size and kept out of water.

        waits: update the terrain now, so that the points are there; otherwise the live update makes them.
        """
        terrain = context.object
        obj = new_scatter(terrain, first_spacing(session.open_field(store_path(terrain))))
        note = keep_dry(obj.adaptive_scatter, terrain)
        if self.kind != CONES:
            starter.put_kind(context, obj, self.kind)
        _select_alone(context, obj)
        if waits:
            try:
                session.update_object(terrain)
            except TerrainError as error:
                self.report({"WARNING"}, str(error))
            note = f"{len(obj.data.vertices):,} points; {note}"
        self.report({"INFO"}, note[:1].upper() + note[1:])
        return {"FINISHED"}


def new_scatter(terrain, spacing: float):
    """Create an object for a scatter of a terrain, with its modifier; return it.

    spacing: metres between points, in the terrain's space. Its default instances are cones as high as the spacing.
    full_until: distance from the camera, in metres of the world, up to which all points exist. reach: how far objects
    and their shadows extend.
    """
    obj = new_child(terrain, f"{terrain.name} Scatter")
    settings, in_world = obj.adaptive_scatter, spacing * scale_of(terrain)
    settings.enabled, settings.seed = True, len(scatters_of(terrain))
    full_until, reach = FULL_OF_CONES * in_world, REACH_HEIGHTS * in_world
    put_numbers(settings, spacing, full_until=full_until, reach=reach, first=True)
    add_modifier(obj, cone_height=in_world)
    return obj


def _select_alone(context, obj) -> None:
    """Make an object the active one and the only one that is selected, if the view layer shows it."""
    if obj.visible_get(view_layer=context.view_layer):
        for other in context.selected_objects:
            other.select_set(False)
        obj.select_set(True)
        context.view_layer.objects.active = obj


@persistent
def on_load(_path, _unused=None) -> None:
    """Set the property `collection` in files of older versions, which hold it in the modifier only."""
    for obj in bpy.data.objects:
        if is_scatter(obj) and obj.adaptive_scatter.collection is None:
            obj.adaptive_scatter.collection = collection_of(obj)
