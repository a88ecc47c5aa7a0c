# SPDX-License-Identifier: GPL-3.0-or-later
"""A second raster of the same coordinate system is not silently put on the first, or beside an open cell."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.importing import placement_notes
from adaptive_terrain.operators.importing.imported import Imported, tag_object
from adaptive_terrain.operators.importing.placement_notes import neighbour_notes
from rasters import hills, write_raster


def placed(name: str, crs: str, x: float, y: float):
    """Return an object that is tagged as an imported terrain."""
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    obj["SRID"], obj["crs x"], obj["crs y"] = crs, x, y
    return obj


def test_the_distance_to_the_first_raster_is_named(scene):
    west, east = placed("west", "EPSG:32632", 600640.0, 5199360.0), placed("east", "EPSG:32632", 601920.0, 5199350.5)
    [note] = neighbour_notes(east, [west, east])
    assert "1280 further east and -9.5 further north" in note and "west" in note
    east.location = (1280.0, -9.5, 0.0)
    bpy.context.view_layer.update()
    assert neighbour_notes(east, [west, east]) == []


def test_other_systems_and_the_same_raster_are_silent(scene):
    first = placed("first", "EPSG:32632", 600640.0, 5199360.0)
    assert neighbour_notes(first, [first]) == []
    assert neighbour_notes(placed("same", "EPSG:32632", 600640.0, 5199360.0), [first]) == []
    assert neighbour_notes(placed("other", "EPSG:2056", 2600640.0, 1199360.0), [first]) == []
    bare = bpy.data.objects.new("bare", bpy.data.meshes.new("bare"))
    assert neighbour_notes(bare, [first]) == []


def tile(folder, name: str, columns: int, rows: int, x: float, y: float, cell=10.0, crs="EPSG:32632"):
    """Import a pixel-is-area raster whose corner in the north-west is (x, y); return an object that has its store."""
    transform = (cell, 0.0, x, 0.0, -cell, y)
    write_raster(folder / f"{name}.tif", hills(columns, rows), crs=crs, transform=transform)
    run_import(ImportSettings(str(folder / f"{name}.tif")), folder / name)
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    obj.adaptive_terrain.store = str(folder / name)
    tag_object(obj)
    return obj


def seams(*objects):
    """Return the notes of the last of the objects about the seam to the first."""
    return [note for note in neighbour_notes(objects[-1], objects) if "Add Tiles" in note]


OPEN, SHARED = "one cell between them stays open", "apart by up to the sum of both errors"


# A tile of 40 x 30 cells whose corner in the north-west is (x, y), and another one: columns, rows, x, y of that, cell.
@pytest.mark.parametrize(
    ("crs", "cell", "corner", "other", "seam"),
    [
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (40, 30, 6e5 + 400, 5.2e6, 10.0), OPEN),
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (40, 20, 6e5, 5.2e6 + 200, 10.0), OPEN),
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (60, 9, 6e5 - 300, 5.2e6 - 40, 5.0), OPEN),  # half the cells, half the side
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (40, 30, 6e5 + 390, 5.2e6, 10.0), SHARED),  # a shared column of samples
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (40, 30, 6e5 + 400, 5.2e6 - 300, 10.0), None),  # a shared corner
        ("EPSG:32632", 10.0, (6e5, 5.2e6), (40, 30, 6e5 + 430, 5.2e6, 10.0), None),  # cells that are missing
        ("EPSG:4326", 1 / 1200, (10.0, 47.0), (40, 30, 10.0 + 40 / 1200, 47.0, 1 / 1200), OPEN),
        ("EPSG:4326", 1 / 1200, (10.0, 47.0), (40, 30, 10.0, 47.0 - 30 / 1200, 1 / 1200), OPEN),
        ("EPSG:4326", 1 / 1200, (10.0, 47.0), (40, 30, 10.0 + 39 / 1200, 47.0, 1 / 1200), SHARED),
        ("EPSG:2263", 30.0, (9.8e5, 2e5), (40, 30, 9.8e5 + 1200, 2e5, 30.0), OPEN),  # US feet
    ],
)
def test_tiles_that_touch_along_a_side_warn(scene, tmp_path, crs, cell, corner, other, seam):
    columns, rows, x, y, other_cell = other
    first = tile(tmp_path, "first", 40, 30, *corner, cell, crs)
    notes = seams(first, tile(tmp_path, "second", columns, rows, x, y, other_cell, crs))
    assert len(notes) == (seam is not None)
    assert not notes or (seam in notes[0] and "adaptive-terrain import first.tif second.tif" in notes[0])


def test_tiles_imported_together_have_the_ground_between_them(scene, tmp_path):
    """What the warning says to do leaves nothing open."""
    heights, files = hills(80, 30), []
    for name, first in (("w", 0), ("e", 40)):
        transform = (10.0, 0.0, 6e5 + 10.0 * first, 0.0, -10.0, 5.2e6)
        file = write_raster(
            tmp_path / f"{name}.tif", heights[:, first : first + 40], crs="EPSG:32632", transform=transform
        )
        files.append(str(file))
    run_mosaic_import(ImportSettings(files[0], more_sources=files[1:]), tmp_path / "store")
    field = open_store(tmp_path / "store")
    between = np.array([[600400.0 - field.origin[0], 5199855.0 - field.origin[1]]])  # in row 14, between the tiles
    assert ground_at(field, between).heights[0] == pytest.approx(heights[14, 39:41].mean(), abs=1e-3)


@pytest.mark.parametrize(
    ("first_x", "first_y", "is_noted"), [(0, 0, False), (-10, 0, True), (0, -10, True), (100, 0, True)]
)
def test_moved_scatter_points_are_noted(monkeypatch, first_x, first_y, is_noted):
    """Points are counted from the south-west. The raster always grows in the north and the east."""
    step, rasters = 10.0, []
    for x, y in ((0, 0), (first_x, first_y)):  # column and row of the sample in the south-west
        columns, rows = (41, 31) if not rasters else (60 - x, 50 - y)
        extent = step * (columns - 1), step * (rows - 1)
        middle = 6e5 + step * x + extent[0] / 2, 5.2e6 + step * y + extent[1] / 2
        place = (1.0, 0.0, middle[0], 0.0, 1.0, middle[1])
        rasters.append(
            Imported({}, "EPSG:32632", middle, (columns, rows), extent, (step, step), (0.0, 1.0), place=place)
        )
    monkeypatch.setattr(placement_notes, "imported_of", lambda _settings: rasters[1])
    monkeypatch.setattr(placement_notes, "scatters_of", lambda obj: obj.scatters)
    obj = SimpleNamespace(adaptive_terrain=None, scatters=["trees"])
    assert ("stand at new places" in placement_notes.scatter_note(obj, rasters[0])) == is_noted
    assert placement_notes.scatter_note(obj, None) == ""
    obj.scatters = []
    assert placement_notes.scatter_note(obj, rasters[0]) == ""
