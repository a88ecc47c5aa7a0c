# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that looks straight down on the whole terrain, and renders of it with their position on Earth."""

import json
import math
import os
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper
from mathutils import Matrix

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.exporting.height_tiles import placing_or_middle
from ...cbt_terrain.exporting.pictures import WORLD_FILES, write_geotiffs, write_world_file
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.partial_files import private_folder
from ..bridge.camera import render_resolution
from ..bridge.evaluated import raster_placement_of
from ..bridge.scene_paths import absolute_path, propose_file
from ..importing.imported import imported_of
from ..land import shaped_land
from ..session import session, stale_renders
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from ..terrain import sight
from ..terrain.properties import SCENE_CAMERA
from .blender_exporters import need_no_shear
from .exporting import check_target
from .file_outputs import escape_braces

NAME, SUN_NAME = "Map Camera", "Map Sun"
EXTENT = "adaptive_terrain_map"  # property of the camera with the JSON of a MapExtent
FRAME = "adaptive_terrain_map_frame"  # property with the numbers of `_camera_state` that belong to this extent
BEFORE = "adaptive_terrain_map_before"  # property with the numbers of SIZE before the map
SIZE = "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y"
MAX_SIDE, MAX_ASPECT = 65_536, 200.0  # of Blender's renders
FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".tif": "TIFF", ".tiff": "TIFF"}
MARGIN = 0.1  # of the terrain's height, above and below
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
    """Make the scene's camera an orthographic one over the terrain `obj`, north up; return it. Raises TerrainError.

    Args:
        obj: the terrain, in any location, rotation and scale.
        depsgraph: of the scene.
        pixels_per_cell: pixels along each side of a cell of the height map.
        metres_a_pixel: side of a pixel in metres of the height map, in place of those; rounded to fit the extent.
        with_sun: whether a scene without a sun gets one from the north-west.
    """
    box, scene = sight.box_of(obj, depsgraph), depsgraph.scene
    need_no_shear(obj)
    matrix = raster_placement_of(obj.evaluated_get(depsgraph))
    if np.linalg.det(matrix[:3, :3]) <= 0.0:
        raise TerrainError(f"The terrain {obj.name!r} is mirrored", fix="give it a scale above 0")
    scale = np.sqrt((matrix[:3, :3] ** 2).sum(0))
    axes, field = matrix[:3, :3] / scale, session.open_field(shaped_land.store_of(obj))
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
    pixel = [length * scale[axis] / size[axis] for axis, length in enumerate(lengths)]
    if max(pixel) / min(pixel) > MAX_ASPECT:
        raise TerrainError("The pixels of the map are too narrow", expected=f"sides up to 1 : {MAX_ASPECT:g}")
    west, south, east, north = lattice.rectangle()
    placing = placing_or_middle(field)
    low, high = placing.from_terrain(np.array([[west, south], [east, north]])).tolist()
    heights = (box - matrix[:3, 3]) @ axes[:, 2]
    spare = max(1.0, MARGIN * float(np.ptp(heights)))
    top = float(heights.max()) + spare

    camera = _find_or_add(scene, NAME, lambda: bpy.data.cameras.new(NAME), "CAMERA")
    data = camera.data
    data.type, data.sensor_fit, data.ortho_scale = "ORTHO", "HORIZONTAL", lengths[0] * scale[0]
    data.shift_x = data.shift_y = 0.0
    data.clip_start, data.clip_end = 0.5 * spare, top - float(heights.min()) + spare
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = axes, matrix[:3, 3] + axes[:, 2] * top
    camera.matrix_world = Matrix(place.tolist())
    camera[EXTENT] = json.dumps([*low, *high, placing.crs])
    render = scene.render
    if scene.camera is None or BEFORE not in scene.camera:
        camera[BEFORE] = [float(getattr(render, name)) for name in SIZE]
    scene.camera = camera
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.pixel_aspect_x, render.pixel_aspect_y = (side / min(pixel) for side in pixel)
    camera[FRAME] = _camera_state(scene)
    if with_sun and not any(other.type == "LIGHT" and other.data.type == "SUN" for other in scene.objects):
        sun = _find_or_add(scene, SUN_NAME, lambda: bpy.data.lights.new(SUN_NAME, "SUN"), "LIGHT")
        sun.data.energy = 3.0
        sun.matrix_world = Matrix(place[:3, :3].tolist()).to_4x4() @ _sun_rotation()
    return camera


def leave_map(scene) -> None:
    """Give the scene the size of its pictures before the map, if its camera is an unchanged map camera."""
    camera = scene.camera
    if camera is not None and BEFORE in camera and _is_unchanged(scene):
        for name, value in zip(SIZE, camera[BEFORE], strict=True):
            setattr(scene.render, name, value if name.startswith("pixel") else int(value))


def _camera_state(scene) -> list[float]:
    """Return the numbers that determine the map: the lens, the picture's aspect and the camera's matrix.

    If they change, the map's coordinates no longer hold.
    """
    data, render = scene.camera.data, scene.render
    aspect = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    rows = scene.camera.matrix_world[:3]
    return [data.ortho_scale, data.shift_x, data.shift_y, aspect, *(value for row in rows for value in row)]


def _is_unchanged(scene) -> bool:
    """Return whether the map camera and the picture's aspect are those of its extent."""
    frame = _camera_state(scene)
    return np.allclose(frame, list(scene.camera.get(FRAME, frame)), rtol=1e-5, atol=1e-6 * frame[0])


def _sun_rotation() -> Matrix:
    """Return the rotation of a sun lamp for shaded relief, from the north-west and half way up."""
    turned = Matrix.Rotation(math.radians(SUN_WEST), 4, "Z")
    return turned @ Matrix.Rotation(math.radians(SUN_HEIGHT - 90.0), 4, "X")


def _find_or_add(scene, name: str, make: Callable, kind: str):
    """Return the scene's object with this name and type, or a new one.

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


def render_map(scene, path: Path, tiles: tuple[int, int] = (1, 1), with_geotiff: bool = True) -> list[Path]:
    """Render the map of the scene's camera in `tiles` across and down; return the files. Raises TerrainError.

    Each picture gets a world file and, with `with_geotiff`, becomes a GeoTIFF, too. All tiles show the mesh of the
    whole map, so they fit together.
    """
    extent, size = extent_of(scene.camera), render_resolution(scene)
    if not _is_unchanged(scene):
        raise TerrainError("The map's camera or the picture's aspect was changed", fix="use Map Camera again")
    form = FORMATS.get(path.suffix.lower())
    if form is None:
        raise TerrainError(f"{path} is of no format for maps", expected=", ".join(FORMATS))
    if not all(1 <= count <= side for count, side in zip(tiles, size, strict=True)):
        raise TerrainError(f"{tiles[0]} x {tiles[1]} tiles of {size[0]} x {size[1]} pixels", expected="fewer tiles")
    written, geotiffs = [], []
    for row, column in np.ndindex(tiles[1], tiles[0]):
        stopping.check()
        x = [size[0] * k // tiles[0] for k in (column, column + 1)]
        y = [size[1] * k // tiles[1] for k in (row, row + 1)]
        name = path.name if tiles == (1, 1) else f"{path.stem}_x{column}_y{row}{path.suffix}"
        picture = path.with_name(name)
        check_target(picture)
        geotiff = picture if form == "TIFF" else picture.with_suffix(".tif")
        _check_keeps_sources(scene, {picture, geotiff} if with_geotiff else {picture})
        _render_part(scene, picture, size, x, y)
        transform = extent.transform(size, x[0], y[0])
        written += [picture, write_world_file(picture, transform)]
        geotiffs.append((picture, geotiff, transform))
    if with_geotiff:
        write_geotiffs(geotiffs, extent.crs)
        written += [file for picture, file, _ in geotiffs if file != picture]
    return written


def _check_keeps_sources(scene, files: set[Path]) -> None:
    """Raise TerrainError if one of the files to write is the height map of a terrain."""
    for settings in (obj.adaptive_terrain for obj in session.terrains_of(scene)):
        imported = imported_of(settings)
        sources = [settings.source_path, *(item.path for item in settings.more_sources)]
        sources.append(imported.settings.get("source", "") if imported else "")
        for source in (Path(absolute_path(name)) for name in sources if name):
            if any(file.exists() and source.exists() and file.samefile(source) for file in files):
                raise TerrainError(f"The map would replace the height map {source}", fix="choose another name")


def _render_part(scene, picture: Path, size: tuple[int, int], x: list[int], y: list[int]) -> None:
    """Render the pixels x[0] .. x[1], y[0] .. y[1] (from the top) of the frame into a file. Raises TerrainError."""
    render, (width, height) = scene.render, size
    parts = {"use_border": True, "use_crop_to_border": True}
    # Blender truncates float32 fractions to pixels: a quarter of a pixel keeps them on the right side.
    parts |= {"border_min_x": (x[0] + 0.25) / width, "border_max_x": (x[1] + 0.25) / width}
    parts |= {"border_min_y": (height - y[1] + 0.25) / height, "border_max_y": (height - y[0] + 0.25) / height}
    with private_folder(picture.parent) as folder, _temporarily_set(render, parts | {"use_file_extension": False}):
        render.filepath = escape_braces(folder / picture.name)
        with _temporarily_set(render.image_settings, _image_settings(picture)), stale_renders.raise_for_stale_frames():
            try:
                bpy.ops.render.render(write_still=True, scene=scene.name)
            except RuntimeError as error:
                raise TerrainError(f"Blender cannot render the map ({str(error).strip()})") from None
        if not (folder / picture.name).is_file():
            raise TerrainError(f"Blender wrote no picture into {picture.parent}", fix="check the disk")
        os.replace(folder / picture.name, picture)


def _image_settings(picture: Path) -> dict:
    """Return the values of Blender's image settings for the format of a file."""
    form = {"file_format": FORMATS[picture.suffix.lower()]}
    return form if bpy.app.version < (5, 0) else {"media_type": "IMAGE"} | form


@contextmanager
def _temporarily_set(owner, values: dict):
    """Set properties of `owner` for the `with` block; the path of a render is restored, too."""
    before = {name: getattr(owner, name) for name in (*values, *(["filepath"] if hasattr(owner, "filepath") else []))}
    try:
        for name, value in values.items():
            setattr(owner, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(owner, name, value)


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
        """Add or update the camera over the active terrain and set the scene's resolution."""
        obj, metres = context.object, self.metres if self.use_metres else None
        add_map_camera(obj, context.evaluated_depsgraph_get(), self.pixels, metres, self.sun)
        size = "{:,} x {:,} pixels".format(*render_resolution(context.scene))
        if obj.adaptive_terrain.camera_source != SCENE_CAMERA:
            self.report({"WARNING"}, f"{size}; the terrain is not refined for the scene's camera: set Camera to Scene")
        else:
            self.report({"INFO"}, f"{size}; Render Map writes them with their position")
        return {"FINISHED"}


class RenderMap(bpy.types.Operator, ExportHelper):
    """Render the picture of the map camera, whole or in tiles, with files that give map programs its place on Earth"""

    bl_idname = "adaptive_terrain.render_map"
    bl_label = "Render Map"

    filename_ext = ".png"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{s}" for s in WORLD_FILES), options={"HIDDEN"})
    tiles: bpy.props.IntVectorProperty(
        name="Tiles",
        description="Number of pictures across and down: use several for a map that is too large for one render",
        size=2,
        default=(1, 1),
        min=1,
    )
    geotiff: bpy.props.BoolProperty(
        name="GeoTIFF",
        description="Also write each picture as a GeoTIFF, which contains its place on Earth",
        default=True,
    )

    @classmethod
    def poll(cls, context):
        cls.poll_message_set("The scene's camera is no map camera: use Map Camera first")
        return context.scene.camera is not None and EXTENT in context.scene.camera

    def invoke(self, context, event):
        """Propose the name of the terrain that the panels show."""
        if (terrain := session.shown_terrain(context)) is not None:
            propose_file(self, terrain, "_map")
        return ExportHelper.invoke(self, context, event)

    @cancelled_by_errors
    def execute(self, context):
        """Render the map into the chosen file, or into tiles with its name."""
        files = render_map(context.scene, Path(self.filepath), tuple(self.tiles), self.geotiff)
        self.report({"INFO"}, f"Written: {files[0].name} and {len(files) - 1} more")
        return {"FINISHED"}
