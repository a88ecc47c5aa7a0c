# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's origin on Earth: terrains of one area fit together, and BlenderGIS reads and writes the same properties."""

import math
import time
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.ground import world_ground
from adaptive_terrain.operators.importing import import_terrain, join_terrains, shared_origin
from adaptive_terrain.operators.importing.imported import imported_of, loaded_text
from adaptive_terrain.operators.importing.panel import ImportedPanel
from adaptive_terrain.operators.terrain import frame_terrain, move_world
from drawn_panels import draw
from modal_runs import RunningOperator, running, turn
from placed_terrains import add, placed
from rasterio.transform import Affine
from rasterio.warp import transform as warp
from rasters import hills, write_raster

pytestmark = pytest.mark.usefixtures("imports_here")


def drawn(panel) -> str:
    """Draw a panel; return its texts as one, with wrapped lines joined."""
    return " ".join(draw(panel).texts)


def world_of(terrain, transform, heights):
    """Return the middles of cells: coordinates by the file, positions in the world, and the file's heights."""
    rows, columns = np.indices(heights.shape).reshape(2, -1)[:, ::37]
    x, y = transform @ (columns + 0.5, rows + 0.5)
    return np.stack([x, y], axis=1), heights[rows, columns]


def check_places(scene, terrain, transform, heights, tolerance=0.01):
    """Check that the ground has the file's heights at the file's coordinates, by the scene's origin in metres."""
    coordinates, expected = world_of(terrain, transform, heights)
    metres = scene.get("crs metres", (1.0, 1.0))
    places = (coordinates - (scene["crs x"], scene["crs y"])) * metres
    inside = slice(1, None)
    ground = world_ground.ground_of(terrain, bpy.context.evaluated_depsgraph_get())
    found = world_ground.find_below([ground], places[inside]).heights
    known = np.isfinite(found)
    assert known.mean() > 0.8
    slope = 40.0  # the steepest climb of these hills in metres a metre
    assert np.abs(found - expected[inside])[known].max() < slope * tolerance


@pytest.mark.parametrize(
    ("crs", "first", "second"),
    [
        ("EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), Affine(10, 0, 6e5 + 390, 0, -10, 5.2e6 - 7.5)),
        ("EPSG:4326", Affine(1 / 1200, 0, 10, 0, -1 / 1200, 47), Affine(1 / 1200, 0, 10.03, 0, -1 / 1200, 46)),
        ("EPSG:2263", Affine(30, 0, 9.8e5, 0, -30, 2e5), Affine(30, 0, 9.8e5 + 1200, 0, -30, 2e5)),
        (
            "EPSG:32632",
            Affine(10, 0, 6e5, 0, -10, 5.2e6),
            Affine.translation(6e5, 5.2e6) @ Affine.rotation(20) @ Affine.scale(10, -10),
        ),
    ],
)
def test_a_second_raster_lands_beside_the_first(saved, monkeypatch, crs, first, second):
    scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    west, east = placed(path, crs, first, "west"), placed(path, crs, second, "east", hills(seed=4))
    assert list(west.location) == [0.0, 0.0, 0.0] and scene["SRID"] == crs
    assert any(east.location)
    check_places(scene, west, first, hills())
    check_places(scene, east, second, hills(seed=4), 0.02)


def test_a_scene_of_blendergis_places_the_first_raster(saved):
    scene, path = saved
    scene["SRID"], scene["crs x"], scene["crs y"] = "32632", 6e5, 5.2e6  # also without EPSG:
    terrain = placed(path, "EPSG:32632", Affine(10, 0, 6e5 + 1000, 0, -10, 5.2e6), "a")
    assert list(terrain.location) == [1200.0, -150.0, 0.0]
    assert (scene["crs x"], scene["crs y"]) == (6e5, 5.2e6)


def test_another_system_is_placed_by_its_middle(saved):
    scene, path = saved
    add(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "a")
    assert (scene["SRID"], scene["crs x"], scene["crs y"]) == ("EPSG:32632", 6e5 + 200, 5.2e6 - 150)
    (longitude,), (latitude,) = warp("EPSG:32632", "EPSG:4326", [6e5 + 200], [5.2e6 - 150])
    assert (scene["longitude"], scene["latitude"]) == pytest.approx((longitude, latitude), abs=1e-9)
    assert "crs metres" not in scene, "the properties of BlenderGIS alone"
    (x,), (y,) = warp("EPSG:32632", "EPSG:32633", [6e5 + 200 + 3000], [5.2e6 - 150 - 1000])
    terrain = add(path, "EPSG:32633", Affine(10, 0, x - 200, 0, -10, y + 150), "b")
    assert list(terrain.location[:2]) == pytest.approx([3000.0, -1000.0], abs=1e-2)
    [note] = shared_origin._place_by_anchor(
        terrain, shared_origin.origin_of(scene), imported_of(terrain.adaptive_terrain)
    )
    assert "only the terrain's origin is in the right place" in note
    assert "To place all of it exactly, import it with the scene's system as Reproject." in note
    assert note in drawn(ImportedPanel), "as long as it is true"
    terrain.adaptive_terrain.project = "EPSG:32632"
    bpy.ops.adaptive_terrain.import_source()
    middle = [terrain["crs x"] - (6e5 + 200), terrain["crs y"] - (5.2e6 - 150)]
    assert list(terrain.location[:2]) == pytest.approx(middle, abs=1e-2)
    assert terrain.name + " is in" not in drawn(ImportedPanel)


def test_a_scene_in_degrees_takes_over_metres(saved):
    """The note recommends it. The terrain in metres then moves to its exact place."""
    scene, path = saved
    first = add(path, "EPSG:4326", Affine(1e-4, 0, 10.0, 0, -1e-4, 46.0), "a")
    (x,), (y,) = warp("EPSG:4326", "EPSG:32632", [10.05], [46.03])
    corner = Affine(10, 0, x, 0, -10, y)
    second = add(path, "EPSG:32632", corner, "b", hills(seed=4))
    assert "import the terrains in degrees again with utm as Reproject" in drawn(ImportedPanel)
    bpy.context.view_layer.objects.active = first
    first.adaptive_terrain.project = "utm"
    bpy.ops.adaptive_terrain.import_source()
    assert scene["SRID"] == "EPSG:32632"
    bpy.context.view_layer.update()
    check_places(scene, second, corner, hills(seed=4))


def test_warnings_of_a_place_are_reported_last(saved, monkeypatch):
    _scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    import_at(path, 6e5, "a")
    report = Mock()
    import_at(path, 6e5, "b", "EPSG:32633", report)
    level, text = report.call_args.args
    assert level == {"WARNING"} and "only the terrain's origin" in text


def test_a_reprojected_only_terrain_takes_the_origin_along(saved):
    """The warning about degrees recommends it: the next file in UTM is then in the scene's system."""
    scene, path = saved
    terrain = add(path, "EPSG:4326", Affine(1e-4, 0, 10.0, 0, -1e-4, 46.0), "a")
    assert scene["SRID"] == "EPSG:4326"
    terrain.adaptive_terrain.project = "EPSG:32632"
    bpy.ops.adaptive_terrain.import_source()
    (x,), (y,) = warp("EPSG:4326", "EPSG:32632", [10.0 + 20e-4], [46.0 - 15e-4])
    assert (scene["SRID"], scene["crs x"], scene["crs y"]) == ("EPSG:32632", pytest.approx(x), pytest.approx(y))
    assert (scene["longitude"], scene["latitude"]) == pytest.approx((10.0 + 20e-4, 46.0 - 15e-4), abs=1e-9)
    assert "crs metres" not in scene
    middle = [terrain["crs x"] - x, terrain["crs y"] - y]
    assert terrain.location[:2] == pytest.approx(middle, abs=1e-3)
    other = add(path, "EPSG:32632", Affine(10, 0, x + 5000, 0, -10, y), "b")
    assert list(other.location[:2]) == pytest.approx([5200.0, -150.0], abs=1e-2)
    other.adaptive_terrain.project = "EPSG:32633"
    bpy.ops.adaptive_terrain.import_source()
    assert scene["SRID"] == "EPSG:32632", "another terrain has coordinates in it"


def test_a_terrain_that_was_moved_stays(saved):
    scene, path = saved
    first = add(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "a")
    first.location = (77.0, 0.0, 0.0)
    settings = first.adaptive_terrain
    settings.holes = True
    bpy.ops.adaptive_terrain.import_source()
    assert list(first.location) == [77.0, 0.0, 0.0]


def test_an_unplaced_scene_keeps_unplaced_terrains(saved):
    scene, path = saved
    terrain = placed(path, None, Affine.identity(), "a")
    assert "SRID" not in scene and list(terrain.location) == [0.0, 0.0, 0.0]


def test_join_makes_one_terrain_without_a_gap(saved):
    """Tiles whose cells meet edge to edge: ground between their outermost samples is interpolated from both."""
    scene, path = saved
    heights = hills(80, 30)
    west = add(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "west", heights[:, :40])
    east = add(path, "EPSG:32632", Affine(10, 0, 6e5 + 400, 0, -10, 5.2e6), "east", heights[:, 40:])
    rock = bpy.data.objects.new("Rock", None)
    scene.collection.objects.link(rock)
    rock.parent = east
    bpy.context.view_layer.update()
    stood = rock.matrix_world.copy()
    between = np.array([[200.0, 5.0, 0.0]])  # row 14, in the open cell
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert np.isnan(world_ground.find_below(world_ground.grounds_of(scene, depsgraph), between).heights[0])
    west.select_set(True)
    bpy.context.view_layer.objects.active = west
    assert bpy.ops.adaptive_terrain.join() == {"FINISHED"}
    assert [obj for obj in scene.objects if obj.adaptive_terrain.enabled] == [west]
    assert list(west.location) == [200.0, 0.0, 0.0], "the middle of both, where the ground stays"
    assert imported_of(west.adaptive_terrain).raster == (80, 30)
    bpy.context.view_layer.update()
    ground = world_ground.ground_of(west, bpy.context.evaluated_depsgraph_get())
    found = world_ground.find_below([ground], between).heights[0]
    assert found == pytest.approx(heights[14, 39:41].mean(), abs=1e-3)
    assert rock.parent == west and (rock.matrix_world.translation - stood.translation).length < 1e-4
    check_places(scene, west, Affine(10, 0, 6e5, 0, -10, 5.2e6), heights)


def test_a_join_beside_the_window_shows_no_first_picture(saved, monkeypatch):
    """The other terrains are removed, so the import has to be complete by then."""
    scene, path = saved
    monkeypatch.setattr(import_terrain, "QUICK_SAMPLES", 60)
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.importing.import_process.ImportJob", ImportJob)
    west = add(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "west", hills(40, 30))
    east = add(path, "EPSG:32632", Affine(10, 0, 6e5 + 400, 0, -10, 5.2e6), "east", hills(40, 30))
    monkeypatch.setattr(join_terrains, "others_of", lambda _context: [east])
    operator = running(join_terrains.JoinTerrains, west)
    while turn(operator) == {"PASS_THROUGH"}:
        assert not loaded_text(west.adaptive_terrain) and len(scene.objects) >= 2
        time.sleep(0.01)
    assert imported_of(west.adaptive_terrain).raster == (80, 30) and imported_of(west.adaptive_terrain).loaded_m is None


def test_a_failed_join_changes_nothing(saved):
    scene, path = saved
    first = add(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "a")
    second = add(path, None, Affine.identity(), "b")
    first.select_set(True)
    bpy.context.view_layer.objects.active = first
    before = first.adaptive_terrain.source_path
    with pytest.raises(RuntimeError):
        bpy.ops.adaptive_terrain.join()
    assert first.adaptive_terrain.source_path == before and not len(first.adaptive_terrain.more_sources)
    assert second.name in scene.objects and math.isclose(first.location.x, 0.0)


@pytest.mark.parametrize("is_moved", [False, True])
def test_ground_stays_where_it_is_when_a_raster_grows(saved, is_moved):
    """A terrain 500 km away, turned and scaled by the user, and one at its coordinates; both have a child."""
    scene, path = saved
    heights, corner = hills(80, 30), Affine(10, 0, 6e5, 0, -10, 5.2e6)
    terrain = placed(path, "EPSG:32632", corner, "west", heights[:, :40])
    if is_moved:
        terrain.location, terrain.rotation_euler = (5e5, 3e5, 7.0), (0.0, 0.0, 0.6)
        terrain.scale = (2.0, 2.0, 1.5)
    rock = bpy.data.objects.new("Rock", None)
    scene.collection.objects.link(rock)
    rock.parent, rock.location = terrain, (50.0, 20.0, 300.0)
    bpy.context.view_layer.update()
    stood = rock.matrix_world.translation.copy()
    local = np.array([(x, y, 0.0, 1.0) for x in np.linspace(-180, 180, 9) for y in np.linspace(-130, 130, 7)])
    world = (local @ np.array(terrain.matrix_world).T)[:, :3]

    def ground():
        bpy.context.view_layer.update()
        found = world_ground.ground_of(terrain, bpy.context.evaluated_depsgraph_get())
        return world_ground.find_below([found], world).heights

    before = ground()
    operator = RunningOperator(operator_class=import_terrain.ImportTerrain, report=Mock())
    operator.before = imported_of(terrain.adaptive_terrain)
    both = write_raster(path / "both.tif", heights, crs="EPSG:32632", transform=corner)
    for _ in range(2):  # a first picture, and the complete store
        report = run_import(ImportSettings(str(both)), path / "both")
        operator.finish(bpy.context, terrain, (report, str(path / "both")))
    assert imported_of(terrain.adaptive_terrain).raster == (80, 30)
    assert np.abs(ground() - before).max() < 0.5, "float32 has steps of 3 cm at 500 km, and this ground is steep"
    assert (rock.matrix_world.translation - stood).length < 0.1
    assert not is_moved or terrain.location.x > 5e5


def test_a_raster_elsewhere_leaves_a_moved_terrain_alone(saved):
    scene, path = saved
    terrain = placed(path, "EPSG:32632", Affine(10, 0, 6e5, 0, -10, 5.2e6), "a")
    terrain.location.x = 77.0
    operator = RunningOperator(operator_class=import_terrain.ImportTerrain, report=Mock())
    operator.before = imported_of(terrain.adaptive_terrain)
    far = write_raster(path / "far.tif", hills(), crs="EPSG:32632", transform=Affine(10, 0, 7e5, 0, -10, 5.2e6))
    operator.finish(bpy.context, terrain, (run_import(ImportSettings(str(far)), path / "far"), str(path / "far")))
    assert list(terrain.location) == [77.0, 0.0, 0.0]


def import_at(path, x, name, crs="EPSG:32632", report=None):
    """Import a file of 400 x 300 m in this process, and end as the operator does for a new terrain; return it."""
    file = write_raster(path / f"{name}.tif", hills(), crs=crs, transform=Affine(10, 0, x, 0, -10, 5.2e6))
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    obj.adaptive_terrain.enabled, obj.adaptive_terrain.live = True, False
    operator = RunningOperator(operator_class=import_terrain.ImportTerrain, report=report or Mock(), before=None)
    operator.finish(bpy.context, obj, (run_import(ImportSettings(str(file)), path / name), str(path / name)))
    return obj


def test_land_elsewhere_gets_a_new_origin_after_all_is_deleted(saved, monkeypatch):
    scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    first = import_at(path, 6e5, "a")
    second = import_at(path, 7e5, "b")
    assert second.location.x == 1e5 and scene["crs x"] == 6e5 + 200, "beside the first"
    baked = first.copy()
    baked.property_unset("adaptive_terrain")
    scene.collection.objects.link(baked)
    bpy.data.batch_remove([first, second])
    third = import_at(path, 7e5, "c")
    assert third.location.x == 1e5, "a baked mesh is left in its place"
    bpy.data.batch_remove([baked, third])
    fourth = import_at(path, 7e5, "d")
    assert list(fourth.location) == [0.0, 0.0, 0.0] and scene["crs x"] == 7e5 + 200


@pytest.mark.parametrize("is_other", [False, True])
def test_an_origin_stays_on_its_land_or_if_it_is_not_ours(saved, monkeypatch, is_other):
    scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    bpy.data.objects.remove(import_at(path, 6e5, "a"))
    if is_other:
        scene["crs x"] = 6e5  # as another add-on writes it
    before, shift = scene["crs x"], 1e5 if is_other else 150.0
    again = import_at(path, 6e5 + shift, "b")
    assert scene["crs x"] == before and again.location.x == 6e5 + shift + 200 - before


def test_a_moved_origin_is_still_ours(saved, monkeypatch):
    scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    terrain = import_at(path, 6e5, "a")
    move_world.move_world(bpy.context, np.array([-8192.0, 0.0]))
    assert scene["crs x"] == 6e5 + 200 + 8192
    bpy.data.objects.remove(terrain)
    assert list(import_at(path, 7e5, "b").location) == [0.0, 0.0, 0.0]


def test_a_grown_terrain_stays_framed_where_all_of_it_was_seen(saved, monkeypatch):
    """The store of a saved file is in the same folder before and after an import."""
    _scene, path = saved
    monkeypatch.setattr(shared_origin, "reproject_point", lambda *_: (9.0, 47.0))
    monkeypatch.setattr(frame_terrain, "shown_viewports", lambda *_: ["near", "far"])
    boxes, framed = [], []
    monkeypatch.setattr(frame_terrain, "with_all_of", lambda box, _viewports: boxes.append(box) or ["far"])
    monkeypatch.setattr(frame_terrain, "frame_terrain", lambda *given, always: framed.append(given[2]) or [])
    terrain = import_at(path, 6e5, "a")
    assert framed == [["near", "far"]], "new land is shown everywhere"
    terrain.adaptive_terrain.source, terrain.adaptive_terrain.source_path = "FILE", str(path / "a.tif")
    bpy.context.view_layer.objects.active = terrain
    for width in (60, 90, 200):
        write_raster(path / "a.tif", hills(width, 30), crs="EPSG:32632", transform=Affine(10, 0, 6e5, 0, -10, 5.2e6))
        bpy.ops.adaptive_terrain.import_source()
    assert framed == [["near", "far"], ["far"], ["far"], ["near", "far"]], "a view of a part is in use"
    assert [np.ptp(box[:, 0]) for box in boxes] == pytest.approx([390.0, 590.0]), "those of the land before"
