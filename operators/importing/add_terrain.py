# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Mesh > Adaptive Terrain: a terrain with a built-in land."""

import bpy
from bpy_extras.object_utils import AddObjectHelper, object_data_add

from ...cbt_terrain.field.island import DEFAULT_SEED
from ...cbt_terrain.field.lands import LANDS
from ..land.entries import PRESETS
from ..layers.properties import add_default_layers
from ..session import session
from ..terrain.properties import ISLAND, built_in_land, land_items
from .import_terrain import start_import


class AddTerrain(bpy.types.Operator, AddObjectHelper):
    """Add a terrain with built-in land, which you can replace by your own height map"""

    bl_idname = "mesh.adaptive_terrain_add"
    bl_label = "Adaptive Terrain"
    bl_options = {"REGISTER", "UNDO"}

    land: bpy.props.EnumProperty(name="Land", description="Built-in land", items=land_items(), default=ISLAND)
    shape: bpy.props.BoolProperty(
        name="Shape",
        description="Also add land effects that suit it, such as rivers, scree and snow. The land then has its real "
        "size in metres",
    )  # fmt: skip
    natural_size: bpy.props.BoolProperty(
        name="Own Size",
        description="Give the land its real width, 8 to 33 km, and move the viewports so that they show it",
    )
    size: bpy.props.FloatProperty(
        name="Size",
        description="Width of the land in metres; small by default, like other objects that Blender adds",
        default=20.0, min=0.001, soft_max=100_000.0, unit="LENGTH",
    )  # fmt: skip
    seed: bpy.props.IntProperty(
        name="Seed", description="Another number makes other land of the same kind", default=DEFAULT_SEED, min=0
    )

    @classmethod
    def poll(cls, context):
        """Return whether Blender is in Object Mode; if not, set the reason that it shows."""
        cls.poll_message_set("Leave the mode for Object Mode: a terrain is an object of its own")
        return context.mode == "OBJECT"

    def draw(self, _context):
        """Draw the options below the viewport after the terrain was added; those without effect are grey.

        A land that gets its stack of height operators (`_is_shaped`) always has its real size.
        """
        layout, land = self.layout, LANDS[self.land.lower()]
        layout.use_property_split = True
        layout.prop(self, "land")
        layout.prop(self, "seed")
        for name, has_effect in (("shape", land.preset), ("natural_size", not self._is_shaped(land)),
                                 ("size", not self.natural_size and not self._is_shaped(land))):  # fmt: skip
            row = layout.row()
            row.enabled = bool(has_effect)
            row.prop(self, name)
        for name in ("align", "location", "rotation"):
            layout.prop(self, name)

    def _is_shaped(self, land) -> bool:
        """Return whether the land gets its stack of height operators."""
        return self.shape and bool(land.preset)

    def execute(self, context):
        """Add the object with the chosen land and start its import; remove the object again if `start_import` fails."""
        obj = object_data_add(context, bpy.data.meshes.new("Terrain"), operator=self)
        settings = obj.adaptive_terrain
        settings.enabled = True
        add_default_layers(settings)
        settings.source, settings.seed = self.land, self.seed
        land = built_in_land(settings)  # its `side` is in metres
        size = land.side if self.natural_size or self._is_shaped(land) else self.size
        settings.use_extent, settings.extent = True, (size, size)
        settings.height_scale = size / land.side  # the land keeps its shape
        if self._is_shaped(land):
            bpy.ops.adaptive_terrain.land_preset(filepath=bpy.utils.preset_find(land.preset, PRESETS, ext=".json"))
        if start_import(self, bpy.ops.adaptive_terrain.import_added) == {"CANCELLED"}:
            bpy.data.batch_remove([obj, obj.data])
            return {"CANCELLED"}
        if session.terrains_of(context.scene) == [obj]:
            self._lock_interface(context.scene)
        return {"FINISHED"}

    def _lock_interface(self, scene):
        """Lock a scene's interface during renders, and report it.

        A viewport that draws a mesh while a render rewrites it would crash Blender.
        """
        if not scene.render.use_lock_interface:
            scene.render.use_lock_interface = True
            self.report(
                {"INFO"}, "Switched on Render > Lock Interface: the viewport must not draw while a render updates"
            )


def draw_entry(self, context):
    """Draw the entry for built-in terrains in Blender's *Add* menu."""
    self.layout.operator(AddTerrain.bl_idname, icon="RNDCURVE")
