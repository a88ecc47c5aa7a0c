# SPDX-License-Identifier: GPL-3.0-or-later
"""Object > Adaptive Terrain: every operator that acts on a terrain, where the search (F3) finds it."""

import bpy

# Internal operators need a row of a panel, and have no place in a menu.
OPERATORS = (
    ("import_source", "add_tiles", "join", "pack_store", "render_loaded", "update", "frame", "freeze", "move_world"),
    ("set_up_scene", "terrain_material"),
    ("shape", "shape_and_render", "water_surface", "bake_land", "export_heights", "land_clear"),
    ("bake", "export", "export_tiles", "export_tileset", "map_camera", "render_map", "submit", "bake_maps"),
    (
        "scatter_add",
        "starter_add",
        "drop_to_ground",
        "keep_above_ground",
        "let_go",
        "place_at_coordinates",
        "profile",
        "viewshed",
        "add_collider",
    ),
    ("show_overlay", "measure_accuracy", "sweep_accuracy", "lock_interface"),
)


class ObjectMenu(bpy.types.Menu):
    """Operators that act on a terrain."""

    bl_idname = "ADAPTIVE_TERRAIN_MT_object"
    bl_label = "Adaptive Terrain"

    def draw(self, _context):
        """Draw the operators by groups; each opens its dialog."""
        self.layout.operator_context = "INVOKE_DEFAULT"
        for names in OPERATORS:
            for name in names:
                self.layout.operator(f"adaptive_terrain.{name}")
            self.layout.separator()


def draw_entry(self, _context):
    """Draw the add-on's submenu in Blender's object menu."""
    self.layout.menu(ObjectMenu.bl_idname)
