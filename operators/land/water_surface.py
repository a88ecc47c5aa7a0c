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
from ..bridge.scene_paths import store_path
from ..bridge.writer import write_mesh
from ..job_operator import JobOperator
from ..scatter.dry_ground import follow_sea
from ..scene.haze import join_haze
from ..session import session
from ..session.polls import on_terrain_object
from ..text.numbers import length_text
from ..text.translations import phrase
from .request import land_of
from .shape_land import check_is_shaped
from .water_object import LEVEL, MARK, SEA, existing_water, shown_sea

MATERIAL = "Terrain Water"
SHALLOW, DEEP = (0.10, 0.22, 0.22, 1.0), (0.004, 0.025, 0.05, 1.0)
CLEAR, OPAQUE = 0.25, 0.96  # alpha at the shore, and of deep water
DEEP_METRES = 4.0


class AddWaterSurface(JobOperator, bpy.types.Operator):
    """Add the terrain's lakes, rivers and sea as an object with a water material. Press it again after the land has
    changed"""

    bl_idname = "adaptive_terrain.water_surface"
    bl_label = "Add Water"
    bl_options = {"REGISTER", "UNDO"}

    kind = jobs.WATER
    shows_error_on_panel = False

    level: bpy.props.FloatProperty(
        name="Sea Level",
        description="Height of the sea: all lower ground is under water. At first it is 0 m at a coast; inland it "
        "covers the lowest twentieth of the ground",
        unit="LENGTH", options={"SKIP_SAVE"},
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain in Object Mode without a running job for its water.

        If not, set the reason.
        """
        return on_terrain_object(cls, context) and super().poll(context)

    def invoke(self, context, event):
        """Start the job if the land is shaped as its entries say; otherwise report why it cannot start."""
        try:
            check_is_shaped(context.object, context.evaluated_depsgraph_get())
        except TerrainError as error:
            return self.fail(context.object, str(error))
        return JobOperator.invoke(self, context, event)

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

        result: of `steps`. The level is stored on the object only if the user has chosen it.
        """
        level, surface, sea = result
        water = existing_water(terrain) or _add_water(terrain)
        write_mesh(water.data, _with_vertical_scale(surface, terrain.adaptive_terrain))
        sea_before, is_new = shown_sea(terrain), SEA not in water
        if level is not None:
            water[LEVEL] = level
        elif sea is not None:
            self.level = sea  # the box at the lower left shows it
        if sea is None:
            water.pop(SEA, None)
        else:
            water[SEA] = sea
            follow_sea(terrain, sea_before, is_new)  # keeps the terrain's scatters out of it
        sea_text = "" if sea is None else f", its sea at {length_text(sea)}"
        self.report({"INFO"}, f"{water.name} has {len(surface.triangles):,} triangles{sea_text}")


def _water_mesh(
    name: str, store: str, land: Land | None, anchor: tuple[float, float], level: float | None
) -> tuple[Surface, float | None]:
    """Return the water of a terrain, and the level of its sea, None for depths of the stack. For any thread.

    name, anchor: the terrain's. store, land: its heights. level: the sea's height in metres; None for the depths that
    operators of the stack have left, or if there are none for a level that shows water. Raises TerrainError.
    """
    from ...cbt_terrain.height_operators.water_surface import default_sea, water_of

    field = anchored(raster_of(store, land, session.open_field, verified=True), *anchor)
    if level is None and DEPTH.name not in field.layers:
        level = default_sea(field)
    surface = water_of(field, launch.default_threads(), level)
    if not len(surface.triangles):
        raise TerrainError(f"There is no water on {name!r}", expected="a lake, a sea or a stream of 0.016 m³/s or more")
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
    """Create an object for the water of a terrain, parented to it, with a water material."""
    name = f"{terrain.name} Water"
    water = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    water[MARK] = True
    water.parent = terrain
    water.data.materials.append(bpy.data.materials.get(MATERIAL) or new_water_material())
    for collection in terrain.users_collection:
        collection.objects.link(water)
    return water


def new_water_material() -> bpy.types.Material:
    """Create a smooth material, clear at the shore and dark where the water is deep.

    It reads the attribute `water_depth`, and gets the haze of the file's other materials.
    """
    material = bpy.data.materials.new(MATERIAL)
    material.diffuse_color = SHALLOW  # in viewports that show no materials
    tree = tree_of_new(material)
    nodes, links = tree.nodes, tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.06, 1.333
    depth = nodes.new("ShaderNodeAttribute")
    depth.attribute_name, depth.location = "water_depth", (-700, 200)
    for k, (low, high, socket) in enumerate(((SHALLOW, DEEP, "Base Color"), (CLEAR, OPAQUE, "Alpha"))):
        values = (low, high) if k == 0 else [(a, a, a, 1.0) for a in (low, high)]
        ramp = nodes.new("ShaderNodeValToRGB")
        ramp.location = (-300, 300 - 250 * k)
        for element, colour in zip(ramp.color_ramp.elements, values, strict=True):
            element.color = colour
        fraction = nodes.new("ShaderNodeMath")  # of DEEP_METRES
        fraction.operation, fraction.location = "DIVIDE", (-500, 300 - 250 * k)
        fraction.inputs[1].default_value = DEEP_METRES
        links.new(depth.outputs["Fac"], fraction.inputs[0])
        links.new(fraction.outputs[0], ramp.inputs["Fac"])
        links.new(ramp.outputs["Color"], shader.inputs[socket])
    join_haze(material)
    return material
