#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw five terrains after *Set Up Scene*: docs/images/scene_NAME.jpg by Cycles, and FOLDER/scene_NAME.jpg by EEVEE.

draw_scenes.py FOLDER [NAME ...]
"""

import sys
from pathlib import Path

import bpy
import rasterio
from adaptive_terrain.operators.blender import need_bpy
from matplotlib.cbook import get_sample_data

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
# Built-in terrains by the name of their picture, and whether height operators shape them; "" is a real elevation model.
SCENES = {
    "alps": ("MOUNTAINS", True),
    "dunes": ("DUNES", False),
    "coast": ("ARCHIPELAGO", True),
    "hills": ("", False),
    "canyon": ("CANYON", True),
}
EEVEE = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0) else "BLENDER_EEVEE"


def write_hills(path: Path) -> Path:
    """Write matplotlib's elevation model of hills in Tennessee as a GeoTIFF."""
    data = get_sample_data("jacksboro_fault_dem.npz")
    heights = data["elevation"]
    (south, north), (west, east) = (sorted(float(data[axis + end]) for end in ("min", "max")) for axis in "yx")
    rows, columns = heights.shape
    place = rasterio.transform.from_bounds(west, south, east, north, columns, rows)
    shape = {"height": rows, "width": columns, "count": 1, "dtype": heights.dtype}
    with rasterio.open(path, "w", driver="GTiff", crs="EPSG:4326", transform=place, **shape) as file:
        file.write(heights, 1)
    return path


def add_terrain(folder: Path, land: str, is_shaped: bool) -> None:
    """Open the start-up file, and add a terrain as a user does."""
    bpy.ops.wm.read_factory_settings()
    need_bpy("This picture")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{land or 'hills'}.blend"))
    if not land:
        bpy.ops.mesh.adaptive_terrain_add(land="ISLAND")
        settings = bpy.context.object.adaptive_terrain
        settings.source, settings.source_path = "FILE", str(write_hills(folder / "hills.tif"))
        bpy.ops.adaptive_terrain.import_source()
        return
    bpy.ops.mesh.adaptive_terrain_add(land=land, natural_size=True, shape=is_shaped)
    if is_shaped:
        bpy.ops.adaptive_terrain.shape()


def draw(folder: Path, name: str) -> None:
    """Set up a scene of SCENES, and render it by both engines."""
    add_terrain(folder, *SCENES[name])
    bpy.ops.adaptive_terrain.set_up_scene(view="ACROSS")
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.device, scene.eevee.taa_render_samples = 16, "CPU", 16
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 768, 432, 100
    scene.render.image_settings.file_format, scene.render.image_settings.quality = "JPEG", 82
    for scene.render.engine, to in (("CYCLES", IMAGES), (EEVEE, folder)):
        scene.render.filepath = str(to / f"scene_{name}.jpg")
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    place = Path(sys.argv[1]).resolve()
    place.mkdir(parents=True, exist_ok=True)
    for chosen in sys.argv[2:] or SCENES:
        draw(place, chosen)
