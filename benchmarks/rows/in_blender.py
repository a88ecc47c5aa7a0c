# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows with Blender: arrays to an evaluated mesh, and a whole frame from the camera that moves to the mesh."""

import math
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from ...cbt_terrain.ask.view import View
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import Draft
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.baselines import PLAIN, evaluated_triangles, plain_ingest
from ..rig.measure import RUNS, SHORT_BLOCKS, Row, alternate, stopwatch

MILLION = 1_000_000
FRAME_SIZES = (50_000, 250_000, MILLION)
RESOLUTION = (1920, 1080)
LENS_MM, SENSOR_MM = 36.0, 36.0
FRAMES = SHORT_BLOCKS * RUNS + 1


def keep(field: HeightField, folder: Path) -> Path:
    """Write a field in memory into a store, which Blender's side opens by its path."""
    draft = Draft(folder)
    for name in ("samples", "error", "ranges"):
        array = getattr(field, name)
        draft.allocate(name, array.shape, array.dtype)[:] = array
    draft.publish(field, "benchmark", {})
    return folder


def ingest_row(rough: HeightField) -> Row:
    timed = alternate(*writers(rough, MILLION))
    first_ms = timed.first_ms["total"]
    return Row("ingest", MILLION, timed.ms["total"], PLAIN, timed.baseline_ms, first_ms=first_ms, steps=timed.ms)


def frame_row(rough: HeightField, store: Path, size: int, meshlet: int = 0) -> Row:
    timed = alternate(*frames(rough, store, size, meshlet))
    name, first_ms = "frame_meshlets" if meshlet else "frame", timed.first_ms["total"]
    return Row(name, size, timed.ms["total"], PLAIN, timed.baseline_ms, first_ms=first_ms, steps=timed.ms)


def writers(rough: HeightField, size: int) -> tuple[Callable, Callable]:
    """A surface's arrays to a mesh that the dependency graph has evaluated: by our writer, and the plain way."""
    import bpy

    from ...operators.mesh import freed_memory
    from ...operators.mesh.writer import write_mesh

    flight_scene()
    surface, _ = surface_of(rough, size)
    mine, plain = new_object("Mine"), new_object("Plain")

    def ours() -> dict[str, float]:
        with stopwatch() as whole:
            with stopwatch() as written:
                freed_memory.hold()
                write_mesh(mine.data, surface)
            evaluated_triangles(bpy.context, mine)
        return {"mesh": written[0], "depsgraph": whole[0] - written[0], "total": whole[0]}

    return ours, lambda: plain_ingest(plain, surface)


def frames(rough: HeightField, store: Path, size: int, meshlet: int = 0) -> tuple[Callable, Callable]:
    """The next frame of an animated camera, all that Blender does until the new mesh is evaluated; and the plain
    ingest of a mesh of that size alone."""
    import bpy

    from ...operators.scene import session

    surface, px = surface_of(rough, size, meshlet)
    terrain = _terrain_scene(store, px, meshlet)
    plain, scene = new_object("Plain"), bpy.context.scene

    def ours() -> dict[str, float]:
        with stopwatch() as whole:
            scene.frame_set(scene.frame_current + 1)
            found = evaluated_triangles(bpy.context, terrain)
        status = session.record_of(terrain).status
        if status.error or found != status.triangles or abs(found - size) > 0.1 * size or "mesh" not in status.ms:
            raise TerrainError(f"A frame of about {size:,} triangles has {found:,} ({status.error or 'no error'}).")
        steps = {step: ms for step, ms in status.ms.items() if step != "total"}
        steps["blender"] = whole[0] - status.ms["total"] - status.ms["mesh"]
        return steps | {"total": whole[0]}

    return ours, lambda: plain_ingest(plain, surface)


def still_frame_row(rough: HeightField, store: Path) -> Row:
    """A frame change while the camera stands still: Blender keeps the mesh that it has."""
    import bpy

    from ...operators.scene import session

    next_frame, _ = frames(rough, store, MILLION)
    next_frame()
    scene, terrain = bpy.context.scene, bpy.data.objects["Terrain"]

    def stay() -> dict[str, float]:
        with stopwatch() as elapsed:
            scene.frame_set(scene.frame_current)
            evaluated_triangles(bpy.context, terrain)
        if "mesh" in session.record_of(terrain).status.ms:
            raise TerrainError("The mesh was written again although the camera did not move.")
        return {"total": elapsed[0]}

    timed = alternate(stay)
    return Row("still_frame", MILLION, timed.ms["total"], first_ms=timed.first_ms["total"])


def surface_of(rough: HeightField, size: int, meshlet: int = 0):
    """Copies of the arrays of about `size` triangles, and the pixels that give so many."""
    px = _scene_px(rough, size, meshlet)
    surface = Terrain(rough).update(scenes.errors(px, meshlet), [seen_from(scenes.eye_over(0))]).surface
    return surface.copy(), px


@cache
def _scene_px(rough: HeightField, size: int, meshlet: int) -> float:
    view = seen_from(scenes.eye_over(0))
    return scenes.pixels_for(rough, lambda _px: view, partial(scenes.errors, meshlet=meshlet), size)


def seen_from(eye) -> View:
    """What the scene's camera sees from there: the same lens, frame and clip range."""
    fov = math.degrees(2 * math.atan(SENSOR_MM / 2 / LENS_MM))
    return View.look(eye, (0, 0, 0), fov_deg=fov, resolution=RESOLUTION, clip=(0.1, 1e5))


def flight_scene(resolution: tuple[int, int] = RESOLUTION):
    """An empty file with a camera that flies over the terrain, one step a frame."""
    import bpy
    from mathutils import Vector

    from ...operators.output.frame_sources import open_empty_file

    open_empty_file()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.frame_start, scene.frame_end = 0, FRAMES
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.data.lens, camera.data.sensor_width = LENS_MM, SENSOR_MM
    camera.data.clip_start, camera.data.clip_end = 0.1, 1e5
    camera.rotation_mode = "QUATERNION"
    for frame in range(FRAMES + 1):
        eye = Vector(scenes.eye_over(frame))
        camera.location, camera.rotation_quaternion = eye, (-eye).to_track_quat("-Z", "Y")
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_quaternion", frame=frame)
    scene.frame_set(0)
    return scene


def new_object(name: str):
    import bpy

    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _terrain_scene(store: Path, px: float, meshlet: int):
    """The flight with one live terrain of `px` pixels of error, at frame 0."""
    scene = flight_scene()
    obj = new_object("Terrain")
    settings = obj.adaptive_terrain
    for detail in (settings.viewport, settings.render):
        detail.error_px, detail.meshlet = px, meshlet
    settings.store = str(store)
    settings.enabled = settings.live = True
    scene.frame_set(0)
    return obj
