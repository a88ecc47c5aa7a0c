# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop a file into the viewport of a factory scene, set up the scene, select the camera: FOLDER, with dem.png."""

import bpy
from mathutils import Quaternion
from window_steps import folder, module, parts, picture, run, take_steps, terrain, until

is_default_view = module("operators.scene.defaults").is_default_view
follows_viewport = module("operators.terrain.camera_source").follows_viewport
result = {}


def names():
    return sorted(bpy.context.scene.objects.keys())


def note_camera(view):
    """Note the view of the viewport, the sun's height and how far the camera is from a matrix, in terrains."""
    result["looks"].append(parts()[1].spaces.active.region_3d.view_perspective)
    apart = (bpy.context.scene.camera.matrix_world - view).transposed()
    result["camera_off"].append(max(column.length for column in apart) / terrain().dimensions.x)
    result["sun"].append(bpy.data.objects["Terrain Sun"].matrix_world.col[2].z)


def steps():
    yield 2.0
    run(bpy.ops.mesh.adaptive_terrain_from_file, "INVOKE_DEFAULT", filepath=str(folder / "dem.png"))
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0)
    yield from until(lambda: parts()[2].active_panel_category == "Terrain")
    yield 2.0
    result["before"] = names()
    result["triangles"] = len(terrain().data.polygons)
    result["followed"] = [follows_viewport(terrain(), bpy.context.scene)]
    region_3d = parts()[1].spaces.active.region_3d
    result["unturned"] = is_default_view(region_3d)
    run(bpy.ops.ed.undo_push, message="Terrain from File")  # an operator that a script runs leaves no step
    result["looks"], result["camera_off"], result["sun"] = [], [], []
    for elevation in (0.5, 1.0):  # two clicks, and after each another angle in the box at the lower left
        region_3d.view_perspective = "PERSP"
        region_3d.view_rotation = region_3d.view_rotation @ Quaternion((0.0, 0.0, 1.0), 0.1)
        yield 1.0
        view = region_3d.view_matrix.inverted()
        run(bpy.ops.adaptive_terrain.set_up_scene, "INVOKE_DEFAULT", True, elevation=0.3)  # True: a step for Undo
        note_camera(view)
        yield 1.0
        bpy.context.window_manager.operators[-1].elevation = elevation
        run(bpy.ops.ed.undo_redo, True)
        yield 1.0
        note_camera(view)
    result["after"] = names()
    result["followed"].append(follows_viewport(terrain(), bpy.context.scene))
    scene = bpy.context.scene  # EEVEE would compile its shaders, for most of a minute
    scene.render.engine, scene.cycles.preview_samples, scene.cycles.use_preview_denoising = "CYCLES", 1, False
    parts()[1].spaces.active.shading.type = "RENDERED"
    bpy.context.view_layer.objects.active = scene.camera
    yield 4.0
    yield from picture("set_up")
    parts()[1].spaces.active.shading.type = "SOLID"
    for _click in range(2):
        with bpy.context.temp_override(window=parts()[0]):
            bpy.ops.ed.undo()
        yield 1.0
        result["looks"].append(region_3d.view_perspective)
    result["undone"] = names()
    result["followed"].append(follows_viewport(terrain(), bpy.context.scene))


take_steps(steps(), result)
