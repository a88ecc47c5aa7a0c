# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrain from File, and the menu with every operator."""

import re
import zipfile
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.importing.source_list import INDEX_SUFFIXES
from adaptive_terrain.cbt_terrain.rasters.source_formats import FORMATS
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.farm.outside_files import HEIGHT_MAP_ENDS
from adaptive_terrain.operators.importing import menus
from adaptive_terrain.operators.importing.add_terrain import AddTerrain
from adaptive_terrain.operators.importing.add_tiles import AddTiles, ImportTiles
from adaptive_terrain.operators.importing.import_terrain import settings_of
from adaptive_terrain.operators.importing.imported import changed_settings, imported_of, info_lines
from adaptive_terrain.operators.importing.panel import SourcePanel, draw_source
from adaptive_terrain.operators.session.polls import remember_object
from adaptive_terrain.operators.ui.object_menu import OPERATORS
from drawn_panels import DrawnLayout
from modal_runs import RunningOperator, running, to_the_end
from rasterio.transform import from_origin
from rasters import hills, write_raster

pytestmark = pytest.mark.usefixtures("imports_here")
# A row of a list, an internal step, or the answer to a click.
NOT_IN_MENU = re.compile(
    "cancel_(job|waiting)|import_(added|tiles)|land_(add|duplicate|move|preset|preset_add|remove|rule_add)|layer_.*|offer_pack|pick_ground|"
    "shape_finish|show_(effect|message)"
)


def test_a_file_becomes_a_terrain(scene, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    file = write_raster(tmp_path / "dem.png", (hills() * 50).astype("uint16"))
    assert bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(file)) == {"FINISHED"}
    terrain = bpy.context.object
    assert terrain.name == "dem" and terrain.select_get() and scene.render.use_lock_interface
    assert imported_of(terrain.adaptive_terrain).heights_m == pytest.approx((0.0, 39 / 4), abs=1e-4)
    assert len(terrain.data.polygons) > 2
    arguments = {"filepath": str(file), "use_heights": True, "lowest": 100.0, "highest": 130.0}
    bpy.ops.mesh.adaptive_terrain_from_file(**arguments)
    settings = bpy.context.object.adaptive_terrain
    assert imported_of(settings).heights_m == pytest.approx((100.0, 130.0), abs=1e-3)


def test_set_heights_begins_with_the_present_heights(scene, tmp_path):
    file = write_raster(tmp_path / "dem.png", (hills() * 50).astype("uint16"))
    bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(file))
    settings = bpy.context.object.adaptive_terrain
    settings.use_heights = True
    assert (settings.lowest, settings.highest) == pytest.approx((0.0, 39 / 4), abs=1e-4)
    settings.highest, settings.use_heights = 20.0, False
    settings.use_heights = True
    assert settings.highest == 20.0, "a number that the user has entered stays"


@pytest.mark.parametrize("is_moved", [False, True])
def test_the_dialog_for_tiles_opens_beside_the_first_file(scene, tmp_path, is_moved):
    file = write_raster(tmp_path / "dem.png", (hills() * 50).astype("uint16"))
    bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(file))
    context = SimpleNamespace(object=bpy.context.object, window_manager=Mock())
    if is_moved:
        context.object.adaptive_terrain.source_path = "/nowhere/dem.png"
    operator = RunningOperator(operator_class=AddTiles, filepath="", directory="", files=[])
    assert operator.invoke(context, None) == {"RUNNING_MODAL"}
    assert operator.directory == ("" if is_moved else str(tmp_path)) and not operator.filepath
    context.window_manager.fileselect_add.assert_called_once()


@pytest.mark.parametrize("path", ["", "/nowhere/a.tif"])
def test_a_missing_file_leaves_no_object(scene, path):
    with pytest.raises(RuntimeError):
        bpy.ops.mesh.adaptive_terrain_from_file(filepath=path)
    assert [item.name for item in scene.objects] == ["Camera"] and not bpy.data.meshes


def test_every_format_can_be_dropped(scene):
    assert bpy.types.FileHandler.bl_rna_get_subclass_py("ADAPTIVE_TERRAIN_FH_height_map") is menus.HeightMapDropped
    assert menus.HeightMapDropped.bl_file_extensions.split(";") == list(FORMATS)
    assert {".tif", ".r16", ".nc", ".laz", ".zip"} <= set(FORMATS) <= {*HEIGHT_MAP_ENDS}
    offered = bpy.ops.mesh.adaptive_terrain_from_file.get_rna_type().properties["filter_glob"].default
    assert offered.split(";") == [f"*{suffix}" for suffix in (*FORMATS, *INDEX_SUFFIXES)]


def test_the_object_menu_has_every_operator(scene):
    listed = {name for names in OPERATORS for name in names}
    every = {name for name in dir(bpy.ops.adaptive_terrain) if not NOT_IN_MENU.fullmatch(name)}
    assert listed == every


def write_tiles(folder):
    """Write three tiles from west to east."""
    folder.mkdir()
    heights = hills(60, 20)
    return [
        write_raster(
            folder / f"t{n}.tif",
            heights[:, 20 * n : 20 * n + 20],
            crs="EPSG:32632",
            transform=from_origin(5e5 + 200 * n, 5e6, 10, 10),
        )
        for n in range(3)
    ]


@pytest.fixture
def files(scene, tmp_path):
    """Save the scene, and write three tiles from west to east."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    return write_tiles(tmp_path / "tiles")


@pytest.fixture
def first(files):
    """Return the terrain of the first tile."""
    bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(files[0]))
    return bpy.context.object


def test_several_files_become_one_terrain(files, tmp_path):
    chosen = {"directory": str(tmp_path / "tiles"), "files": [{"name": file.name} for file in files]}
    assert bpy.ops.mesh.adaptive_terrain_from_file(**chosen) == {"FINISHED"}
    terrain = bpy.context.object
    settings = terrain.adaptive_terrain
    assert terrain.name == "tiles" and [item.path for item in settings.more_sources] == list(map(str, files[1:]))
    assert imported_of(settings).raster == (60, 20)
    assert dict(info_lines(imported_of(settings)))["From"] == "t0.tif + 2"
    assert changed_settings(settings_of(terrain), imported_of(settings)) == []
    settings.priority = "newest"
    assert changed_settings(settings_of(terrain), imported_of(settings)) == ["priority"]
    settings.blend = False
    assert changed_settings(settings_of(terrain), imported_of(settings)) == ["priority", "blend"]
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    saved = bpy.data.objects["tiles"].adaptive_terrain
    assert [bpy.path.abspath(item.path) for item in saved.more_sources] == list(map(str, files[1:]))


def test_a_folder_becomes_one_terrain(files, tmp_path):
    assert bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(tmp_path / "tiles") + "/") == {"FINISHED"}
    assert bpy.context.object.name == "tiles"
    assert imported_of(bpy.context.object.adaptive_terrain).raster == (60, 20)
    layout = DrawnLayout()
    SourcePanel.draw(SimpleNamespace(layout=layout, _columns=layout.column), bpy.context)
    assert {"<band>", "<encoding>", "<cell>"} <= set(layout.texts)


def test_an_archive_of_tiles_becomes_one_terrain(files, tmp_path):
    """Its panel has the options of one file and of several, since nothing in Blender looks into an archive."""
    with zipfile.ZipFile(tmp_path / "valley.zip", "w") as archive:
        for file in files:
            archive.write(file, file.name)
    assert bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(tmp_path / "valley.zip")) == {"FINISHED"}
    terrain = bpy.context.object
    settings = terrain.adaptive_terrain
    assert terrain.name == "valley" and imported_of(settings).raster == (60, 20)
    layout = DrawnLayout()
    SourcePanel.draw(SimpleNamespace(layout=layout, _columns=layout.column), bpy.context)
    assert {"<priority>", "<sample_step>", "<band>", "<first_row_south>"} <= set(layout.texts)
    settings.sample_step = 20.0
    assert changed_settings(settings_of(terrain), imported_of(settings)) == ["step"]
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    assert imported_of(settings).step_m == pytest.approx((20.0, 20.0))


def test_tiles_are_added_to_a_terrain(files, first, tmp_path):
    terrain, settings = first, first.adaptive_terrain
    settings.holes = True
    chosen = {"directory": str(tmp_path / "tiles"), "files": [{"name": file.name} for file in files]}
    assert bpy.ops.adaptive_terrain.add_tiles(**chosen) == {"FINISHED"}
    assert bpy.context.object == terrain and settings.holes and imported_of(settings).raster == (60, 20)
    assert [item.path for item in settings.more_sources] == list(map(str, files[1:]))
    with pytest.raises(RuntimeError, match="No new file is chosen"):
        bpy.ops.adaptive_terrain.add_tiles(**chosen)
    with pytest.raises(RuntimeError, match="missing.tif"):
        bpy.ops.adaptive_terrain.add_tiles(filepath=str(tmp_path / "missing.tif"))
    assert len(settings.more_sources) == 2 and imported_of(settings).raster == (60, 20)
    settings.source = "ISLAND"
    assert not bpy.ops.adaptive_terrain.add_tiles.poll()


@pytest.mark.parametrize("end", ["fails", "is cancelled"])
def test_tiles_are_removed_if_their_later_import_stops(files, first, tmp_path, end):
    """The import runs beside the window and stops after its first step."""
    terrain, settings = first, first.adaptive_terrain
    settings.more_sources.add().path = str(files[1])
    store = settings.store
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"no height map")
    operator = running(ImportTiles, terrain, tiles=[SimpleNamespace(name=str(bad if end == "fails" else files[2]))])
    assert operator.began == {"RUNNING_MODAL"} and len(settings.more_sources) == 2
    if end == "is cancelled":
        jobs.find(jobs.IMPORT, terrain).stop()
    assert to_the_end(operator) == {"CANCELLED"}
    assert [item.path for item in settings.more_sources] == [str(files[1])]
    assert settings.store == store and imported_of(settings).raster == (20, 20)


def test_tiles_that_an_undo_removes_meanwhile_are_listed(files, first):
    """Adding is one step for Undo, at the end of the import; an earlier step restores the list without the tiles."""
    assert "UNDO" in ImportTiles.bl_options and "UNDO" not in AddTiles.bl_options
    terrain, settings = first, first.adaptive_terrain
    operator = running(ImportTiles, terrain, tiles=[SimpleNamespace(name=str(files[1]))])
    settings.more_sources.clear()
    assert to_the_end(operator) == {"FINISHED"}
    assert [item.path for item in settings.more_sources] == [str(files[1])]
    assert changed_settings(settings_of(terrain), imported_of(settings)) == []


@pytest.mark.parametrize(("count", "expected"), [(5, []), (6, ["7 files, 2 not listed"])])
def test_the_number_of_hidden_files_is_at_least_two(scene, count, expected):
    obj = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    scene.collection.objects.link(obj)
    settings = obj.adaptive_terrain
    settings.enabled, settings.source, settings.source_path = True, "FILE", "/tiles/t.tif"
    for number in range(count):
        settings.more_sources.add().path = f"/tiles/{number}.tif"
    layout = DrawnLayout()
    draw_source(layout, obj)
    assert [text for text in layout.texts if "not listed" in text] == expected
    assert layout.texts.count("<path>") == (5 if count == 5 else 4)


def test_a_dialog_adds_tiles_to_the_terrain_of_its_button(scene, files, first):
    """Another object is active: the panel shows the scene's only terrain."""
    terrain, cube = first, bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    scene.collection.objects.link(cube)
    operator = RunningOperator(operator_class=AddTiles, report=Mock(), filepath=str(files[1]), files=[])
    remember_object(operator, bpy.context)
    bpy.context.view_layer.objects.active = cube
    assert AddTiles.execute(operator, bpy.context) == {"FINISHED"}
    assert [item.path for item in terrain.adaptive_terrain.more_sources] == [str(files[1])]
    assert not cube.adaptive_terrain.more_sources


def test_the_box_of_add_terrain_draws_properties_that_exist(scene):
    layout = DrawnLayout()
    settings = SimpleNamespace(layout=layout, land="MOUNTAINS", shape=False, natural_size=True)
    settings._is_shaped = lambda land: AddTerrain._is_shaped(settings, land)
    AddTerrain.draw(settings, None)
    drawn = {text.strip("<>") for text in layout.texts}
    assert "natural_size" in drawn and drawn <= set(bpy.ops.mesh.adaptive_terrain_add.get_rna_type().properties.keys())
