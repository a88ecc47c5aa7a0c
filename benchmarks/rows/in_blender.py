# SPDX-License-Identifier: GPL-3.0-or-later
"""Row of a whole frame in Blender, from the camera's motion to the evaluated mesh; scenes for other rows."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import Draft
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.view import View
from ..rig import scenes
from ..rig.baselines import PLAIN, evaluated_triangles, plain_ingest
from ..rig.measure import RUNS, SHORT_BLOCKS, BenchmarkRow, alternate, stopwatch

FRAME_SIZES = (50_000, 250_000, scenes.MILLION)
RESOLUTION = (1920, 1080)
LENS_MM, SENSOR_MM = 36.0, 36.0
FRAMES = SHORT_BLOCKS * RUNS + 1


def write_store(field: HeightField, folder: Path) -> Path:
    """Write a field into a store that Blender's side can open."""
    draft = Draft(folder)
    for name in ("samples", "error", "ranges"):
        array = getattr(field, name)
        draft.allocate(name, array.shape, array.dtype)[:] = array
    draft.publish(field, "benchmark", {})
    return folder


def frame_row(rough: HeightField, store: Path, size: int) -> BenchmarkRow:
    """Measure frames of an animated camera against the plain ingest of a mesh of the same size."""
    timed = alternate(*frames(rough, store, size))
    first_ms = timed.first_ms["total"]
    return BenchmarkRow("frame", size, timed.ms["total"], PLAIN, timed.baseline_ms, first_ms=first_ms, steps=timed.ms)


def frames(rough: HeightField, store: Path, size: int) -> tuple[Callable, Callable]:
    """Return a function that shows the next frame, and one that ingests a mesh of that size the plain way."""
    import bpy

    from ...operators.session import session

    px = _scene_px(rough, size)
    surface = Terrain(rough).update(scenes.errors(px), [_camera_view()]).surface.copy()
    terrain = _terrain_scene(store, px)
    plain, scene = new_object("Plain"), bpy.context.scene

    def next_frame() -> dict[str, float]:
        with stopwatch() as whole:
            scene.frame_set(scene.frame_current + 1)
            found = evaluated_triangles(bpy.context, terrain)
        status = session.record_of(terrain).status
        if status.error or found != status.triangles or abs(found - size) > 0.1 * size or "mesh" not in status.ms:
            raise TerrainError(f"A frame of about {size:,} triangles has {found:,} ({status.error or 'no error'})")
        steps = {step: ms for step, ms in status.ms.items() if step != "total"}
        steps["blender"] = whole[0] - status.ms["total"] - status.ms["mesh"]
        return steps | {"total": whole[0]}

    return next_frame, lambda: plain_ingest(plain, surface)


@cache
def _scene_px(rough: HeightField, size: int) -> float:
    return scenes.pixels_for(rough, _camera_view(), scenes.errors, size)


def _camera_view() -> View:
    """Return the view of the scene's camera in its first frame."""
    fov = math.degrees(2 * math.atan(SENSOR_MM / 2 / LENS_MM))
    return View.look(scenes.eye_over(0), (0, 0, 0), fov_deg=fov, resolution=RESOLUTION, clip=(0.1, 1e5))


def flight_scene(resolution: tuple[int, int] = RESOLUTION):
    """Return the scene of an empty file with a camera that flies over the terrain, one step a frame."""
    import bpy
    from mathutils import Vector

    from ...operators.export.blend_files import open_empty_file

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
    """Return a new object with an empty mesh."""
    import bpy

    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _terrain_scene(store: Path, px: float):
    """Return the live terrain of a new flight scene at frame 0."""
    scene = flight_scene()
    obj = new_object("Terrain")
    settings = obj.adaptive_terrain
    for detail in (settings.viewport, settings.render):
        detail.error_px = px
    settings.store = str(store)
    settings.enabled = settings.live = True
    scene.frame_set(0)
    return obj
