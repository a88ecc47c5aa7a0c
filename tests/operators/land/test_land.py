# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that stacks shape in Blender: previews, stores, their cache, and the cost for a scene."""

import os
import shutil
from pathlib import Path
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.importing.import_terrain import ImportTerrain
from adaptive_terrain.operators.land import bake_land, shape_land, shaped_land
from adaptive_terrain.operators.land import cache as land_cache
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.land.bake_land import BakeLand
from adaptive_terrain.operators.land.panel import NOTE_LINES, shaping_time_text, status_lines
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import gather
from adaptive_terrain.operators.terrain.request_kernels import kernels_for
from adaptive_terrain.operators.text.numbers import time_text
from adaptive_terrain.operators.ui.panel_parts import LINE_LENGTH, wrap_words
from land_scenes import add
from modal_runs import hold, running, to_the_end, turn


def test_an_unwritable_export_fails_before_land_is_shaped(terrain, tmp_path):
    add("scree")
    with pytest.raises(RuntimeError, match="there is no folder"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "none" / "land.tif"))
    assert derived_store.counts["stores"] == 0


def test_a_hidden_terrain_costs_nothing(terrain):
    """Counted: neither previews nor stores are made of it, whatever asks; once it is shown they are."""
    add("relief")
    for hide in ("hide_viewport", "eye"):
        if hide == "eye":
            terrain.hide_viewport = False
            terrain.hide_set(True)
        else:
            terrain.hide_viewport = True
        terrain.hide_render = True
        bpy.context.view_layer.update()
        session.update_object(terrain)
        handlers.update_all(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), "VIEWPORT")
        assert session.record_of(terrain).status.request.land is None
        with pytest.raises(RuntimeError, match="is hidden in viewports and in renders"):
            bpy.ops.adaptive_terrain.shape()
    assert derived_store.counts == {"previews": 0, "stores": 0}
    terrain.hide_set(False)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert derived_store.counts == {"previews": 1, "stores": 0}


def test_a_preview_first_and_the_land_when_it_is_shaped(terrain):
    add("scree", scree_angle=0.4)
    state = shaped_land.state_of(terrain)
    assert (state.active, state.wanted) == (True, True)
    session.update_object(terrain)
    state = shaped_land.state_of(terrain)
    assert state.shown == "Preview" and state.step_m == 10.0 and list(state.ms) == [0]
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    state = shaped_land.state_of(terrain)
    assert (state.shown, state.wanted) == ("Shaped", False) and state.tiles == (1, 1)
    assert [name for name, _ in status_lines(state)] == ["Shown", "Tiles", "Time"]
    folder = shaped_land.store_of(terrain)
    request = session.record_of(terrain).status.request
    assert request.store == folder and request.land is None
    assert derived_store.counts == {"previews": 1, "stores": 1}
    bpy.ops.adaptive_terrain.shape()
    assert derived_store.counts == {"previews": 1, "stores": 1}, "what is there is not made again"


def note_where(monkeypatch, terrain, **said) -> str:
    """Return the panel's note for a shaped store whose JSON has these other values."""
    read = shaped_land.stores.read_json

    def other(path):
        found = read(path)
        shaped = found["provenance"].get("shaped")
        for name, value in said.items() if shaped else ():
            within = shaped if name in shaped else shaped["added"][-1]
            assert within[name] != value
            within[name] = value
        return found

    shaped_land._read_provenance.cache_clear()
    with monkeypatch.context() as replaced:
        replaced.setattr(shaped_land.stores, "read_json", other)
        note = shaped_land.state_of(terrain).note
    shaped_land._read_provenance.cache_clear()
    assert len(wrap_words(note, LINE_LENGTH)) <= NOTE_LINES, "nothing of it is cut"
    return note


def test_the_panel_says_that_tiles_are_not_to_be_trusted(terrain, monkeypatch):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    assert shaped_land.state_of(terrain).note == ""
    expected = "Scree may not fit from tile to tile: harder rock may help, or 4,097 samples a side at most"
    left_out = {"left_out_rms_m": 1.96, "left_out_most_m": 11.9}
    assert note_where(monkeypatch, terrain, doubtful=True) == expected
    assert note_where(monkeypatch, terrain, doubtful=True, **left_out) == expected, "the worse is said"


def test_the_panel_says_that_some_tiles_took_the_whole(terrain, monkeypatch):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    said = {"left_out_rms_m": 1234.5, "left_out_most_m": 123.45}
    left_out = "Finer levels are left out{}: about 1,234 m, 123 m at most"
    assert note_where(monkeypatch, terrain, **said) == left_out.format("")
    but = ", except Scree, whose tiles would not fit"
    assert note_where(monkeypatch, terrain, **said, tiles=[[]]) == left_out.format(but)


def test_the_land_is_what_the_command_makes(terrain, tmp_path):
    add("scree", depth=60.0)
    bpy.ops.adaptive_terrain.shape()
    stack = land_stack.preset_of(terrain.adaptive_terrain.land)
    run_shape(terrain.adaptive_terrain.store, stack, tmp_path / "other")
    mine, other = open_store(shaped_land.store_of(terrain)), open_store(tmp_path / "other")
    assert mine.key == other.key and np.array_equal(mine.heights(), other.heights())


def test_undo_brings_the_land_before_back_at_once(terrain):
    """The settings alone decide which store is shown."""
    entry = add("scree")
    bpy.ops.adaptive_terrain.shape()
    first = shaped_land.store_of(terrain)
    entry.scree.depth = 3.0
    bpy.ops.adaptive_terrain.shape()
    assert shaped_land.store_of(terrain) != first
    entry.scree.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == first and derived_store.counts["stores"] == 2
    entry.on = False
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == terrain.adaptive_terrain.store
    assert shaped_land.state_of(terrain) == shaped_land.LandState()


def test_a_render_has_all_of_the_land_and_waits_for_it(terrain):
    add("scree", depth=80.0)
    session.update_object(terrain)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts == {"previews": 1, "stores": 1}
    assert shaped_land.state_of(terrain).shown == "Shaped"
    assert session.record_of(terrain).field.raster.digest == open_store(shaped_land.store_of(terrain)).raster.digest


def other_stores(store: str, *names: str) -> list[str]:
    """Copy a shaped store, as for other settings; order the ages so that `store` is the oldest, then the first copy."""
    found = [shutil.copytree(store, Path(store).with_name(name)) for name in names]
    for age, folder in enumerate((*reversed(found), store), 1):
        os.utime(folder, (1e9 - age, 1e9 - age))
    return list(map(str, found))


def test_unused_shaped_land_is_removed_when_there_is_too_much(terrain, add_terrain, monkeypatch):
    """The one that was not used for longest first; never what another terrain of the scene shows."""

    def there() -> set[str]:
        return {str(folder) for folder, _ in land_folder.shaped_stores(terrain.adaptive_terrain.store)}

    other = add_terrain("Other")
    other.adaptive_terrain.store = terrain.adaptive_terrain.store
    bpy.context.view_layer.objects.active = other
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(other)
    first, second = other_stores(shown, "0" * 16, "1" * 16 + land_folder.OF_VIEWS)
    monkeypatch.setattr(derived_store, "MAX_BYTES", int(3.5 * land_folder.bytes_in(Path(first))))
    bpy.context.view_layer.objects.active = terrain
    add("scree", depth=10.0)
    bpy.ops.adaptive_terrain.shape()
    own = shaped_land.store_of(terrain)
    assert there() == {shown, second, own}
    terrain.adaptive_terrain.land.entries[0].scree.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == shown, "both terrains share it"
    monkeypatch.setattr(derived_store, "MAX_BYTES", 0)
    derived_store.remove_old(derived_store.Land(terrain.adaptive_terrain.store, second, False, None))
    assert there() == {shown, second}


def test_the_cache_says_what_it_holds_and_is_cleared(terrain):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(terrain)
    [other] = other_stores(shown, "0" * 16)
    beside = land_folder.folder_beside(terrain.adaptive_terrain.store)
    said = land_cache.describe_cache(terrain.adaptive_terrain.store)
    assert said[0] == str(beside) and said[1].endswith(" MB, stores: 1") and " 0 MB" not in "".join(said)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert Path(shown).exists() and not Path(other).exists() and not (beside / "tiles").exists()
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Shaped"


def test_the_cache_is_cleared_while_another_object_is_active(terrain):
    """Blender polls again when the dialog is confirmed, without the button's terrain."""
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    tiles = land_folder.folder_beside(terrain.adaptive_terrain.store) / "tiles"
    assert tiles.is_dir()
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    bpy.context.collection.objects.link(cube)
    bpy.context.view_layer.objects.active = cube
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"} and not tiles.exists()


def test_the_cache_keeps_what_a_terrain_shows_by_another_path(terrain, add_terrain, tmp_path):
    """A store behind a link, or by way of another folder, and one that was baked from it."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "link").symlink_to(tmp_path)
    add("scree")
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    for between in ("link", "scenes/.."):
        other = add_terrain()
        other.adaptive_terrain.store = f"{tmp_path}/{between}/hills"
        bpy.context.view_layer.objects.active = other
        add("scree")
        bpy.ops.adaptive_terrain.shape()
        derived_store._in_use.pop(terrain.session_uid, None)
        bpy.context.view_layer.objects.active = terrain
        assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
        assert Path(shaped_land.store_of(other)).is_dir() and shaped_land.state_of(other).shown == "Shaped"
        bpy.data.objects.remove(other)
        derived_store._in_use.clear()


def test_the_cache_drops_the_land_of_a_removed_terrain(terrain, add_terrain):
    add("scree")
    session.update_object(terrain, mode="RENDER")
    source, folder = terrain.adaptive_terrain.store, shaped_land.store_of(terrain)
    other = add_terrain()
    other.adaptive_terrain.store = source
    bpy.data.objects.remove(terrain)
    bpy.context.view_layer.objects.active = other
    assert land_cache.describe_cache(source)[1].endswith(" 0 MB, stores: 0")
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"} and not Path(folder).exists()


def test_baked_land_needs_no_stack(terrain):
    add("scree", depth=80.0)
    before = open_store(terrain.adaptive_terrain.store).key
    source = terrain.adaptive_terrain.store
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    baked = terrain.adaptive_terrain.store
    assert baked == source + "_baked" and not terrain.adaptive_terrain.land.entries
    assert open_store(source).key == before != open_store(baked).key
    beside = land_folder.folder_beside(source)
    assert (beside / "tiles").is_dir() and str(beside) in land_cache.describe_cache(baked), "for Undo"
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert not land_folder.shaped_stores(source) and not (beside / "tiles").exists() and Path(source).is_dir()
    session.update_object(terrain)
    assert session.record_of(terrain).field.raster.digest == open_store(baked).raster.digest
    with pytest.raises(RuntimeError, match="nothing to bake: the list is empty"):
        bpy.ops.adaptive_terrain.bake_land()


def test_an_import_after_a_bake_says_which_land_it_leaves(terrain):
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.bake_land()
    baked = terrain.adaptive_terrain.store
    texts = imported_anew(terrain)
    message = f"The terrain has its imported heights again; its baked land stays in {baked}"
    assert terrain.adaptive_terrain.store != baked and [text for text in texts if "baked" in text] == [message]
    assert texts[-1] == message, "the status bar shows the last message only"
    assert not any("baked" in text for text in imported_anew(terrain))


def imported_anew(terrain) -> list[str]:
    """Return the messages of an import in a window."""
    operator = running(ImportTerrain, terrain)
    if operator.began == {"RUNNING_MODAL"}:  # an import that is up to date may be so at once
        to_the_end(operator)
    return [call.args[1] for call in operator.report.call_args_list]


def test_the_list_says_which_effects_were_not_computed_again(terrain):
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.shape()
    session.update_object(terrain)
    [first] = shaped_land.state_of(terrain).ms.values()
    assert first > 0.0
    add("relief")
    bpy.ops.adaptive_terrain.shape()
    session.update_object(terrain)
    state = shaped_land.state_of(terrain)
    assert state.ms[0] is None and state.ms[1] > 0.0
    assert [shaping_time_text(state.ms, number) for number in (0, 1, 2)] == ["Reused", time_text(state.ms[1]), "-"]
    assert status_lines(state)[2] == ("Time", time_text(state.ms[1]))


@pytest.fixture
def bake(terrain, monkeypatch):
    """Start to bake shaped land in a window; return the operator, and an event that lets it copy."""
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.shape()
    event = hold(monkeypatch, bake_land, "copy_store")
    return running(BakeLand, terrain), event


def test_a_window_bakes_land_beside_its_work(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    assert operator.began == {"RUNNING_MODAL"} and jobs.find(jobs.BAKE_LAND, terrain) == operator.job
    assert terrain.adaptive_terrain.land.entries and not BakeLand.poll(operator.context)
    event.set()
    assert to_the_end(operator) == {"FINISHED"} and not terrain.adaptive_terrain.land.entries
    assert open_store(terrain.adaptive_terrain.store).path == Path(source + "_baked")


def test_a_cancelled_bake_leaves_list_and_store(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    operator.job.stop()
    event.set()
    assert to_the_end(operator) == {"CANCELLED"} and len(terrain.adaptive_terrain.land.entries) == 1
    assert terrain.adaptive_terrain.store == source and not Path(source + "_baked").exists()


def test_a_list_that_changes_during_a_bake_stays(bake, terrain):
    source, (operator, event) = terrain.adaptive_terrain.store, bake
    add("relief")
    event.set()
    to_the_end(operator)
    assert operator.report.call_args.args[0] == {"WARNING"} and len(terrain.adaptive_terrain.land.entries) == 2
    assert terrain.adaptive_terrain.store == source and open_store(source + "_baked")


def test_a_window_refuses_to_bake_unshaped_land(terrain):
    add("scree")
    operator = running(BakeLand, terrain)
    assert operator.began == {"CANCELLED"} and "press Shape Now" in operator.report.call_args.args[1]


def test_heights_are_exported_with_what_the_stack_leaves(terrain, tmp_path):
    import rasterio

    add("scree", depth=80.0)
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.tif")) == {"FINISHED"}
    shaped = open_store(land_folder.folder_beside(terrain.adaptive_terrain.store) / only_shaped(terrain))
    with rasterio.open(tmp_path / "land.tif") as file:
        assert np.array_equal(file.read(1)[::-1], shaped.heights())
    assert sorted(path.name for path in tmp_path.glob("land_*.tif")) == [f"land_{n}.tif" for n in sorted(shaped.layers)]
    with pytest.raises(RuntimeError, match="is of no format"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.png"))


def only_shaped(terrain) -> str:
    [folder] = {path.parent for path in land_folder.folder_beside(terrain.adaptive_terrain.store).glob("*/store.json")}
    return folder.name


def test_times_are_short():
    assert [time_text(ms) for ms in (None, 0.0, 0.0814, 0.4, 35.2, 4200.0)] == [
        "-",
        "0 ms",
        "< 0.1 ms",
        "0.4 ms",
        "35.2 ms",
        "4.2 s",
    ]


@pytest.mark.parametrize("by", ["ESC", "cross"])
def test_looking_at_frames_can_be_cancelled(terrain, monkeypatch, by):
    """The scene is at its frame again, and nothing was shaped."""
    add("scree")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    scene.frame_set(450)  # further than a turn gets
    monkeypatch.setattr(jobs, "TURN_S", 0.02)
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert turn(operator) == {"PASS_THROUGH"}
    assert scene.frame_current != 450 and jobs.find(jobs.SHAPE, terrain).text == "Shaping: Looking at frames"
    if by == "ESC":
        assert turn(operator, "ESC") == {"RUNNING_MODAL"}
    else:
        assert bpy.ops.adaptive_terrain.cancel_job(kind="SHAPE") == {"FINISHED"}
    assert to_the_end(operator) == {"CANCELLED"}
    assert scene.frame_current == 450 and not jobs.running and derived_store.counts["stores"] == 0


@pytest.mark.parametrize("by", ["file", "undo"])
def test_looking_at_frames_ends_where_the_scene_goes(terrain, tmp_path, monkeypatch, by):
    """Another file is opened, which ends what runs; or Undo puts another scene in its place."""
    add("scree")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "land.blend"))
    monkeypatch.setattr(jobs, "TURN_S", 0.02)
    operator = running(shape_land.ShapeLand, terrain)
    assert turn(operator) == {"PASS_THROUGH"}
    assert bpy.context.scene.frame_current != 1 and jobs.running
    if by == "file":
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "land.blend"))
        operator.cancel(operator.context)
        operator.context.window_manager.event_timer_remove.assert_called_once()
    else:
        bpy.ops.ed.undo_push(message="before")
        bpy.ops.ed.undo_push(message="after")
        assert bpy.ops.ed.undo() == {"FINISHED"}
        assert to_the_end(operator) == {"CANCELLED"}
    assert not jobs.running and derived_store.counts["stores"] == 0


def test_shaping_says_why_it_does_not_begin(terrain):
    add("scree", scree_angle=0.4)
    job = jobs.BackgroundJob(jobs.SHAPE, terrain.session_uid, lambda _job: iter(()))
    with pytest.raises(RuntimeError, match="Shaping is under way: wait for it, or cancel it"):
        bpy.ops.adaptive_terrain.shape()
    jobs.running.remove(job)
    bpy.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="Make a terrain the active object"):
        bpy.ops.adaptive_terrain.shape()


def test_shaping_that_fails_unexpectedly_can_begin_again(terrain, monkeypatch):
    add("scree", scree_angle=0.4)
    monkeypatch.setattr(derived_store, "wanted_tiles", Mock(side_effect=OSError("no such device")))
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"CANCELLED"} and not jobs.running
    [(kind, message)] = [call.args for call in operator.report.call_args_list]
    assert kind == {"ERROR"} and message.startswith("Shaping failed unexpectedly (OSError: no such device)")
    assert session.record_of(terrain).status.error == message
    monkeypatch.undo()
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"RUNNING_MODAL"} and to_the_end(operator) == {"FINISHED"}


def test_a_preview_waits_for_the_kernels_of_its_effects(terrain):
    add("scree")
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(module.__name__.endswith("land.thermal") for module in kernels_for(request))
    bpy.ops.adaptive_terrain.shape()
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert not any(".land." in module.__name__ for module in kernels_for(request)), "what is shaped needs none"
    terrain.adaptive_terrain.interpolation = "bicubic"
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(".bicubic." in module.__name__ for module in kernels_for(request))
