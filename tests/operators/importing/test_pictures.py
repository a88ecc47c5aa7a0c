# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture with the raster's corners fits the terrain after the steps that the import names."""

import re

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.importing.panel import ImportedPanel
from adaptive_terrain.operators.importing.placement_notes import picture_note
from adaptive_terrain.operators.session import session
from blender_meshes import positions, read
from drawn_panels import draw_mocked
from rasters import hills, imported, write_raster

WEST, SOUTH, CELL = 600_000.0, 5_199_700.0, 10.0

pytestmark = pytest.mark.usefixtures("imports_here")


def terrain_of(add_terrain, tmp_path, file, **settings):
    """Return a terrain with the store of a file, imported in this process."""
    field, _ = imported(tmp_path, file, **settings)
    terrain = add_terrain()
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    return terrain, field


def numbers_in(text: str) -> np.ndarray:
    """Return location and scale, of x and of y each, that a note names."""
    [found] = re.findall(r"Location (\S+), (\S+) and Scale (\S+), (\S+)\.$", text)
    return np.array(found, np.float64).reshape(2, 2)


@pytest.mark.parametrize("north_up", [True, False])  # the other: rows run north, columns of the file along y
def test_the_named_mapping_puts_each_cell_in_its_place(scene, add_terrain, tmp_path, north_up):
    columns, rows = 40, 30
    heights, transform = hills(columns, rows), (CELL, 0.0, WEST, 0.0, -CELL, SOUTH + CELL * rows)
    if not north_up:
        heights, transform = heights[::-1].T, (0.0, CELL, WEST, CELL, 0.0, SOUTH)
    file = write_raster(tmp_path / "dem.tif", heights, crs="EPSG:32632", transform=transform)
    terrain, field = terrain_of(add_terrain, tmp_path, file)
    terrain.adaptive_terrain.viewport.error_m = 0.1  # the camera sees other ground
    session.update_object(terrain)
    mesh = terrain.data
    points, corners = positions(terrain).astype(np.float64), read(mesh.loops, "vertex_index", 1, np.int32)
    uv = read(mesh.uv_layers.active.uv, "vector", 2)
    location, scale = numbers_in(picture_note(imported_of(terrain.adaptive_terrain)))
    place = points[corners, :2] + field.origin[:2]
    # Where a picture that reaches from corner to corner of the raster shows a place.
    expected = (place - (WEST, SOUTH)) / (CELL * columns, CELL * rows)
    assert len(uv) > 100 and np.abs(uv - expected).max() > 0.45 / columns, "it is off by half a cell as it is"
    np.testing.assert_allclose(uv * scale + location, expected, atol=1e-5)


def test_the_panel_names_the_mapping_where_it_applies(scene, add_terrain, tmp_path):
    transform = (CELL, 0.0, WEST, 0.0, -CELL, SOUTH)
    file = write_raster(tmp_path / "dem.tif", hills(), crs="EPSG:32632", transform=transform)
    terrain, _ = terrain_of(add_terrain, tmp_path, file)
    column = draw_mocked(ImportedPanel, terrain)
    labels = " ".join(call.kwargs["text"] for call in column.box().column().label.mock_calls)
    np.testing.assert_allclose(numbers_in(labels), [[0.5 / 40, 0.5 / 30], [39 / 40, 29 / 30]], rtol=1e-6)
    terrain.adaptive_terrain.store = ""
    assert picture_note(imported_of(terrain.adaptive_terrain)) == "", "nothing is imported"


@pytest.mark.parametrize("source", ["island", "dem.tif"])
def test_lands_and_reprojected_rasters_have_no_corners(scene, add_terrain, tmp_path, source):
    settings = {"size": 17}
    if source == "dem.tif":
        transform = (CELL, 0.0, WEST, 0.0, -CELL, SOUTH)
        source = write_raster(tmp_path / source, hills(), crs="EPSG:32632", transform=transform)
        settings = {"project": "EPSG:32633"}
    terrain, _ = terrain_of(add_terrain, tmp_path, source, **settings)
    assert picture_note(imported_of(terrain.adaptive_terrain)) == ""


def test_an_import_reports_open_cells_and_the_mapping(scene, add_terrain, tmp_path, capfd):
    """Of the second of two tiles, by the operator."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    for name, x in (("w", WEST), ("e", WEST + 40 * CELL)):
        transform = (CELL, 0.0, x, 0.0, -CELL, SOUTH)
        file = write_raster(tmp_path / f"{name}.tif", hills(), crs="EPSG:32632", transform=transform)
        settings = add_terrain(name).adaptive_terrain
        settings.store, settings.source, settings.source_path = "", "FILE", str(file)
        assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    printed = capfd.readouterr().out
    assert printed.count("Warning: The cells of w and e meet edge to edge") == 1
    assert printed.count("Info: A picture with the raster's corners") == 2
