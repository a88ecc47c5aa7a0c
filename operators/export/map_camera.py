# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that looks straight down on the whole terrain, with the extent of its picture on Earth."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.importing.placing import placing_or_middle
from ..bridge.camera import render_resolution
from ..bridge.evaluated import raster_placement_of
from ..land import shaped_land
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from ..terrain import sight
from ..terrain.properties import SCENE_CAMERA
from .blender_exporters import check_not_sheared

NAME, SUN_NAME = "Map Camera", "Map Sun"
EXTENT = "adaptive_terrain_map"  # property of the camera with the JSON of a MapExtent
STATE = "adaptive_terrain_map_frame"  # property with the numbers of `_camera_state` that belong to this extent
BEFORE = "adaptive_terrain_map_before"  # property with the values of SIZE before the map
SIZE = "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y"  # of the render
MAX_SIDE, MAX_ASPECT = 65_536, 200.0  # of Blender's renders
MARGIN = 0.1  # of the terrain's height: the camera's distance to its top, and the view's depth below its bottom
MOVED = 0.1  # pixels by which an unchanged camera may seem to be moved
# Degrees of the sun of shaded relief: above the horizon, and from north to west.
SUN_HEIGHT, SUN_WEST = 45.0, 45.0


@dataclass(frozen=True)
class MapExtent:
    """Coordinates of the borders of a map, and the name of their system."""

    west: float
    south: float
    east: float
    north: float
    crs: str

    def transform(self, size: tuple[int, int], column: int = 0, row: int = 0) -> tuple[float, ...]:
        """Return the affine transform of a part of a map, as rasterio's six numbers.

        size: pixels of the whole map. column, row: the part's first pixel.
        """
        x, y = (self.east - self.west) / size[0], (self.south - self.north) / size[1]
        return x, 0.0, self.west + column * x, 0.0, y, self.north + row * y


def add_map_camera(obj, depsgraph, pixels_per_cell: int, metres_a_pixel: float | None = None, with_sun: bool = False):
    """Add or update an orthographic camera over the terrain `obj`, north up, as the scene's camera; return it.

    It is the scene's Map Camera, or a new one. The render gets the size of the map; `leave_map` restores the size
    before. Raises TerrainError for a sheared or mirrored terrain, and for too many or too narrow pixels.

    Args:
        obj: the terrain, in any location, rotation and scale.
        depsgraph: the scene's.
        pixels_per_cell: pixels along each side of a cell of the height map.
        metres_a_pixel: side of a pixel in metres of the height map, in place of those; rounded to fit the extent.
        with_sun: whether a scene without a sun gets one from the north-west.
    """
    box, scene = sight.box_of(obj, depsgraph), depsgraph.scene
    check_not_sheared(obj)
    matrix = raster_placement_of(obj.evaluated_get(depsgraph))
    if np.linalg.det(matrix[:3, :3]) <= 0.0:
        raise TerrainError(f"The terrain {obj.name!r} is mirrored", fix="give it a scale above 0")
    scale = np.sqrt((matrix[:3, :3] ** 2).sum(0))  # along the terrain's axes
    axes, field = matrix[:3, :3] / scale, session.open_field(shaped_land.store_of(obj))  # columns: east, north, up
    lattice = field.lattice
    cells, steps = (lattice.cells_x, lattice.cells_y), (lattice.step_x, lattice.step_y)
    lengths = [count * step for count, step in zip(cells, steps, strict=True)]
    if metres_a_pixel is None:
        size = [count * pixels_per_cell for count in cells]
    else:
        size = [max(1, round(length / metres_a_pixel)) for length in lengths]
    if max(size) > MAX_SIDE:
        raise TerrainError(
            f"The map has {size[0]:,} x {size[1]:,} pixels", expected=f"at most {MAX_SIDE:,} a side", fix="use fewer"
        )
    pixel = [length * scale[axis] / size[axis] for axis, length in enumerate(lengths)]  # its sides in the world, metres
    if max(pixel) / min(pixel) > MAX_ASPECT:
        raise TerrainError("The pixels of the map are too narrow", expected=f"sides up to 1 : {MAX_ASPECT:g}")
    west, south, east, north = lattice.rectangle()
    placing = placing_or_middle(field)
    # Corners of the raster in its coordinate system; metres from the middle without one.
    south_west, north_east = placing.from_terrain(np.array([[west, south], [east, north]])).tolist()
    heights = (box - matrix[:3, 3]) @ axes[:, 2]  # of the box's corners along the terrain's up axis
    spare = max(1.0, MARGIN * float(np.ptp(heights)))
    top = float(heights.max()) + spare  # of the camera

    # The camera: its frame is as wide as the terrain and its clip range holds all heights with the margin `spare`.
    camera = _find_or_add(scene, NAME, lambda: bpy.data.cameras.new(NAME), "CAMERA")
    data = camera.data
    data.type, data.sensor_fit, data.ortho_scale = "ORTHO", "HORIZONTAL", lengths[0] * scale[0]
    data.shift_x = data.shift_y = 0.0
    data.clip_start, data.clip_end = 0.5 * spare, top - float(heights.min()) + spare
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = axes, matrix[:3, 3] + axes[:, 2] * top
    camera.matrix_world = Matrix(to_world.tolist())
    camera[EXTENT] = json.dumps([*south_west, *north_east, placing.crs])
    # The render: keep its size for `leave_map`, then give it that of the map.
    render = scene.render
    if scene.camera is None or BEFORE not in scene.camera:  # else the render has the size of another map
        camera[BEFORE] = [float(getattr(render, name)) for name in SIZE]
    scene.camera = camera
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.pixel_aspect_x, render.pixel_aspect_y = (side / min(pixel) for side in pixel)
    camera[STATE] = _camera_state(scene)  # shows later whether the extent still fits the camera
    if with_sun and not any(other.type == "LIGHT" and other.data.type == "SUN" for other in scene.objects):
        sun = _find_or_add(scene, SUN_NAME, lambda: bpy.data.lights.new(SUN_NAME, "SUN"), "LIGHT")
        sun.data.energy = 3.0
        sun.matrix_world = Matrix(to_world[:3, :3].tolist()).to_4x4() @ _sun_rotation()
    return camera


def leave_map(scene) -> None:
    """Restore the resolution and pixel aspect that the render had before the map, if the map camera is unchanged.

    The property BEFORE of the scene's camera, written by `add_map_camera`, holds them. Nothing changes with another
    camera.
    """
    camera = scene.camera
    if camera is not None and BEFORE in camera and is_unchanged(scene):
        for name, value in zip(SIZE, camera[BEFORE], strict=True):  # stored as floats; resolutions are integers
            setattr(scene.render, name, value if name.startswith("pixel") else int(value))


def _camera_state(scene) -> list[float]:
    """Return the numbers that determine the map: the lens's scale and shift, the aspect, and the camera's matrix.

    These are 4 numbers and 3 rows of 4. If they change, the map's coordinates no longer hold.
    """
    data, render = scene.camera.data, scene.render
    aspect = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    rows = scene.camera.matrix_world[:3]
    return [data.ortho_scale, data.shift_x, data.shift_y, aspect, *(value for row in rows for value in row)]


def is_unchanged(scene) -> bool:
    """Return whether the scene's camera and the picture's aspect are those of its map, within rounding.

    True for a camera without stored numbers. `now` and `stored`: the width of the picture in metres, two shifts, the
    aspect, and the three rows of the camera's matrix.
    """
    now, location = np.array(_camera_state(scene)), slice(7, None, 4)  # the last number of each row of the matrix
    stored, pixel = np.array(scene.camera.get(STATE, now)), now[0] / scene.render.resolution_x  # side in metres
    allowed = np.full(len(now), 1e-6)
    allowed[0] *= stored[0]
    allowed[3:] *= 10.0  # the aspect and the directions
    # A metre is a millionth of a location 1,000 km away, but may be several pixels.
    allowed[location] = MOVED * pixel + np.spacing(np.abs(stored[location]).astype(np.float32))
    return bool((np.abs(now - stored) <= allowed).all())


def _sun_rotation() -> Matrix:
    """Return the rotation of a sun lamp for shaded relief, from the north-west and half way up."""
    turned = Matrix.Rotation(math.radians(SUN_WEST), 4, "Z")
    return turned @ Matrix.Rotation(math.radians(SUN_HEIGHT - 90.0), 4, "X")


def _find_or_add(scene, name: str, make: Callable, kind: str):
    """Return the scene's object with this name and type, unless it is linked from a library, or a new one.

    make: creates its data.
    """
    found = scene.objects.get(name)
    if found is not None and found.type == kind and found.library is None:
        return found
    found = bpy.data.objects.new(name, make())
    scene.collection.objects.link(found)
    return found


def extent_of(camera) -> MapExtent:
    """Return the extent of a map camera. Raises TerrainError for any other object."""
    try:
        return MapExtent(*json.loads(camera[EXTENT]))
    except (TypeError, KeyError, ValueError):
        raise TerrainError("The scene's camera is no map camera", fix="use Map Camera on a terrain") from None


class MapCamera(TerrainObjectOperator, bpy.types.Operator):
    """Add an orthographic camera that looks straight down on the whole terrain, north up, and set the size of the
    render to whole pixels for each cell of the height map"""

    bl_idname = "adaptive_terrain.map_camera"
    bl_label = "Map Camera"
    bl_options = {"REGISTER", "UNDO"}

    pixels: bpy.props.IntProperty(
        name="Pixels per Cell",
        description="Pixels along each side of a cell of the height map: more make a larger picture",
        default=1,
        min=1,
        max=1024,
    )
    use_metres: bpy.props.BoolProperty(name="By Metres", description="Enter the size of a pixel in metres instead")
    metres: bpy.props.FloatProperty(
        name="Metres per Pixel",
        description="Size of a pixel on the ground; it is rounded so that whole pixels fit the terrain",
        default=10.0,
        min=1e-4,
    )
    sun: bpy.props.BoolProperty(
        name="Sun", description="Add a sun from the north-west for shaded relief, if the scene has no sun", default=True
    )

    @cancelled_by_errors
    def execute(self, context):
        """Add or update the camera over the active terrain, set the scene's resolution, and report it."""
        obj, metres = context.object, self.metres if self.use_metres else None
        add_map_camera(obj, context.evaluated_depsgraph_get(), self.pixels, metres, with_sun=self.sun)
        size = "{:,} x {:,} pixels".format(*render_resolution(context.scene))
        if obj.adaptive_terrain.camera_source != SCENE_CAMERA:
            self.report({"WARNING"}, f"{size}; the terrain is not refined for the scene's camera: set Camera to Scene")
        else:
            self.report({"INFO"}, f"{size}; Render Map writes them with their position")
        return {"FINISHED"}
