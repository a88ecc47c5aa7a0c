# SPDX-License-Identifier: GPL-3.0-or-later
"""Program that renders a flight in Cycles: `cycles_frame MODE STORE TIFF PX PICTURE SUN`.

MODE `error` renders our terrain with an error of PX pixels; `mapped` adds a normal map, baked for the camera of the
first frame; `adaptive` renders a plane under Cycles' adaptive subdivision at a dicing rate of PX pixels, displaced by
the TIFF; `grid` renders every sample of the store, one frame only; `bare` renders a flat plane, one frame only, to find
the memory of any render. The first frame is written to PICTURE. SUN is in degrees from the zenith.
"""

import json
import math
import statistics
import sys
import time

import numpy as np

from ...cbt_terrain.field.store import open_store
from ...operators.blender import need_bpy
from ...operators.text.console import quiet
from ..rig import scenes
from ..rig.child import peak_mb
from ..rig.measure import stopwatch
from .cycles import ADAPTIVE, BARE, ERROR, GRID, HIGH, MAPPED
from .in_blender import flight_scene, new_object

RESOLUTION = (960, 540)
RUNS = 9
# Cycles divides a patch at most 4,096 times a side; enough patches keep that from showing.
PATCHES = 16
COARSE_PX = 100.0


def main(mode: str, store: str, tiff: str, px: float, picture: str, sun: float) -> dict:
    """Render all frames; return medians of time and processor time, triangles, and peak memory."""
    bpy = need_bpy("The row same_picture")
    scene, obj = render_scene(mode, store, tiff, px, sun)
    bake_start = time.process_time()
    if mode == MAPPED:
        _shade_by_map(obj.data.materials[0], obj)
    bake_cpu_s = time.process_time() - bake_start
    rendered = []
    bpy.app.handlers.render_post.append(lambda *_: rendered.append(len(obj.data.polygons)))
    times, processor = [], []
    for frame in range(1 if mode in (GRID, BARE) else RUNS + 1):
        scene.frame_set(frame)
        start = time.process_time()
        with quiet(), stopwatch() as elapsed:
            bpy.ops.render.render()
        processor.append(time.process_time() - start)
        times += elapsed
        if frame == 0:
            with quiet():
                bpy.data.images["Render Result"].save_render(picture)
    costs = {"ms": statistics.median(times[1:] or times), "triangles": rendered[0]}
    cpu_s = statistics.median(processor[1:] or processor)
    return costs | {"cpu_s": cpu_s, "peak_mb": peak_mb(), "bake_cpu_s": bake_cpu_s}


def render_scene(mode: str, store: str, tiff: str, px: float, sun: float = HIGH):
    """Return the scene of the flight and the object that it renders."""
    scene = flight_scene(RESOLUTION)
    set_up_render(scene, sun)
    if mode == GRID:
        obj = _grid(store)
    else:
        obj = _terrain(store, px) if mode in (ERROR, MAPPED) else _plane()
    if mode == ADAPTIVE:
        _dice(obj, px)
    material = _material(tiff if mode == ADAPTIVE else None)
    obj.data.materials.append(material)
    return scene, obj


def set_up_render(scene, zenith: float = HIGH) -> None:
    """Set up one sample of direct sunlight on the processor, so that pictures show geometry and no noise."""
    import bpy

    from ...operators.bridge.demand.trees import tree_of_new

    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.max_bounces = "CPU", 1, 0
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("World")
    tree_of_new(scene.world).nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle = 3.0, 0.0
    lamp = bpy.data.objects.new("Sun", sun)
    lamp.rotation_euler = (math.radians(zenith), 0.0, math.radians(-40))
    scene.collection.objects.link(lamp)


def _terrain(store: str, px: float):
    obj = new_object("Terrain")
    settings = obj.adaptive_terrain
    settings.viewport.error_px = COARSE_PX  # for updates outside the render
    settings.render.error_px = px
    settings.render.smooth_transitions = False  # a still
    settings.store, settings.live, settings.enabled = store, False, True
    return obj


def _shade_by_map(material, obj) -> None:
    """Bake the default map of *Bake Maps*, and connect it to the normals of a material's shader."""
    import bpy

    from ...operators.maps.images import map_image, map_vector

    bpy.context.view_layer.objects.active = obj
    with quiet():
        bpy.ops.adaptive_terrain.bake_maps()
    tree = material.node_tree
    texture, normal = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image, texture.extension, normal.space = map_image(obj, "detail_normal"), "EXTEND", "OBJECT"
    tree.links.new(map_vector(tree, obj), texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], normal.inputs["Color"])
    shader = next(node for node in tree.nodes if "Normal" in node.inputs and node.type == "BSDF_DIFFUSE")
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])


def _grid(store: str):
    """Return an object without levels of detail: a vertex for each sample, a smooth quadrilateral for each cell."""
    heights = open_store(store).heights()
    rows, columns = heights.shape
    obj = new_object("Grid")
    mesh = obj.data
    points = np.empty((rows, columns, 3), np.float32)
    points[..., 0] = (np.arange(columns) / (columns - 1) - 0.5) * scenes.SIDE
    points[..., 1] = ((np.arange(rows) / (rows - 1) - 0.5) * scenes.SIDE)[:, None]
    points[..., 2] = heights
    first = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)[:-1, :-1].reshape(-1, 1)
    corners = first + np.array([0, 1, columns + 1, columns], np.int32)
    mesh.vertices.add(rows * columns)
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.add(corners.size)
    mesh.loops.foreach_set("vertex_index", corners.ravel())
    mesh.polygons.add(len(corners))
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    return obj


def _plane():
    """Return a plane of patches whose texture coordinates are at the centres of the samples."""
    import bpy

    mesh, n = bpy.data.meshes.new("Plane"), PATCHES
    line = np.linspace(0.0, 1.0, n + 1)
    points = [((x - 0.5) * scenes.SIDE, (y - 0.5) * scenes.SIDE, 0.0) for y in line for x in line]
    corners = [
        (r * (n + 1) + c, r * (n + 1) + c + 1, (r + 1) * (n + 1) + c + 1, (r + 1) * (n + 1) + c)
        for r in range(n)
        for c in range(n)
    ]
    mesh.from_pydata(points, [], corners)
    mesh.shade_smooth()
    uv = mesh.uv_layers.new(name="UVMap")
    plane = np.array(points)[[corner for face in corners for corner in face], :2] / scenes.SIDE + 0.5
    uv.uv.foreach_set("vector", ((plane * (scenes.SAMPLES - 1) + 0.5) / scenes.SAMPLES).astype(np.float32).ravel())
    obj = bpy.data.objects.new("Plane", mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _dice(obj, px: float) -> None:
    """Add adaptive subdivision to an object."""
    import bpy

    scene = bpy.context.scene
    modifier = obj.modifiers.new("Dicing", "SUBSURF")
    modifier.subdivision_type = "SIMPLE"
    if hasattr(scene.cycles, "feature_set"):  # Blender 5.0 and later need none
        scene.cycles.feature_set = "EXPERIMENTAL"
    scene.cycles.dicing_rate = px
    (modifier if hasattr(modifier, "use_adaptive_subdivision") else obj.cycles).use_adaptive_subdivision = True


def _material(tiff: str | None):
    """Return a grey diffuse material, displaced by the heights of `tiff` in metres if it is given."""
    import bpy

    from ...operators.bridge.demand.trees import tree_of_new

    material = bpy.data.materials.new("Ground")
    tree = tree_of_new(material)
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    output, diffuse = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeBsdfDiffuse")
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    if tiff is not None:
        heights, displacement = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeDisplacement")
        heights.image = bpy.data.images.load(tiff)
        heights.image.colorspace_settings.name = "Non-Color"
        heights.extension = "EXTEND"
        displacement.inputs["Midlevel"].default_value, displacement.inputs["Scale"].default_value = 0.0, 1.0
        links.new(heights.outputs["Color"], displacement.inputs["Height"])
        links.new(displacement.outputs["Displacement"], output.inputs["Displacement"])
        material.displacement_method = "DISPLACEMENT"
    return material


if __name__ == "__main__":
    mode_, store_, tiff_, px_, picture_, sun_ = sys.argv[1:]
    print(json.dumps(main(mode_, store_, tiff_, float(px_), picture_, float(sun_))))
