# SPDX-License-Identifier: GPL-3.0-or-later
"""The view that Set Up Scene composes across the land."""

import math

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.largest_part import PartSamples
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.scene import viewpoint
from adaptive_terrain.operators.session import session
from land_scenes import add
from mosaic_files import EAST, NORTH, sheet
from rasterio import Affine
from rasters import write_raster

SET_UP = bpy.ops.adaptive_terrain


def test_the_view_across_shows_water_and_hides_the_border():
    """A lake lies in a bowl of mountains with an opening in the south."""
    x = np.linspace(-5000.0, 5000.0, 129)
    east_m, north_m = np.meshgrid(x, x)
    rim = np.minimum(np.hypot(east_m, np.maximum(north_m, 0.0)) / 5000.0, 1.0) ** 3
    z = np.where(np.hypot(east_m - 800.0, north_m) < 1200.0, 90.0, 100.0 + 1500.0 * rim)
    part = PartSamples(x, x, z, np.ones(z.shape, bool))
    (east, north, height), azimuth = viewpoint._best_view(part, 90.0)
    ahead = np.array([math.sin(azimuth), math.cos(azimuth)])

    to_lake = np.array([800.0 - east, -north])
    assert ahead @ to_lake / np.linalg.norm(to_lake) > math.cos(math.radians(30.0))
    assert ahead[1] > -0.5, "it does not look out of the open side"
    assert 90.0 < height < 1200.0
    moved, turned = viewpoint._best_view(part._replace(x=x + 16384.0, y=x - 8192.0), 90.0)  # with the anchor elsewhere
    assert moved == (east + 16384.0, north - 8192.0, height) and turned == azimuth


def test_the_highest_of_a_range_is_well_inside_the_view():
    """A range along one side of a plain rises in the frame's middle, and does not lean to a corner."""
    x = np.linspace(-12_000.0, 12_000.0, 129)
    east_m, north_m = np.meshgrid(x, x)
    range_m = 1800.0 * np.exp(-(((east_m + 5000.0) / 3500.0) ** 2))
    z = 400.0 - 0.02 * east_m + range_m * (0.75 + 0.25 * np.sin(north_m / 1300.0) * np.cos(east_m / 1700.0))
    eye, azimuth = viewpoint._best_view(PartSamples(x, x, z, np.ones(z.shape, bool)), float(np.quantile(z, 0.05)))
    degrees = np.arange(-32, 33)  # across the frame
    skyline = []
    for angle in azimuth + np.radians(degrees):
        away = np.arange(300.0, 24_000.0, 100.0)
        at = np.stack([eye[1] + math.cos(angle) * away, eye[0] + math.sin(angle) * away], axis=1)
        away, at = away[(abs(at) <= 12_000.0).all(axis=1)], at[(abs(at) <= 12_000.0).all(axis=1)]
        row, column = np.rint((at + 12_000.0) / 187.5).astype(int).T
        skyline.append(((z[row, column] - eye[2]) / away).max())
    top = math.tan(viewpoint.PITCH + math.atan(viewpoint.SENSOR_MM / 2 / viewpoint.LENS_MM * 9 / 16))
    assert abs(degrees[np.argmax(skyline)]) <= 18 and 0.08 < max(skyline) < 0.9 * top
    assert abs(skyline[0] - skyline[-1]) < 0.06 and min(skyline) > 0.0, "the border is hidden by the range"


@pytest.mark.parametrize("gap", ["island", "valley", "lake"])
def test_the_view_across_stands_on_ground(factory, add_terrain, tmp_path, gap):
    """It does with a small island in a large hole, a narrow valley along a diagonal, and a large hole in the middle."""
    heights = 40.0 * np.sin(np.mgrid[0:401, 0:401][1] / 9.0) + 50.0
    row, column = np.mgrid[0:401, 0:401]
    is_ground = {
        "island": (abs(row - 330) < 30) & (abs(column - 60) < 40),
        "valley": abs(row - column - 20) < 12,
        "lake": np.hypot(row - 200, column - 200) > 120,
    }[gap]
    raster = np.where(is_ground, heights, np.nan).astype(np.float32)
    write_raster(
        tmp_path / "land.tif", raster[::-1], transform=Affine(10.0, 0.0, 0.0, 0.0, -10.0, 4010.0), nodata=np.nan
    )
    run_import(ImportSettings(str(tmp_path / "land.tif"), holes=True), tmp_path / "store")
    terrain = add_terrain()
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    to_world, distance, _ = viewpoint.view_across(terrain, bpy.context.evaluated_depsgraph_get())
    eye, ahead = np.array(to_world.translation), -np.array(to_world.col[2].xyz)
    along = eye[:2] + np.linspace(0.0, 300.0, 31)[:, None] * ahead[:2]  # metres from the eye
    at = np.rint(along / 10.0 + 200.0).astype(int)
    inside = (at >= 0).all(axis=1) & (at <= 400).all(axis=1)
    seen = is_ground[at[inside, 1], at[inside, 0]]
    assert seen[0] and seen.mean() * inside.mean() > 0.8
    assert 0.0 < eye[2] - heights[at[0, 1], at[0, 0]] < 150.0
    assert distance < 1000.0 if gap == "island" else distance > 2000.0


@pytest.mark.parametrize("quick", [0, 2000])
def test_the_view_across_stands_on_a_file_of_a_mosaic(factory, add_terrain, tmp_path, quick):
    """The gap beside the diagonal of its files is filled. A quick import has every 16th sample."""
    for k in range(9):
        one = sheet("EPSG:32632", EAST + 500.0 * k, NORTH - 500.0 * k, 10.0, 10.0, 50, 50)
        one.write(tmp_path / "files" / f"{k}.tif")
    run_mosaic_import(ImportSettings(str(tmp_path / "files"), quick=quick), tmp_path / "store")
    terrain = add_terrain()
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    to_world, *_ = viewpoint.view_across(terrain, bpy.context.evaluated_depsgraph_get())
    eye, ahead = np.array(to_world.translation), -np.array(to_world.col[2].xyz)
    for metres in (0.0, 150.0):
        # The files' diagonal goes from the north-west to the south-east; it is 500 m wide along both axes.
        assert abs(eye[0] + eye[1] + metres * (ahead[0] + ahead[1])) < 500.0
    assert imported_of(terrain.adaptive_terrain).raster == ((30, 30) if quick else (450, 450))


def test_the_view_across_is_over_the_shaped_land(terrain, capfd, monkeypatch):
    source, note, fields = terrain.adaptive_terrain.store, "The view was composed for the unshaped land", []
    ground_of = viewpoint._ground_of
    monkeypatch.setattr(viewpoint, "_ground_of", lambda field, *more: fields.append(field) or ground_of(field, *more))

    def set_up() -> str:
        """Return the report of Set Up Scene."""
        capfd.readouterr()
        assert SET_UP.set_up_scene(view="ACROSS") == {"FINISHED"}
        return capfd.readouterr().out

    assert note not in set_up(), "there is no stack"
    add("scree", scree_angle=0.4)
    session.clear()
    assert note in set_up(), "it was never updated"
    session.update_object(terrain)
    assert note in set_up(), "a preview is shown"
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    shaped = shaped_land.store_of(terrain)
    session.clear()
    assert shaped_land.store_of(terrain) == source != shaped, "no update has shown the shaped land"
    assert note not in set_up()
    assert [str(field.path) for field in fields] == [source, source, source, shaped]
    terrain.adaptive_terrain.land.entries[0].on = False
    assert note not in set_up() and str(fields[-1].path) == source


def test_a_script_may_keep_the_camera_of_the_scene(factory, add_terrain, monkeypatch):
    """No viewport is open. By default the camera then looks across the terrain."""
    monkeypatch.setattr(viewpoint, "viewport_of", lambda _context: None)
    add_terrain()
    camera = bpy.data.objects.new("Mine", bpy.data.cameras.new("Mine"))
    factory.collection.objects.link(camera)
    camera.location, factory.camera = (10.0, 20.0, 3000.0), camera
    bpy.context.view_layer.update()
    assert SET_UP.set_up_scene(view="CURRENT") == {"FINISHED"}
    assert factory.camera == camera and tuple(camera.location) == (10.0, 20.0, 3000.0)
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert factory.camera != camera or tuple(camera.location) != (10.0, 20.0, 3000.0)
