# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of a scatter that follow from its collection, and the size of instances in the world."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.scatter import fitting
from adaptive_terrain.operators.scatter.instancing import MODIFIER, collection_of, set_collection
from adaptive_terrain.operators.scatter.operators import on_load
from adaptive_terrain.operators.scatter.panel import ScatterPanel, size_lines
from adaptive_terrain.operators.session import session
from mathutils import Euler
from rasterio import Affine
from rasters import write_raster

LAND_M = 1280.0  # side of the fixture's land


def block(name, size, scale=1.0):
    """Return an object with a box of `size` metres in the world on its origin, with its own scale."""
    x, y, z = np.array(size) / scale
    mesh = bpy.data.meshes.new(name)
    corners = [(i * x / 2, j * y / 2, k * z) for i in (-1, 1) for j in (-1, 1) for k in (0, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    obj = bpy.data.objects.new(name, mesh)
    obj.scale = (scale,) * 3
    return obj


def collection(*objects, children=()):
    found = bpy.data.collections.new("Things")
    for obj in objects:
        found.objects.link(obj)
    for child in children:
        found.children.link(child)
    return found


def numbers(scatter):
    settings = scatter.adaptive_scatter
    return settings.spacing, settings.full_until, settings.size, settings.margin_m


def test_spacing_follows_from_the_widest_object(scatter):
    trees = collection(block("Fir", (4.0, 5.0, 18.0)), block("Oak", (8.0, 6.0, 12.0), scale=0.01))
    scatter.adaptive_scatter.collection = trees
    assert numbers(scatter) == pytest.approx((8.0, 800.0, 1.0, 36.0))
    assert collection_of(scatter) == trees
    scatter.adaptive_scatter.collection = collection(block("Pine", (3.0, 3.0, 20.0)))
    assert numbers(scatter) == pytest.approx((3.0, 300.0, 1.0, 40.0))


def test_a_child_collection_is_one_instance(scatter):
    trunk, crown = block("Trunk", (1.0, 1.0, 4.0)), block("Crown", (6.0, 6.0, 5.0))
    crown.location = (0.0, 0.0, 4.0)
    scatter.adaptive_scatter.collection = collection(children=[collection(trunk, crown)])
    assert numbers(scatter) == pytest.approx((6.0, 600.0, 1.0, 18.0))


def test_changed_numbers_stay_when_a_collection_is_chosen(scatter):
    scatter.adaptive_scatter.spacing, scatter.adaptive_scatter.size = 30.0, 2.0
    scatter.adaptive_scatter.collection = collection(block("Fir", (4.0, 4.0, 18.0)))
    assert numbers(scatter) == pytest.approx((30.0, 400.0, 2.0, 36.0))


def test_the_land_limits_the_number_of_instances(scatter, terrain, monkeypatch):
    monkeypatch.setattr(fitting, "MAX_ON_LAND", 10_000)
    scatter.adaptive_scatter.collection = collection(block("Grass", (0.5, 0.5, 0.4)))
    assert numbers(scatter)[0] == pytest.approx(13.0)  # 1,280 m / 100, rounded up
    count = round((LAND_M / 13.0) ** 2)
    assert size_lines(scatter.adaptive_scatter, terrain) == [
        "Up to 0.5 m wide, 0.4 m high",
        f"{count:,} on all the land",
    ]


def test_holes_do_not_count_as_land(terrain, tmp_path):
    """A new scatter of a small island in a large hole has as many points as one of land without holes."""
    row, column = np.mgrid[0:401, 0:401]
    island = (abs(row - 300) <= 20) & (abs(column - 50) <= 20)
    raster = np.where(island, np.float32(5.0), np.float32(np.nan))
    write_raster(tmp_path / "land.tif", raster, transform=Affine(10.0, 0.0, 0.0, 0.0, -10.0, 4010.0), nodata=np.nan)
    run_import(ImportSettings(str(tmp_path / "land.tif"), holes=True), tmp_path / "store")
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    assert bpy.ops.adaptive_terrain.scatter_add() == {"FINISHED"}
    spacing = bpy.context.object.adaptive_scatter.spacing
    assert 30_000 < (400.0 / spacing) ** 2 < 80_000
    area = 41 * 41 / 401**2 * 4000.0**2  # of the island, in cells of samples
    assert fitting.count_on_land(terrain, 2.0) == pytest.approx(area / 4.0, abs=1.0)


@pytest.mark.parametrize("things", [(), ("EMPTY",), ("LIGHT",)])
def test_a_collection_without_extent_changes_nothing(scatter, things):
    before = numbers(scatter)
    data = {"EMPTY": lambda: None, "LIGHT": lambda: bpy.data.lights.new("Lamp", "SUN")}
    scatter.adaptive_scatter.collection = collection(*(bpy.data.objects.new(name, data[name]()) for name in things))
    assert numbers(scatter) == before
    scatter.adaptive_scatter.collection = None
    assert numbers(scatter) == before and collection_of(scatter) is None


def corners_of_instances(scatter, mesh):
    """Return the corners of each instance of a mesh in the world, about its own mean, [n, corners, 3]."""
    corners = np.array([vertex.co for vertex in mesh.vertices])
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = []
    for item in depsgraph.object_instances:
        if item.is_instance and item.parent and item.parent.original == scatter:
            matrix = np.array(item.matrix_world)
            found.append(corners @ matrix[:3, :3].T)
    return np.array(found)


@pytest.mark.parametrize("align", [0.0, 1.0], ids=["upright", "aligned"])
@pytest.mark.parametrize(
    ("scale", "turn"),
    [((1, 1, 1), (0, 0, 0)), ((0.02,) * 3, (0, 0, 0.7)), ((30, 30, 30), (0.4, 0.3, 2)), ((2, 0.5, 3), (0.2, 0.1, 1))],
)
def test_instances_keep_their_size_in_the_world(scene, terrain, scatter, scale, turn, align):
    """The edges of a box have its lengths and right angles, under any scale and turn of the terrain."""
    terrain.scale, terrain.rotation_euler = scale, Euler(turn)
    scene.camera.location *= max(scale)
    bpy.context.view_layer.update()
    settings = scatter.adaptive_scatter
    tree = block("Fir", (4.0, 5.0, 18.0), scale=0.01)
    settings.collection, settings.spacing, settings.full_until = collection(tree), 40.0, 0.0
    settings.variation, settings.align = 0.0, align
    session.update_object(terrain)
    found = corners_of_instances(scatter, tree.data)
    assert len(found) > 30
    edges = found[:, [4, 2, 1]] - found[:, :1]
    lengths = np.linalg.norm(edges, axis=2)
    assert np.abs(lengths / (4.0, 5.0, 18.0) - 1.0).max() < 1e-3
    unit = edges / lengths[..., None]
    assert np.abs(np.einsum("nij,nkj->nik", unit, unit) - np.eye(3)).max() < 1e-3
    if align == 0.0:
        up = np.array(Euler(turn).to_matrix())[:, 2]
        assert (unit[:, 2] @ up).min() > 0.999


def test_spacing_is_in_metres_of_the_world(scene, terrain, scatter):
    terrain.scale = (0.5, 2.0, 1.0)
    bpy.context.view_layer.update()
    scatter.adaptive_scatter.collection = collection(block("Fir", (8.0, 8.0, 18.0)))
    assert numbers(scatter) == pytest.approx((8.0, 800.0, 1.0, 36.0))
    terrain.scale = (0.5, 0.5, 0.5)
    bpy.context.view_layer.update()
    scatter.adaptive_scatter.collection = scatter.adaptive_scatter.collection
    assert numbers(scatter) == pytest.approx((16.0, 800.0, 1.0, 36.0))


def test_instances_follow_a_terrain_that_is_scaled_later(terrain, scatter):
    tree = block("Fir", (4.0, 5.0, 18.0))
    scatter.adaptive_scatter.collection, scatter.adaptive_scatter.variation = collection(tree), 0.0
    session.update_object(terrain)
    terrain.scale = (3.0, 3.0, 3.0)
    bpy.context.view_layer.update()
    found = corners_of_instances(scatter, tree.data)
    heights = np.linalg.norm(found[:, 1] - found[:, 0], axis=1)
    assert heights.max() == pytest.approx(18.0, rel=1e-3)


def test_the_collection_is_the_first_row_of_the_panel(scatter):
    shown = MagicMock()
    context = SimpleNamespace(object=scatter, scene=bpy.context.scene, space_data=None)
    ScatterPanel.draw(SimpleNamespace(layout=shown), context)
    names = [call.args[1] for call in shown.column().prop.call_args_list if len(call.args) > 1]
    assert names[:3] == ["collection", "spacing", "full_until"]


def test_the_panel_shows_collections_of_older_files(scatter):
    trees = collection(block("Fir", (4.0, 4.0, 18.0)))
    set_collection(scatter, trees)
    before = numbers(scatter)
    scatter.adaptive_scatter.fitted = (0.0,) * 4
    on_load("")
    assert scatter.adaptive_scatter.collection == trees and numbers(scatter) == before


def test_a_scatter_without_its_modifier_takes_a_collection(scatter):
    scatter.modifiers.remove(scatter.modifiers[MODIFIER])
    scatter.adaptive_scatter.collection = collection(block("Fir", (4.0, 4.0, 18.0)))
    assert collection_of(scatter) is None and numbers(scatter)[0] == pytest.approx(4.0)
