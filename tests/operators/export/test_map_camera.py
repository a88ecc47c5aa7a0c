# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps: every pixel shows the ground that its world file and GeoTIFF name, and tiles fit together."""

import math

import bpy
import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.export import render_map
from adaptive_terrain.operators.export.render_map import RenderMap
from modal_runs import running, to_the_end, turn
from rasterio.transform import Affine
from rasters import hills, write_raster
from store_exports import run

CELLS = 40, 30


@pytest.fixture
def mapped(scene, add_terrain, tmp_path):
    """Add a turned, stretched terrain whose colour is its position: red to the east, green to the north."""
    transform = Affine(30.0, 0, 500_000.0, 0, -20.0, 5_200_000.0)
    write_raster(tmp_path / "in.tif", hills(CELLS[0] + 1, CELLS[1] + 1) / 50, crs="EPSG:32632", transform=transform)
    run_import(ImportSettings(str(tmp_path / "in.tif")), tmp_path / "store")
    obj = add_terrain("Hills")
    obj.adaptive_terrain.store = str(tmp_path / "store")
    obj.location, obj.rotation_euler, obj.scale = (300, -200, 50), (0.0, 0.0, 0.5), (0.7, 1.1, 2.0)
    material = bpy.data.materials.new("Position")
    if bpy.app.version < (5, 0):  # later materials always have nodes
        material.use_nodes = True
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    nodes.clear()
    place, scaled, emission, output = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "VectorMath", "Emission", "OutputMaterial")
    )
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value = 1 / (CELLS[0] * 30), 1 / (CELLS[1] * 20), 0
    scaled.inputs[2].default_value = 0.5, 0.5, 0
    link(place.outputs["Object"], scaled.inputs[0])
    link(scaled.outputs[0], emission.inputs["Color"])
    link(emission.outputs[0], output.inputs["Surface"])
    obj.data.materials.append(material)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.cycles.filter_width = 0.01
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.color_depth = "16"
    bpy.context.view_layer.update()
    return obj


def colours(size):
    """Return the colours that the middles of pixels have, [2, height, width]."""
    x, y = (np.arange(size[0]) + 0.5) / size[0], 1 - (np.arange(size[1]) + 0.5) / size[1]
    return np.stack(np.meshgrid(x, y))


@pytest.mark.parametrize("location", [pytest.param((300, -200, 50), marks=pytest.mark.thorough), (5e5, -3e5, 50)])
def test_a_map_shows_each_cell_where_its_files_say(scene, mapped, tmp_path, location):
    mapped.location = location
    bpy.context.view_layer.update()
    assert bpy.ops.adaptive_terrain.map_camera(pixels=2) == {"FINISHED"}
    assert (scene.render.resolution_x, scene.render.resolution_y) == (80, 60)
    assert bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "map.png")) == {"FINISHED"}
    with rasterio.open(tmp_path / "map.tif") as file:
        found = file.read() / 65535
        assert file.crs.to_epsg() == 32632 and file.shape == (60, 80)
        assert file.transform.almost_equals(Affine(15, 0, 500_015, 0, -10, 5_199_990), precision=1e-6)
    assert abs(found[:2] - colours((80, 60))).max() < 1e-3
    lines = [float(line) for line in (tmp_path / "map.pgw").read_text().split()]
    assert lines == pytest.approx([15, 0, 0, -10, 500_015 + 7.5, 5_199_990 - 5], abs=1e-6)
    with rasterio.open(tmp_path / "map.png") as file:
        assert (file.read() / 65535 == found).all() and file.transform.almost_equals(
            Affine(15, 0, 500_015, 0, -10, 5_199_990), 1e-6
        )


def test_set_up_scene_after_a_map_restores_the_picture_size(scene, mapped):
    """A map of few cells would make the next render tiny; a size that the user has changed since then stays."""
    before = scene.render.resolution_x, scene.render.resolution_y
    for _ in range(2):
        bpy.ops.adaptive_terrain.map_camera()
    assert before != (40, 30) == (scene.render.resolution_x, scene.render.resolution_y)
    bpy.ops.adaptive_terrain.set_up_scene()
    assert (scene.render.resolution_x, scene.render.resolution_y) == before
    assert scene.render.pixel_aspect_x == scene.render.pixel_aspect_y == 1.0
    bpy.ops.adaptive_terrain.map_camera()
    scene.render.resolution_x = 400
    bpy.ops.adaptive_terrain.set_up_scene()
    assert scene.render.resolution_x == 400


def test_tiles_of_a_map_fit_together(scene, mapped, tmp_path):
    """Pixels by metres, 3 x 2 tiles of uneven sizes, as TIFF: the same pixels as in one piece."""
    bpy.ops.adaptive_terrain.map_camera(use_metres=True, metres=13.0)
    size = scene.render.resolution_x, scene.render.resolution_y
    assert size == (92, 46)
    bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "whole.tif"))
    bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "part.tif"), tiles=(3, 2))
    with rasterio.open(tmp_path / "whole.tif") as file:
        whole, corner, pixel = file.read(), file.transform, (file.transform.a, file.transform.e)
    assert abs(whole[:2] / 65535 - colours(size)).max() < 1e-3
    seen = np.zeros(whole.shape[1:], int)
    for path in tmp_path.glob("part_x?_y?.tif"):
        with rasterio.open(path) as file:
            column, row = ~corner @ (file.transform.c, file.transform.f)
            assert (file.transform.a, file.transform.e) == pytest.approx(pixel, rel=1e-12)
            rows, columns = round(row) + np.arange(file.height), round(column) + np.arange(file.width)
            assert (column, row) == pytest.approx((columns[0], rows[0]), abs=1e-6)
            assert (file.read() == whole[:, rows[:, None], columns]).all()
        seen[rows[:, None], columns] += 1
        assert path.with_suffix(".tfw").is_file()
    assert (seen == 1).all()
    assert not scene.render.use_border and scene.render.image_settings.file_format == "PNG"


def test_the_map_sun_shines_from_the_north_west(scene, mapped):
    bpy.ops.adaptive_terrain.map_camera()
    bpy.ops.adaptive_terrain.map_camera()
    [sun] = [obj for obj in scene.objects if obj.type == "LIGHT"]
    bpy.context.view_layer.update()
    shine = np.array(sun.matrix_world)[:3, :3] @ (0, 0, -1)
    turned = np.array([[math.cos(0.5), -math.sin(0.5), 0], [math.sin(0.5), math.cos(0.5), 0], [0, 0, 1]])
    assert turned.T @ shine == pytest.approx([0.5, -0.5, -(0.5**0.5)], abs=1e-6)
    assert [obj.name for obj in scene.objects if obj.type == "CAMERA"] == ["Camera", "Map Camera"]


def test_maps_that_cannot_be_made_are_refused(scene, mapped, tmp_path):
    with pytest.raises(RuntimeError, match="no map camera"):
        bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "map.png"))
    with pytest.raises(RuntimeError, match="at most 65,536"):
        bpy.ops.adaptive_terrain.map_camera(use_metres=True, metres=1e-3)
    bpy.ops.adaptive_terrain.map_camera()
    for name, tiles, why in (("map.gif", (1, 1), "no format for maps"), ("map.png", (99, 1), "fewer tiles")):
        with pytest.raises(RuntimeError, match=why):
            bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / name), tiles=tiles)
    mapped.scale.x = -1
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="mirrored"):
        bpy.ops.adaptive_terrain.map_camera()


@pytest.mark.parametrize(
    "change",
    [*(pytest.param(name, marks=pytest.mark.thorough) for name in ("move", "widen")), "move far out", "stretch"],
)
def test_a_changed_map_camera_renders_no_map(scene, mapped, tmp_path, change):
    if change == "move far out":  # by less than a millionth of its location
        mapped.location = (5e6, 0.0, 0.0)
        bpy.context.view_layer.update()
    bpy.ops.adaptive_terrain.map_camera()
    if change.startswith("move"):
        scene.camera.location.x += 4.0
    elif change == "widen":
        scene.camera.data.ortho_scale *= 1.01
    else:
        scene.render.resolution_x += 1
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="changed: use Map Camera again"):
        bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "map.png"))
    assert not (tmp_path / "map.png").exists()


def test_the_command_renders_the_map_of_a_scene(scene, mapped, tmp_path, capsys):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    argv = "map", "--scene", tmp_path / "shot.blend", "--out", tmp_path / "map.jpg"
    assert run(*argv, "--tiles", "2x1", "--pixels", "3") == 0
    assert "map_x1_y0.jpg" in capsys.readouterr().out
    with rasterio.open(tmp_path / "map_x1_y0.tif") as file:
        assert file.shape == (90, 60) and file.transform.almost_equals(
            Affine(10, 0, 500_615, 0, -20 / 3, 5_199_990), 1e-6
        )


@pytest.mark.parametrize("name", ["in.png", pytest.param("in.tif", marks=pytest.mark.thorough)])
def test_a_map_does_not_replace_its_height_map(scene, mapped, tmp_path, name):
    mapped.adaptive_terrain.source_path = f"/{'n' * 300}.tif"  # no file can have this name
    before = (tmp_path / "in.tif").read_bytes()
    bpy.ops.adaptive_terrain.map_camera()
    with pytest.raises(RuntimeError, match="would replace the height map"):
        bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / name))
    assert (tmp_path / "in.tif").read_bytes() == before and not (tmp_path / "in.png").exists()


@pytest.fixture
def in_window(mapped, tmp_path, monkeypatch):
    """Return a function that starts to render a map of 2 x 1 tiles in a window; the second value lists its renders.

    Blender's thread is replaced: a render is complete when it returns, and lasts until `rendering` is cleared.
    """
    bpy.ops.adaptive_terrain.map_camera()
    start, rendering = render_map._start_render, []

    def render(scene, *how):
        assert how in ((), ("INVOKE_DEFAULT",)) and scene.render.use_border
        start(scene)
        if how:
            rendering.append(scene.render.border_min_x)

    monkeypatch.setattr(render_map, "_start_render", render)
    monkeypatch.setattr(jobs, "is_rendering", lambda: bool(rendering))
    given = {"filepath": str(tmp_path / "map.png"), "is_chosen": True, "tiles": (2, 1), "geotiff": True}
    return lambda **more: running(RenderMap, mapped, **given | more), rendering


def test_a_map_in_a_window_is_that_of_a_script(in_window, tmp_path):
    start, rendering = in_window
    operator = start()
    while not (tmp_path / "map_x1_y0.png").exists():
        assert turn(operator) == {"PASS_THROUGH"}
        assert not bpy.context.scene.render.use_border, "a file that is saved now has the user's settings"
        rendering.clear()
    assert to_the_end(operator) == {"FINISHED"} and not jobs.running
    bpy.ops.adaptive_terrain.render_map(filepath=str(tmp_path / "script.png"), tiles=(2, 1))
    for name in ("x0_y0.tif", "x1_y0.tif"):
        with rasterio.open(tmp_path / f"map_{name}") as ours, rasterio.open(tmp_path / f"script_{name}") as expected:
            assert (ours.read() == expected.read()).all() and ours.transform == expected.transform


def test_a_map_in_a_folder_that_refuses_files_names_the_file(in_window, tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(render_map, "private_folder", refuse)
    operator = in_window[0]()
    assert operator.began == {"CANCELLED"}
    problem = f"{tmp_path / 'map_x0_y0.png'} cannot be written (Permission denied): check the disk, or choose another"
    assert operator.report.call_args.args == ({"ERROR"}, f"{problem} folder.")


@pytest.mark.parametrize("how", ["escape", "blender"])
def test_a_cancelled_map_keeps_complete_pictures(in_window, tmp_path, how):
    """Blender reports that the user has ended its render; Escape in a test's window does not reach it."""
    start, rendering = in_window
    operator = start()
    assert operator.job.text == "Rendering a map: Picture 1 of 2; Esc: cancel"
    rendering.clear()
    while not rendering:  # the second picture
        turn(operator)
    assert operator.job.text == "Rendering a map: Picture 2 of 2; Esc: cancel" and operator.job.fraction == 0.5
    if how == "escape":
        turn(operator, "ESC")
        rendering.clear()
    else:
        for note in list(bpy.app.handlers.render_cancel):
            note(bpy.context.scene, None)
        rendering.clear()
    assert to_the_end(operator) == {"CANCELLED"}
    assert "pictures that are complete stay" in operator.report.call_args.args[1]
    assert {path.name for path in tmp_path.glob("*map*")} == {"map_x0_y0.png", "map_x0_y0.pgw"}
    assert not list(tmp_path.glob(".partial*")) and bpy.context.scene.render.image_settings.file_format == "PNG"


def test_a_removed_scene_ends_its_map(in_window):
    start, rendering = in_window
    operator = start()
    name, other = bpy.context.scene.name, bpy.data.scenes.new("Other")
    bpy.data.scenes.remove(bpy.data.scenes[name])
    rendering.clear()
    assert to_the_end(operator) == {"CANCELLED"} and not jobs.running and other.name in bpy.data.scenes
