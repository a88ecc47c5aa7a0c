# SPDX-License-Identifier: GPL-3.0-or-later
"""Place at Coordinates: move the selected objects or the 3D cursor to coordinates, on the ground."""

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.linear import length
from ..session.polls import cancelled_by_errors, invoke_with_file, remember_object
from ..text.coordinates import parse_coordinates
from ..text.numbers import length_text
from ..text.translations import phrase
from . import keep_ground
from . import vertical_moves as moves
from .chosen import GroundOperator, chosen_grounds, objects_to_move, selected_objects
from .known_points import AUTOMATIC, SYSTEMS, find_point


class PlaceAtCoordinates(GroundOperator, bpy.types.Operator):
    """Move the selected objects, or the 3D cursor if none is selected, to coordinates of a map, on the ground: east and
    north, or latitude and longitude. Objects keep their places relative to the active one"""

    bl_idname = "adaptive_terrain.place_at_coordinates"
    bl_label = "Place at Coordinates"
    bl_options = {"REGISTER", "UNDO"}

    coordinates: bpy.props.StringProperty(
        name="Coordinates",
        description="Two numbers in one text, such as 47.42, 10.98 (latitude, longitude) or 2600000 1200000 (east, "
        "north); you can paste them",
    )
    system: bpy.props.EnumProperty(
        name="System", description="Meaning of the two numbers", items=SYSTEMS, default=AUTOMATIC
    )
    # Set when the operator is run again with the chosen options, once the kernels are ready (session/polls.py).
    is_chosen: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        """Ask for the coordinates, or move once they are chosen and the kernels are ready."""
        if self.is_chosen:
            return GroundOperator.invoke(self, context, event)
        remember_object(self, context)
        self._has_kernels(context)  # starts to prepare them while the user types
        return context.window_manager.invoke_props_dialog(self, width=360)

    def cancel(self, context):
        """Stop waiting for the kernels; Blender calls this, too, when the dialog is closed, which waits for nothing."""
        if self.is_chosen:
            GroundOperator.cancel(self, context)

    def draw(self, context):
        """Draw the text, its system and the name of the moving object."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "coordinates")
        layout.prop(self, "system")
        layout.label(text=phrase("Moves: {}", _name_of(_objects_of(context)) or phrase("3D Cursor")))

    @cancelled_by_errors
    def execute(self, context):
        """Move the selected objects or the 3D cursor to the coordinates, and report where that is."""
        if self.options.is_invoke and not self.is_chosen and not self._has_kernels(context):
            # Runs this operator anew with `is_chosen` and these properties: `invoke` then waits for the kernels, which
            # a dialog cannot.
            invoke_with_file(self, context)
            return {"CANCELLED"}
        given, depsgraph = parse_coordinates(self.coordinates), context.evaluated_depsgraph_get()
        point = find_point(chosen_grounds(context, depsgraph), given, self.system)
        objects = _objects_of(context)
        if not objects:
            context.scene.cursor.location = point.position
        elif missed := _move_together(context, objects, point.position, depsgraph):
            why = "because a constraint holds it: mute the constraint."
            self.report({"WARNING"}, f"{objects[0].name} is {length_text(missed)} from these coordinates, {why}")
        name = _name_of(objects) or "3D cursor"
        note = point.note and f", {point.note}"
        self.report({"INFO"}, f"{name}: {point.coordinates}, height {point.height:,.2f} m{note}")
        return {"FINISHED"}


def _objects_of(context) -> list:
    """Return the selected objects without terrains; the active one first, if it is among them."""
    objects = selected_objects(context)
    return sorted(objects, key=lambda obj: obj != context.object)


def _name_of(objects: list) -> str:
    """Return the name of the first object with the number of the others, "" without any."""
    others = f" + {len(objects) - 1:,}" if len(objects) > 1 else ""
    return f"{objects[0].name}{others}" if objects else ""


def _move_together(context, objects: list, point: np.ndarray, depsgraph) -> float:
    """Move objects by one vector, so that the origin of the first is at a point of the world, float64 [3].

    Return its distance in metres from that point if a constraint holds it, else 0. Raises TerrainError before anything
    moves if one of them cannot be moved.
    """
    anchor, movable = objects[0], objects_to_move(objects)
    for obj in movable:
        moves.check_local(obj)
        moves.check_unlocked(obj)
        if moves.is_animated(obj, "location"):
            what = f"The object {obj.name!r} is animated, and the next frame would bring it back"
            raise TerrainError(what, fix="remove the animation of its location, or parent it to an empty and move that")
    by = point - np.array(anchor.evaluated_get(depsgraph).matrix_world.translation, np.float64)
    steps = [moves.channel_move(moves.channels_to_world(obj.evaluated_get(depsgraph)), by.tolist()) for obj in movable]
    for obj, step in zip(movable, steps, strict=True):
        obj.location = obj.location + step
    depsgraph.update()
    evaluated = anchor.evaluated_get(depsgraph)
    missed = length(np.array(evaluated.matrix_world.translation, np.float64) - point)
    tolerance = 1e-3 + moves.rounding(evaluated, float(np.abs(point).max()))  # metres
    if any(obj.adaptive_terrain_keep.keep for obj in movable):
        keep_ground.settle_now(context.scene, depsgraph)
    return float(missed) if missed > tolerance else 0.0
