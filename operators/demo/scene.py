# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's Blender scene: an island in low sun, a camera in flight, and drawings of the levels of detail."""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.run.owned_files import remove_file
from ...cbt_terrain.run.partial_files import written_beside
from ...cbt_terrain.view.linear import inverse
from ..bridge.demand.trees import tree_of_new
from ..bridge.nodes import first_node
from ..export.blend_files import open_empty_file
from ..layers.material import give_terrain_material
from ..layers.terrain_material import material_sources
from ..maps.properties import SHOT
from ..session import session
from ..terrain.properties import CHOSEN_CAMERA
from ..terrain.request import RENDER
from ..text.console import quiet
from . import ground
from .materials import (
    SKY_STRENGTH,
    ZENITH,
    LandNodes,
    level_material,
    plain_material,
    put_grain,
    put_haze,
    water_material,
)
from .water import add_rivers, add_sea

PAPER = (0.93, 0.925, 0.90, 1.0)
SUN_ELEVATION_DEG, SUN_AZIMUTH_DEG = 21.0, 182.0  # the azimuth is counted from the east northwards
# Frequency of clouds to the east, north and up.
CLOUDS = (0.35, 0.9, 0.0)
SAMPLES = 4
MAPS, MAPS_MB = ("detail_normal", "sky", "color"), 96.0


def build(out: Path, store: Path, flight, frames: range, resolution: tuple[int, int], criterion):
    """Build the scene with the terrain of `store` and a camera that follows `flight`, and save `out`/island.blend.

    It begins with an empty file, which takes the place of the open one. flight: a CameraPath. frames: those of
    the shot. resolution: pixels. criterion: of the terrain's detail. Returns the scene and the terrain's object.
    """
    open_empty_file()
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames[0], frames[-1]
    scene.render.use_lock_interface = True
    scene.camera = _add_camera(scene, flight, frames)
    add_sky(scene)
    set_up_render(scene, resolution)
    obj = bpy.data.objects.new("Island", bpy.data.meshes.new("Island"))
    scene.collection.objects.link(obj)
    settings = obj.adaptive_terrain
    settings.enabled, settings.store = True, str(store.resolve())
    for detail in (settings.render, settings.viewport):
        # morph: ratio of errors at which a vertex has its final height; 1 without geomorph
        detail.error_px, detail.smooth_transitions = criterion.error_px, criterion.morph > 1.0
    scene.frame_set(frames[0])
    session.update_object(obj, bpy.context.evaluated_depsgraph_get(), RENDER)
    ground.set_layers(settings)
    bake_island_maps(obj)
    material = give_terrain_material(obj, material_sources(obj, ()))  # (): no light but that of the maps
    put_grain(material)
    put_haze(material, sun_direction())
    field, water = open_store(store), water_material(sun_direction())
    add_sea(scene, field, water)
    add_rivers(scene, field, water)
    file = str((out / "island.blend").resolve())
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=file, compress=True)  # a relative path needs a file that it begins at
        settings.store = bpy.path.relpath(str(store.resolve()))  # users may move the whole folder
        bpy.ops.wm.save_as_mainfile(filepath=file, compress=True)
    remove_file(file + "1", may_be_link=True)  # Blender's backup of the first save
    return scene, obj


def bake_island_maps(obj) -> None:
    """Bake maps of normals, colours and sky visibility, as fine as the shot's frames show them."""
    bpy.context.view_layer.objects.active = obj
    maps = obj.adaptive_terrain.maps
    maps.frames, maps.chosen = SHOT, set(MAPS)
    maps.use_budget, maps.budget_mb = True, MAPS_MB
    with quiet():
        bpy.ops.adaptive_terrain.bake_maps()


def _add_camera(scene, flight, frames: range):
    """Add a camera with a key at each of the frames of a CameraPath; return it."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.data.clip_start, camera.data.clip_end = flight.clip
    camera.rotation_mode = "QUATERNION"
    for frame in frames:
        view = flight.view(frame, (1, 1))  # a square, whose angle is that of any picture's larger side
        matrix = Matrix(inverse(view.world_to_camera).tolist())
        camera.location, camera.rotation_quaternion = matrix.to_translation(), matrix.to_quaternion()
        camera.data.angle = 2 * math.atan(1 / view.projection[0, 0])
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_quaternion", frame=frame)
        camera.data.keyframe_insert("lens", frame=frame)
    return camera


def sun_direction():
    """Return the unit vector towards the sun."""
    turn = Matrix.Rotation(math.radians(SUN_AZIMUTH_DEG), 3, "Z") @ Matrix.Rotation(
        math.radians(-SUN_ELEVATION_DEG), 3, "Y"
    )
    return turn.col[0]


def add_sky(scene) -> None:
    """Add a low sun, and a new world with a sky from the horizon to the zenith and with clouds."""
    world = bpy.data.worlds.new("Sky")
    scene.world = world
    world.cycles.sampling_method = "NONE"  # it is smooth and needs no importance map
    tree = tree_of_new(world)
    tree.nodes.clear()
    n = LandNodes(tree)
    direction = n.add("ShaderNodeTexCoord").outputs["Generated"]
    up = n.math("MAXIMUM", n.add("ShaderNodeSeparateXYZ", {0: direction}).outputs["Z"], 0.0)
    sky = n.mix(n.math("POWER", up, 0.5), n.horizon(direction, sun_direction()), ZENITH)
    # High thin clouds: each direction's point on a plane above the camera; 0.12 keeps it finite at the horizon.
    high = n.vector("DIVIDE", direction, n.math("ADD", up, 0.12))
    inputs = {
        "Vector": n.vector("MULTIPLY", high, CLOUDS),
        "Scale": 1.0,
        "Detail": 6.0,
        "Roughness": 0.6,
        "Distortion": 0.5,
    }
    cloud = n.math("MULTIPLY", n.smooth(n.add("ShaderNodeTexNoise", inputs).outputs[0], 0.46, 0.8), 0.55)
    low_to_high = n.smooth(up, 0.0, 0.25)  # a smooth step from 0 to 1: no clouds at the horizon
    sky = n.mix(n.math("MULTIPLY", cloud, low_to_high), sky, (1.0, 0.95, 0.9, 1.0))
    background = n.add("ShaderNodeBackground", {"Color": sky, "Strength": SKY_STRENGTH}).outputs[0]
    n.add("ShaderNodeOutputWorld", {"Surface": background})
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy, light.angle, light.color = 6.5, math.radians(0.6), (1.0, 0.81, 0.58)
    sun = bpy.data.objects.new("Sun", light)
    sun.matrix_world = sun_direction().to_track_quat("Z", "Y").to_matrix().to_4x4()
    scene.collection.objects.link(sun)


def set_up_render(scene, resolution: tuple[int, int]) -> None:
    """Set up Cycles on the CPU with few samples, a denoiser and high contrast."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.render.resolution_percentage = 100
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = True
    scene.cycles.denoising_prefilter = "NONE"  # else it blurs the grain
    if hasattr(scene.cycles, "denoising_quality"):
        scene.cycles.denoising_quality = "BALANCED"
    scene.cycles.max_bounces = 1
    scene.cycles.diffuse_bounces = 1
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.exposure = 0.6
    scene.view_settings.look = "AgX - High Contrast"


def render(scene, path: Path) -> None:
    """Render the current frame to a PNG file; the handlers update the terrain, as in any render."""
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode = "PNG", "RGB"
    with written_beside(path.resolve()) as partial, quiet():
        scene.render.filepath = str(partial)
        bpy.ops.render.render(write_still=True)


def draw_levels(out: Path, scene, obj, frame: int, error_px: float, plan_resolution: tuple[int, int]) -> int:
    """Draw one frame's triangles by level: `levels.png` from the camera, `plan.png` from above with its view.

    An error of `error_px` pixels makes single triangles visible. Returns their number. The scene, its materials and
    its camera stay changed, and are not saved. plan_resolution: pixels of `plan.png`.
    """
    scene.frame_set(frame)
    camera, settings = scene.camera, obj.adaptive_terrain
    settings.render.error_px = error_px
    settings.camera_source, settings.camera = CHOSEN_CAMERA, camera
    update = session.update_object(obj, bpy.context.evaluated_depsgraph_get(), RENDER)
    coarsest, finest = np.percentile(update.surface.level, (1, 99))  # without a few extreme triangles
    obj.data.materials.clear()
    obj.data.materials.append(level_material(coarsest, finest, sun_direction()))
    for name in {"Sea", "Water"} & set(scene.objects.keys()):
        scene.objects[name].hide_render = True
    scene.world = bpy.data.worlds.new("Paper")
    first_node(tree_of_new(scene.world), "ShaderNodeBackground").inputs["Color"].default_value = PAPER
    scene.cycles.use_denoising = False
    scene.cycles.samples, scene.cycles.max_bounces = 12, 0
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.view_settings.exposure = 0.0
    render(scene, out / "levels.png")
    _look_from_above(scene, obj, camera, plan_resolution)
    render(scene, out / "plan.png")
    return update.triangles


def _look_from_above(scene, obj, camera, resolution: tuple[int, int]) -> None:
    """Add an orthographic camera over the whole terrain and make it the scene's, with a picture of `resolution` pixels.

    Two strips over the terrain, from the eye along the sides of the picture, show the view of `camera`.
    """
    side, top = max(obj.dimensions.x, obj.dimensions.y), obj.dimensions.z + 5000.0
    above = bpy.data.objects.new("Above", bpy.data.cameras.new("Above"))
    above.data.type, above.data.ortho_scale, above.data.clip_end = "ORTHO", 1.02 * side, 2 * top
    above.location = 0.0, 0.0, top
    scene.collection.objects.link(above)
    wedge = bpy.data.meshes.new("Wedge")
    eye, spread = camera.matrix_world.translation, camera.data.angle / 2
    ahead = camera.matrix_world.to_quaternion() @ Vector((0.0, 0.0, -1.0))
    heading, half_width = math.atan2(ahead.y, ahead.x), 0.0022 * side
    corners, faces = [], []
    for turn in (-spread, spread):
        along = Vector((math.cos(heading + turn), math.sin(heading + turn), 0.0))
        across = Vector((-along.y, along.x, 0.0)) * half_width
        near = Vector((eye.x, eye.y, top / 2))  # between terrain and camera
        far = near + along * 2 * side
        faces.append(tuple(range(len(corners), len(corners) + 4)))
        corners += [near - across, far - across, far + across, near + across]
    wedge.from_pydata([tuple(c) for c in corners], [], faces)
    wedge.materials.append(plain_material("Wedge", (0.80, 0.10, 0.03, 1.0)))
    scene.collection.objects.link(bpy.data.objects.new("Wedge", wedge))
    scene.camera = above
    scene.render.resolution_x, scene.render.resolution_y = resolution
