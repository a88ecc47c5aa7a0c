# SPDX-License-Identifier: GPL-3.0-or-later
"""Place at Coordinates, compared with the file's own cells and with PROJ."""

from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.importing import placing
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.operators.ground import known_points
from adaptive_terrain.operators.ground.panel import GroundPanel
from adaptive_terrain.operators.ground.place_at_coordinates import PlaceAtCoordinates
from adaptive_terrain.operators.importing import shared_origin
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.importing.shared_origin import place_terrain
from adaptive_terrain.operators.terrain import move_world
from drawn_panels import DrawnLayout
from finer_imports import make_small
from ground_scenes import ASKEW, added, cube, only
from mathutils import Vector
from modal_runs import RunningOperator
from mosaic_files import sheet
from rasterio.transform import from_origin
from rasterio.warp import transform as warp
from rasters import hills, write_raster

HEIGHTS = hills(80, 60)
SWISS = "EPSG:2056", from_origin(2_599_600, 1_200_300, 10, 10)
CELL = 31, 47  # row and column
PLACE = bpy.ops.adaptive_terrain


@pytest.fixture(autouse=True)
def proj_here(monkeypatch):
    """Let PROJ run in this process, which saves the second that a child takes to start."""
    known_points.reprojected.cache_clear()
    for module in (known_points, shared_origin):
        monkeypatch.setattr(module, "reproject_point", placing._reprojected)


@pytest.fixture
def add_located(scene, add_terrain, tmp_path):
    """Return a function that imports heights with a position on Earth and places the terrain as an import does."""

    def add(name="Alps", crs=SWISS[0], transform=SWISS[1], heights=HEIGHTS, **options):
        file = write_raster(tmp_path / f"{name}.tif", heights, crs=crs, transform=transform, **options)
        run_import(ImportSettings(str(file), holes="nodata" in options), tmp_path / name)
        obj = add_terrain(name)
        obj.adaptive_terrain.store = str(tmp_path / name)
        place_terrain(obj, bpy.context.scene, imported_of(obj.adaptive_terrain))
        only()
        bpy.context.view_layer.update()
        return obj

    return add


@pytest.fixture
def report(monkeypatch):
    """Return a function that executes the operator and returns its reports by kind."""

    def execute(coordinates, system="AUTOMATIC"):
        operator = SimpleNamespace(
            report=Mock(), coordinates=coordinates, system=system, is_chosen=False,
            options=SimpleNamespace(is_invoke=False),
        )  # fmt: skip
        operator.ended = PlaceAtCoordinates.execute(operator, bpy.context)
        bpy.context.view_layer.update()
        return {next(iter(call.args[0])): call.args[1] for call in operator.report.call_args_list}

    return execute


def cell_of(transform, row=CELL[0], column=CELL[1]) -> tuple[float, float]:
    """Return the coordinates of the middle of a cell, x and y."""
    return transform @ (column + 0.5, row + 0.5)


def local_of(row=CELL[0], column=CELL[1], step=10.0, heights=HEIGHTS) -> Vector:
    """Return the middle of a cell in the space of a terrain whose origin is the raster's middle."""
    rows, columns = heights.shape
    x, y = (column - (columns - 1) / 2) * step, ((rows - 1) / 2 - row) * step
    return Vector((x, y, float(heights[row, column])))


def test_the_cursor_goes_to_east_and_north(add_located, report):
    add_located()
    x, y = cell_of(SWISS[1])
    for text in (f"{x} {y}", f"{x:,.2f}, {y:,.2f}", f"{y} N {x} E"):
        bpy.context.scene.cursor.location = (0.0, 0.0, -9.0)
        assert report(text) == {"INFO": f"3D cursor: E {x:,.2f}, N {y:,.2f}, height {HEIGHTS[CELL]:,.2f} m"}
        assert (bpy.context.scene.cursor.location - local_of()).length < 0.01


@pytest.mark.parametrize("form", ["{}, {}", "{:.9f}° N {:.9f}° E", "lat {} lon {}"])
def test_the_cursor_goes_to_latitude_and_longitude(add_located, report, form):
    add_located()
    (longitude,), (latitude,) = warp(SWISS[0], "EPSG:4326", *([value] for value in cell_of(SWISS[1])))
    assert "E 2,600,075.00, N 1,199,985.00" in report(form.format(latitude, longitude))["INFO"]
    assert (bpy.context.scene.cursor.location - local_of()).length < 0.01


def test_a_child_process_converts_degrees_once(add_located, report, monkeypatch):
    """PROJ is not loaded in Blender; two terrains of one system share the answer."""
    add_located(), add_located("Other")
    convert = Mock(side_effect=placing.reproject_point)
    monkeypatch.setattr(known_points, "reproject_point", convert)
    (longitude,), (latitude,) = warp(SWISS[0], "EPSG:4326", *([value] for value in cell_of(SWISS[1])))
    assert "E 2,600,075.00, N 1,199,985.00" in report(f"{latitude}, {longitude}")["INFO"]
    assert convert.call_count == 1


def test_a_moved_turned_tilted_and_scaled_terrain(add_located, report):
    terrain = add_located()
    terrain.matrix_world = ASKEW
    terrain.adaptive_terrain.vertical_scale, terrain.adaptive_terrain.vertical_offset = 1.5, 10.0
    bpy.context.view_layer.update()
    local = local_of()
    local.z = local.z * 1.5 + 10.0
    text = report("{} {}".format(*cell_of(SWISS[1])))["INFO"]
    assert f"height {HEIGHTS[CELL]:,.2f} m" in text, "the height of the map, not of the exaggerated ground"
    assert (bpy.context.scene.cursor.location - ASKEW @ local).length < 0.01


def test_a_terrain_with_another_origin(add_located, report):
    """As Move World Here leaves it: the ground is where it was."""
    terrain = add_located()
    terrain.rotation_euler.z = 0.5
    bpy.context.view_layer.update()
    expected = terrain.matrix_world @ local_of()
    move_world.set_anchor(terrain, 160.0, -120.0)
    bpy.context.view_layer.update()
    assert terrain.location.xy.length > 150.0 and terrain.adaptive_terrain.anchor[:] == (160.0, -120.0)
    assert "INFO" in report("{} {}".format(*cell_of(SWISS[1])))
    assert (bpy.context.scene.cursor.location - expected).length < 0.01


def test_a_second_terrain_far_away(add_located, report):
    """Both have the scene's origin; the coordinates choose the terrain."""
    far = from_origin(2_719_600, 1_150_300, 10, 10)
    add_located(), add_located("Far", transform=far, heights=HEIGHTS + 1000.0)
    assert f"height {HEIGHTS[CELL] + 1000:,.2f} m" in report("{} {}".format(*cell_of(far)))["INFO"]
    expected = local_of() + Vector((120_000.0, -50_000.0, 1000.0))
    assert (bpy.context.scene.cursor.location - expected).length < 0.02
    report("{} {}".format(*cell_of(SWISS[1])))
    assert (bpy.context.scene.cursor.location - local_of()).length < 0.01
    longitude, latitude = (value[0] for value in warp(SWISS[0], "EPSG:4326", *([v] for v in cell_of(far))))
    report(f"{latitude} {longitude}")
    assert (bpy.context.scene.cursor.location - expected).length < 0.02


def test_a_selected_terrain_is_the_only_one(add_located, report):
    first = add_located()
    add_located("Higher", heights=HEIGHTS + 50.0)
    text = "{} {}".format(*cell_of(SWISS[1]))
    assert f"height {HEIGHTS[CELL] + 50:,.2f} m" in report(text)["INFO"]
    only(first)
    assert f"height {HEIGHTS[CELL]:,.2f} m" in report(text)["INFO"]
    assert first.location[:] == (0.0, 0.0, 0.0), "a terrain never moves"


def test_selected_objects_move_together(add_located, report):
    add_located()
    parent = added(
        bpy.data.objects.new("Parent", None), (5.0, 5.0, 5.0), rotation_euler=(0.3, 0.2, 0.1), scale=(2, 3, 4)
    )
    rock, tree = cube("Rock", (1.0, 2.0, 3.0)), cube("Tree", (4.0, 6.0, 8.0), rotation_euler=(0.0, 0.0, 1.0))
    rock.parent = parent
    leaf = cube("Leaf", (0.5, 0.5, 0.5))
    leaf.parent = tree
    only(rock, tree, leaf)
    before = {obj.name: obj.matrix_world.translation.copy() for obj in (rock, tree, leaf)}
    text = report("{} {}".format(*cell_of(SWISS[1])))["INFO"]
    assert text.startswith("Rock + 2: E 2,600,075.00")
    assert (rock.matrix_world.translation - local_of()).length < 0.01
    by = rock.matrix_world.translation - before["Rock"]
    for obj in (tree, leaf):
        assert (obj.matrix_world.translation - before[obj.name] - by).length < 1e-3
    assert parent.location[:] == (5.0, 5.0, 5.0) and leaf.location[:] == (0.5, 0.5, 0.5)
    assert bpy.context.scene.cursor.location[:] == (0.0, 0.0, 0.0)


def test_nothing_moves_if_one_object_cannot(add_located, report):
    add_located()
    rock, tree = cube("Rock", (1.0, 2.0, 3.0)), cube("Tree", (4.0, 6.0, 8.0))
    only(rock, tree)
    tree.lock_location[1] = True
    assert "'Tree' has locked transforms" in report("{} {}".format(*cell_of(SWISS[1])))["ERROR"]
    tree.lock_location[1] = False
    tree.keyframe_insert("location", frame=1)
    assert "'Tree' is animated" in report("{} {}".format(*cell_of(SWISS[1])))["ERROR"]
    assert rock.location[:] == (1.0, 2.0, 3.0)


def test_a_constraint_that_holds_the_object_is_reported(add_located, report):
    add_located()
    rock = cube("Rock", (1.0, 2.0, 3.0))
    only(rock)
    limit = rock.constraints.new("LIMIT_LOCATION")
    limit.use_max_z, limit.max_z = True, 5.0
    told = report("{} {}".format(*cell_of(SWISS[1])))
    assert told["WARNING"].startswith("Rock is ") and "mute the constraint" in told["WARNING"]


def test_a_kept_object_stays_on_the_ground(add_located, report):
    add_located()
    rock = cube("Rock", (1.0, 2.0, 3.0))
    only(rock)
    assert PLACE.drop_to_ground(keep=True, anchor="ORIGIN", offset=2.0) == {"FINISHED"}
    report("{} {}".format(*cell_of(SWISS[1])))
    assert (rock.matrix_world.translation - local_of() - Vector((0.0, 0.0, 2.0))).length < 0.01


def test_a_terrain_in_degrees(add_located, report):
    """Its own degrees are used without PROJ, and longitudes may count from 0 to 360."""
    transform = from_origin(189.9, -16.7, 1e-4, 1e-4)
    terrain = add_located("Samoa", "EPSG:4326", transform)
    x, y = cell_of(transform)
    for text in (f"{y} {x - 360.0}", f"{y}, {x}", f"{x - 360.0}° E {-y}° S"):
        bpy.context.scene.cursor.location = (0.0, 0.0, 0.0)
        told = report(text)["INFO"]
        assert f"{-y:.6f}° S, {360.0 - x:.6f}° W, height {HEIGHTS[CELL]:,.2f} m" in told
        place = known_points.from_crs(imported_of(terrain.adaptive_terrain).place, np.array([[x, y]]))[0]
        assert np.abs(np.array(bpy.context.scene.cursor.location[:2]) - place).max() < 0.01


def test_a_copied_report_of_pick_leads_back(add_located, report):
    add_located()
    told = report("{} {}".format(*cell_of(SWISS[1])))["INFO"]
    first = bpy.context.scene.cursor.location.copy()
    bpy.context.scene.cursor.location = (0.0, 0.0, 0.0)
    report(told.partition(": ")[2].partition(", height")[0])
    assert (bpy.context.scene.cursor.location - first).length < 1e-6


def test_small_numbers_of_a_local_system_need_its_choice(add_located, report):
    local = from_origin(-40, 30, 1, 1)
    add_located("Yard", "EPSG:2056", local)
    x, y = cell_of(local)
    assert "outside of the terrain" in report(f"{x} {y}")["ERROR"]
    assert "INFO" in report(f"{x} {y}", "TERRAIN") and "INFO" in report(f"E {x}, N {y}")


def test_errors_say_what_to_do(add_located, add_terrain, report, monkeypatch):
    plain = add_terrain("Plain")
    only()
    assert "No terrain here has a coordinate system" in report("1 2")["ERROR"]
    bpy.data.objects.remove(plain)
    add_located()
    cursor = bpy.context.scene.cursor
    for text, expected in (
        ("here", "'here' cannot be read as coordinates"),
        ("2700000 1200000", "E 2,700,000.00, N 1,200,000.00 is 99.6 km outside of the terrain"),
        ("1200000 2600000", "outside of the terrain: exchange the two numbers"),
        ("7.44, 46.95", "outside of the terrain: exchange the two numbers"),
        ("95° N, 10° E", "Latitude 95 and longitude 10 are not on Earth"),
    ):
        assert expected in report(text)["ERROR"] and cursor.location[:] == (0.0, 0.0, 0.0), text
    known_points.reprojected.cache_clear()
    monkeypatch.setattr(known_points, "reproject_point", Mock(side_effect=TerrainError("PROJ is missing")))
    assert report("46.95 7.44")["ERROR"] == (
        "Latitude and longitude cannot be converted to EPSG:2056. PROJ is missing: enter east and north of that system."
    )
    assert "INFO" in report("{} {}".format(*cell_of(SWISS[1]))), "east and north need no PROJ"


def test_a_hole_is_named(add_located, report):
    heights = HEIGHTS.copy()
    heights[28:36, 44:52] = -9999.0
    add_located(heights=heights, nodata=-9999.0)
    assert "The terrain has a hole at E 2,600,075.00" in report("{} {}".format(*cell_of(SWISS[1])))["ERROR"]


def test_a_click_asks_and_waits_for_kernels(add_located, monkeypatch):
    add_located()
    answers, asked = iter([False, False, True]), Mock(return_value={"RUNNING_MODAL"})
    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: next(answers))
    again = Mock(return_value={"RUNNING_MODAL"})
    monkeypatch.setattr("adaptive_terrain.operators.ground.place_at_coordinates.invoke_with_file", again)
    operator = RunningOperator(
        operator_class=PlaceAtCoordinates, report=Mock(), coordinates="{} {}".format(*cell_of(SWISS[1])),
        system="AUTOMATIC", is_chosen=False, options=SimpleNamespace(is_invoke=True),
    )  # fmt: skip
    context = SimpleNamespace(
        window_manager=SimpleNamespace(invoke_props_dialog=asked), object=None, scene=bpy.context.scene,
        selected_objects=[], evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
    )  # fmt: skip
    assert operator.invoke(context, None) == {"RUNNING_MODAL"} and asked.called
    operator.cancel(context)  # as Blender does when the dialog is closed
    assert operator.execute(context) == {"CANCELLED"} and again.called, "another run waits"
    assert operator.execute(context) == {"FINISHED"} and again.call_count == 1


def test_the_dialog_and_the_panel_name_what_moves(add_located):
    add_located()
    layout = DrawnLayout()
    panel = SimpleNamespace(layout=layout)
    GroundPanel.draw(panel, bpy.context)
    assert "adaptive_terrain.place_at_coordinates" in layout.texts
    for objects, expected in (
        ((), "Moves: 3D Cursor"),
        ((cube("Rock", (0, 0, 0)), cube("Tree", (0, 0, 0))), "Moves: Rock + 1"),
    ):
        only(*objects)
        layout = DrawnLayout()
        PlaceAtCoordinates.draw(SimpleNamespace(layout=layout), bpy.context)
        assert expected in layout.texts


def test_points_in_a_gap_between_files_say_so(add_located, tmp_path, monkeypatch, capfd):
    """Their heights are filled; a point on a file has no such note."""
    make_small(monkeypatch)
    for name, moved in (("a", 0.0), ("b", 12_000.0)):
        sheet("EPSG:2056", 2_599_600 + moved, 1_200_300 - moved, 2.0, 2.0, 300, 200).write(
            tmp_path / f"files/{name}.tif"
        )
    run_mosaic_import(ImportSettings(str(tmp_path / "files")), tmp_path / "gaps")
    obj = add_located()
    obj.adaptive_terrain.store = str(tmp_path / "gaps")
    place_terrain(obj, bpy.context.scene, imported_of(obj.adaptive_terrain))
    for place, expected in (("2599900 1200100", False), ("2606000 1194000", True)):
        assert PLACE.place_at_coordinates(coordinates=place) == {"FINISHED"}
        x, y, z = bpy.context.scene.cursor.location
        assert PLACE.pick_ground(origin=(x, y, z + 100.0)) == {"FINISHED"}
        lines = [
            line for line in capfd.readouterr().out.splitlines() if "2,6" in line or "2,5" in line or "260" in line
        ]
        assert len(lines) == 2 and all(("in a gap between files" in line) == expected for line in lines), lines
