# SPDX-License-Identifier: GPL-3.0-or-later
"""The button *Set Up Scene*."""

import math

import bpy
from mathutils import Vector

from ..export.map_camera import leave_map
from ..importing.imported import imported_of
from ..layers.material import give_terrain_material, has_layers_group, has_no_material
from ..layers.operators import PRESET_PANEL, PRESETS
from ..layers.properties import has_default_layers
from ..layers.terrain_material import material_sources
from ..session.polls import cancelled_by_errors, on_terrain_object
from ..terrain import frame_terrain, sight
from . import built, daylight, defaults, viewpoint
from .built import find_built, remember_built, was_set_up
from .haze import set_haze

CURRENT, ACROSS = "CURRENT", "ACROSS"
CAMERA = "Terrain Camera"
LOOK = "AgX - Medium High Contrast"
# Layer presets that suit the built-in lands, and files whose highest ground is too low for snow.
LAYERS = {"mountains": "alpine", "dunes": "dunes", "canyon": "desert", "island": "island", "archipelago": "island"}
SNOWLESS, SNOWLESS_M = "hills", 1500.0
UNSHAPED = ". The view was composed for the unshaped land"


class SetUpScene(bpy.types.Operator):
    """Add a sun, a sky, a camera at the current view and the terrain's material, and remove Blender's default cube and
    light. Press it again to replace them; nothing else changes"""

    bl_idname = "adaptive_terrain.set_up_scene"
    bl_label = "Set Up Scene"
    bl_options = {"REGISTER", "UNDO"}

    view: bpy.props.EnumProperty(
        name="Camera", description="Where the camera is put",
        items=[(CURRENT, "Current View", "Put the camera where the viewport looks from"),
               (ACROSS, "Across the Terrain", "Put the camera where the picture is varied near and far, a summit "
                "stands in its upper third, and little of it is in shade or beyond the terrain's border")],
        options={"SKIP_SAVE"},
    )  # fmt: skip
    elevation: bpy.props.FloatProperty(
        name="Sun Elevation",
        description="Angle of the sun above the horizon: low gives long shadows",
        default=daylight.ELEVATION, min=math.radians(1.0), max=math.radians(90.0), subtype="ANGLE",
    )  # fmt: skip
    turn: bpy.props.FloatProperty(
        name="Sun From",
        description="Direction of the sun, clockwise from the direction in which the camera looks: 90° is from the "
        "right, 180° from behind",
        default=daylight.TURN, soft_min=-math.pi, soft_max=math.pi, subtype="ANGLE",
    )  # fmt: skip

    haze: bpy.props.FloatProperty(
        name="Haze",
        description="Part of the light that haze takes from ground as far away as the terrain is long. It is in the "
        "terrain's own material, and in water and plants of the extension",
        default=0.4, min=0.0, max=0.95, subtype="FACTOR",
    )  # fmt: skip

    # Matrix to the world and lens in mm of the viewport before it showed the camera: a changed option of the box runs
    # the operator again.
    viewed: tuple | None = None

    @classmethod
    def poll(cls, context):
        """Return whether the active terrain has a store; otherwise set the reason that Blender shows."""
        if not on_terrain_object(cls, context):
            return False
        cls.poll_message_set("Import a height map first")
        return bool(context.object.adaptive_terrain.store)

    def invoke(self, context, _event):
        """Choose the view across the terrain while the viewport has not been turned since Blender's start."""
        viewport = viewpoint.viewport_of(context)
        if (
            not self.properties.is_property_set("view")
            and viewport is not None
            and defaults.is_default_view(viewport[-1])
        ):
            self.view = ACROSS
        return self.execute(context)

    @cancelled_by_errors
    def execute(self, context):
        """Add or update camera, sun, sky, layers and haze for the active terrain; remove Blender's default objects."""
        scene, obj = context.scene, context.object
        sight.box_of(obj)  # raises an error before anything changes
        for default in defaults.untouched(scene):
            _remove(default)
        is_first, sun = not was_set_up(scene), find_built(scene, built.SUN)
        if sun is not None and len(sun.users_scene) <= 1:
            _remove(sun)
        camera, note = self._place_camera(context, obj)
        ahead = camera.matrix_world.to_3x3() @ Vector((0.0, 0.0, -1.0))
        # towards: unit vector to the sun. A new sun is `turn` away from the camera's direction; a user's stays.
        towards = _light(scene, self.elevation, math.atan2(ahead.x, ahead.y) + self.turn)
        if has_no_material(obj):
            _choose_layers(obj)
            give_terrain_material(obj, material_sources(obj, ()))
        elif has_layers_group(obj):
            give_terrain_material(obj, material_sources(obj, ()))
        set_haze(obj, self.haze, daylight.haze_color(max(math.asin(max(-1.0, min(1.0, towards.z))), 0.0)))
        if is_first:
            _choose_look(scene)
        scene.render.use_lock_interface = True  # a viewport that draws while a render rewrites the mesh would crash
        self.report({"INFO"}, f"Sun, sky and {camera.name} are set up: press F12 to render{note}")
        return {"FINISHED"}

    def _place_camera(self, context, obj):
        """Return the scene's camera at the chosen view, with a clip range for the terrain, and a note for the report.

        It is the camera of an earlier click, the unchanged one of the start-up file, or a new one, and the viewport
        looks through it. A camera of the user through which the viewport looks stays as it is, except for a clip range
        that ends too early.
        """
        scene, viewport = context.scene, viewpoint.viewport_of(context)
        through_camera = viewport is not None and viewport[-1].view_perspective == "CAMERA"
        built_camera = find_built(scene, built.CAMERA)
        if built_camera is not None and scene.objects.get(built_camera.name) != built_camera:
            built_camera = None  # deleted by the user
        current = scene.camera
        if viewport is not None and not through_camera:
            _, area, _, region_3d = viewport
            self.viewed = region_3d.view_matrix.inverted(), viewpoint.lens_of(area.spaces.active)
        is_users = current is not None and not defaults.is_default_camera(current)
        # Where no viewport is open, a script may ask for the current view by name: that of the scene's camera.
        is_camera_view = through_camera or viewport is None and self.properties.is_property_set("view")
        if self.view == CURRENT and is_camera_view and is_users and self.viewed is None:
            frame_terrain.widen_camera(obj, context.evaluated_depsgraph_get(), sight.box_of(obj))
            return current, ""
        if built_camera is None:
            built_camera = current if defaults.is_default_camera(current) else _add_camera(scene)
            remember_built(scene, built.CAMERA, built_camera)
        built_camera.data.lens, note = viewpoint.LENS_MM, ""
        if self.view == CURRENT and self.viewed is not None:
            to_world, built_camera.data.lens = self.viewed
        else:
            to_world, distance, is_final = viewpoint.view_across(obj, context.evaluated_depsgraph_get())
            note = "" if is_final else UNSHAPED
            if viewport is not None:
                viewpoint.look_from(viewport[-1], to_world, distance)
        built_camera.matrix_world = to_world
        built_camera.data.clip_start, built_camera.data.clip_end = viewpoint.clip_range(obj, to_world.translation)
        leave_map(scene)  # a map camera has changed the size of the picture
        scene.camera = built_camera
        if viewport is not None:
            viewpoint.look_through_camera(*viewport)
        return built_camera, note


def _add_camera(scene):
    """Add a camera to a scene and return it."""
    camera = bpy.data.objects.new(CAMERA, bpy.data.cameras.new(CAMERA))
    scene.collection.objects.link(camera)
    return camera


def _light(scene, elevation: float, azimuth: float) -> Vector:
    """Light a scene by a sun and the sky around it, and return the unit vector towards the sun.

    elevation, azimuth: of a new sun in radians, the azimuth clockwise from +Y. A sun lamp of the user stays as it is,
    and the sky follows it. The sky of an earlier click is replaced; a world of the user remains in the file.
    """
    suns = [item for item in scene.objects if item.type == "LIGHT" and item.data.type == "SUN"]
    sun = suns[0] if suns else daylight.add_sun(scene, elevation, azimuth)
    before, scene.world = scene.world, None  # so that a world of this scene alone has no user left
    if before is not None and before == find_built(scene, built.SKY):
        remember_built(scene, built.SKY, None)
        if before.users == 0:
            bpy.data.worlds.remove(before)
    elif not defaults.is_default_world(before):
        before.use_fake_user = True  # else the file would lose it
    towards = sun.matrix_world.col[2].xyz.normalized()
    daylight.add_sky(scene, towards)
    return towards


def _choose_layers(obj) -> None:
    """Give a terrain that has only default layers, or none, those that suit it.

    They are a preset for its built-in land, or one without snow if it is lower than SNOWLESS_M; otherwise nothing
    changes.
    """
    settings, imported = obj.adaptive_terrain, imported_of(obj.adaptive_terrain)
    if imported is None or settings.layers and not has_default_layers(settings):
        return
    is_low = imported.heights_m[1] < SNOWLESS_M
    if preset := LAYERS.get(imported.settings.get("source", ""), SNOWLESS if is_low else ""):
        bpy.ops.script.execute_preset(filepath=bpy.utils.preset_find(preset, PRESETS), menu_idname=PRESET_PANEL)


def _choose_look(scene) -> None:
    """Give the view transform AgX more contrast, unless the user has chosen a look."""
    view = scene.view_settings
    if view.view_transform == "AgX" and view.look == "None":
        view.look = LOOK


def _remove(obj) -> None:
    """Remove an object, and its data unless others use it."""
    data = obj.data
    bpy.data.objects.remove(obj)
    if data.users == 0:
        bpy.data.batch_remove([data])
