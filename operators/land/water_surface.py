# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Water: lakes, rivers and the sea of a terrain as a separate object, with depth and speed."""

from dataclasses import replace

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import anchored
from ...cbt_terrain.height_operators import prepare
from ...cbt_terrain.height_operators.derived_store import Land, raster_of
from ...cbt_terrain.height_operators.stack import Entry, Stack
from ...cbt_terrain.height_operators.water import DEPTH, WATER
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch
from .. import jobs
from ..bridge.demand.trees import tree_of_new
from ..bridge.evaluated import anchor_of
from ..bridge.nodes import Nodes, first_node
from ..bridge.scene_paths import store_path
from ..bridge.writer import new_child, write_mesh
from ..scene.haze import join_haze
from ..session import session
from ..text.numbers import length_text
from ..text.translations import phrase
from .request import land_of
from .shape_land import ShapedLandJob
from .water_object import LEVEL, MARK, existing_water

MATERIAL = "Terrain Water"
SHALLOW, DEEP = (0.05, 0.135, 0.12, 1.0), (0.004, 0.025, 0.05, 1.0)
CLEAR, OPAQUE = 0.25, 0.96  # alpha at the shore, and of deep water
DEEP_METRES = 4.0


class AddWaterSurface(ShapedLandJob, bpy.types.Operator):
    """Add the terrain's lakes, rivers and sea as an object with a water material. Press it again after the land has
    changed"""

    bl_idname = "adaptive_terrain.water_surface"
    bl_label = "Add Water"
    bl_options = {"REGISTER", "UNDO"}

    kind = jobs.WATER

    level: bpy.props.FloatProperty(
        name="Sea Level",
        description="Height of the sea: all lower ground is under water. At first it is 0 m at a coast; inland it "
        "covers the lowest twentieth of the ground",
        unit="LENGTH", options={"SKIP_SAVE"},
    )  # fmt: skip

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Compute the water on a thread; return the chosen sea level, None without one, and `_water_mesh`'s result.

        The level is this operator's, or else the one that an earlier run stored on the water object.
        """
        terrain, depsgraph = context.object, context.evaluated_depsgraph_get()
        water = existing_water(terrain)
        level = self.level if self.properties.is_property_set("level") else water and water.get(LEVEL)
        store, land = store_path(terrain), land_of(terrain, terrain.evaluated_get(depsgraph), depsgraph, waits=True)
        # The height operator Water computes the surface.
        yield from jobs.prepare_kernels(job, prepare.kernels_of(Stack((Entry(WATER.name),))))
        job.progress(0.0)
        name, anchor = terrain.name, anchor_of(terrain)  # read here: the thread must not read Blender's data
        return level, *(yield from jobs.run_on_thread(job, lambda: _water_mesh(name, store, land, anchor, level)))

    def finish(self, _context, terrain, result: tuple[float | None, Surface, float | None]) -> None:
        """Create or update the water object, a child of the terrain, and report its size and sea level.

        result: the sea level that the user has chosen (None without one), the water's mesh, and the height of its sea
        (None without a sea). Only a chosen level is stored on the object.
        """
        level, surface, sea = result
        water = existing_water(terrain) or _add_water(terrain)
        write_mesh(water.data, _with_vertical_scale(surface, terrain.adaptive_terrain))
        if level is not None:
            water[LEVEL] = level
        elif sea is not None:
            self.level = sea  # the box at the lower left shows it
        sea_text = "" if sea is None else f", its sea at {length_text(sea)}"
        self.report({"INFO"}, f"{water.name} has {len(surface.triangles):,} triangles{sea_text}")


def _water_mesh(
    name: str, store: str, land: Land | None, anchor: tuple[float, float], level: float | None
) -> tuple[Surface, float | None]:
    """Return the water of a terrain, and the level of its sea, None for depths of the stack. For any thread.

    name, anchor: the terrain's. store, land: its heights. level: the sea's height in metres. With None the water has
    the depths that operators of the stack have left; without such depths a level is chosen that shows water. Raises
    TerrainError.
    """
    from ...cbt_terrain.height_operators.water_surface import default_sea, water_of

    field = anchored(raster_of(store, land, session.open_field, verified=True), *anchor)
    if level is None and DEPTH.name not in field.layers:
        level = default_sea(field)
    surface = water_of(field, launch.default_threads(), level)
    if not len(surface.triangles):
        smallest = "a lake or a sea of nine samples or more, or a stream of 0.016 m³/s or more"
        raise TerrainError(f"There is no water on {name!r}", expected=smallest)
    return surface, level


def _with_vertical_scale(surface: Surface, settings) -> Surface:
    """Return a surface with the vertical scale and offset of the terrain applied."""
    positions = surface.positions * np.float32([1.0, 1.0, settings.vertical_scale])
    positions[:, 2] += np.float32(settings.vertical_offset)
    return replace(surface, positions=positions)


def draw_button(layout, terrain) -> None:
    """Draw the button, or the progress of its job in the same row."""
    text = phrase("Add Water") if existing_water(terrain) is None else phrase("Update Water")
    jobs.draw_button(layout, jobs.WATER, terrain, AddWaterSurface.bl_idname, text=text, icon="MOD_OCEAN")


def _add_water(terrain):
    """Create an object for the water of a terrain, with a water material."""
    water = new_child(terrain, f"{terrain.name} Water")
    water[MARK] = True
    water.data.materials.append(bpy.data.materials.get(MATERIAL) or new_water_material())
    return water


def new_water_material() -> bpy.types.Material:
    """Create a smooth material, clear at the shore and dark where the water is deep.

    It reads the attribute `water_depth`, and gets the haze of the file's other materials.
    """
    material = bpy.data.materials.new(MATERIAL)
    material.diffuse_color = SHALLOW  # in viewports that show no materials
    tree = tree_of_new(material)
    nodes, shader = Nodes(tree), first_node(tree, "ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.06, 1.333
    depth = nodes.add("ShaderNodeAttribute", attribute_name="water_depth", location=(-700, 200)).outputs["Fac"]
    alphas = [(alpha, alpha, alpha, 1.0) for alpha in (CLEAR, OPAQUE)]
    for socket, values, y in (("Base Color", (SHALLOW, DEEP), 300), ("Alpha", alphas, 50)):
        fraction = nodes.add("ShaderNodeMath", {0: depth, 1: DEEP_METRES}, operation="DIVIDE", location=(-500, y))
        ramp = nodes.add("ShaderNodeValToRGB", {"Fac": fraction.outputs[0]}, location=(-300, y))
        for element, colour in zip(ramp.color_ramp.elements, values, strict=True):
            element.color = colour
        tree.links.new(ramp.outputs["Color"], shader.inputs[socket])
    join_haze(material)
    return material
