# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrain from File: in File > Import, Add > Mesh, and by a file dropped into a viewport."""

import bpy

from ...cbt_terrain.rasters.source_formats import FORMATS
from ..layers.properties import add_default_layers
from ..session.polls import ObjectModeOperator
from .add_tiles import ChosenFiles, name_of
from .import_terrain import start_import

SUFFIXES = ";".join(FORMATS)
LABEL = "Terrain from File"


class AddTerrainFromFile(ChosenFiles, ObjectModeOperator, bpy.types.Operator):
    """Add a terrain, and import a height map, several files or a folder of them into it"""

    bl_idname = "mesh.adaptive_terrain_from_file"
    bl_label = LABEL
    bl_options = {"REGISTER", "UNDO"}

    use_heights: bpy.props.BoolProperty(
        name="Set Heights",
        description="Enter the heights of the lowest and the highest value. Otherwise an 8 or 16-bit image without a "
        "size in metres gets a relief of a quarter of its width",
    )
    lowest: bpy.props.FloatProperty(
        name="Lowest", description="Height of the lowest value in the file, in metres", unit="LENGTH"
    )
    highest: bpy.props.FloatProperty(
        name="Highest", description="Height of the highest value in the file, in metres", default=1000.0, unit="LENGTH"
    )

    def draw(self, _context):
        """Draw the options of the file browser: rules for the files, and the range of heights."""
        self.draw_rules()
        self.layout.use_property_split = True
        self.layout.prop(self, "use_heights")
        column = self.layout.column()
        column.active = self.use_heights
        column.prop(self, "lowest")
        column.prop(self, "highest")

    def execute(self, context):
        """Add a terrain object for the files and start its import; remove the object again if `start_import` fails."""
        paths = self.chosen()
        if not paths[0]:
            self.report({"ERROR"}, "No file is chosen: choose a height map")
            return {"CANCELLED"}
        name = name_of(paths)
        obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        context.collection.objects.link(obj)
        for other in context.selected_objects:
            other.select_set(False)
        context.view_layer.objects.active = obj
        obj.select_set(True)
        settings = obj.adaptive_terrain
        settings.enabled, settings.source, settings.source_path = True, "FILE", paths[0]
        for path in paths[1:]:
            settings.more_sources.add().path = path
        add_default_layers(settings)
        if self.use_heights:
            settings.use_heights, settings.lowest, settings.highest = True, self.lowest, self.highest
        context.scene.render.use_lock_interface = True  # a viewport that draws while a render rewrites it would crash
        result = start_import(self, bpy.ops.adaptive_terrain.import_added)
        if result == {"CANCELLED"}:
            bpy.data.batch_remove([obj, obj.data])
        return result


def draw_import_entry(self, _context):
    """Draw the entry of the add-on in Blender's *File > Import* menu."""
    self.layout.operator(AddTerrainFromFile.bl_idname, text="Terrain (.tif, .hgt, .asc, .png, .exr, .r16)")


def draw_add_entry(self, _context):
    """Draw the entry for terrains from files in Blender's *Add* menu."""
    self.layout.operator(AddTerrainFromFile.bl_idname, icon="FILE_IMAGE")


class HeightMapDropped(bpy.types.FileHandler):
    """Height maps that are dragged into a 3D viewport"""

    bl_idname = "ADAPTIVE_TERRAIN_FH_height_map"
    bl_label = LABEL
    bl_import_operator = AddTerrainFromFile.bl_idname
    bl_file_extensions = SUFFIXES

    @classmethod
    def poll_drop(cls, context):
        """Return whether files may be dropped here: in a 3D viewport in object mode."""
        return context.area is not None and context.area.type == "VIEW_3D" and context.mode == "OBJECT"
