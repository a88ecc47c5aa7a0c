# SPDX-License-Identifier: GPL-3.0-or-later
"""Land gets finer while nothing changes: its start, its results and its end."""

import os
import shutil
import signal
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.land import resting_land, shaped_land
from adaptive_terrain.operators.session import live, session
from land_scenes import wide_hills
from live_windows import show_window


@pytest.fixture(scope="module")
def hills(tmp_path_factory):
    """Return a store with three levels."""
    return wide_hills(tmp_path_factory.mktemp("wide") / "hills", 700, 1000)


@pytest.fixture
def terrain(scene, add_terrain, hills, tmp_path, monkeypatch):
    """Return a terrain in a window that shows the preview of a stack, with a camera over one corner."""
    shutil.copytree(hills, tmp_path / "wide")
    obj = add_terrain()
    obj.adaptive_terrain.store = str(tmp_path / "wide")
    derived_store.forget()
    bpy.ops.adaptive_terrain.land_add(effect="relief")
    scene.camera.location, scene.camera.rotation_euler = (-3000.0, -2000.0, 460.0), (0.0, 0.0, 0.0)
    show_window(monkeypatch)
    monkeypatch.setattr(resting_land, "REST_S", 0.05)
    monkeypatch.setattr(resting_land, "LOOK_S", 0.0)
    bpy.context.view_layer.update()
    live.mark_dirty()
    until(obj, "Preview")
    yield obj
    resting_land.stop()
    assert not jobs.running


def until(obj, shown: str) -> None:
    turns(lambda: shaped_land.state_of(obj).shown == shown)


def turns(reached, limit_s: float = 300.0) -> None:
    end = time.monotonic() + limit_s
    while not reached():
        assert time.monotonic() < end, (session.record_of(bpy.context.object).status.error, jobs.progress_shown())
        live.tick()
        time.sleep(0.03)  # a look costs some time of a processor, which a child with a low priority lacks


def is_finished(obj) -> bool:
    return not jobs.running and not resting_land.has_work()


def test_land_in_view_gets_finer_and_a_render_has_the_rest(terrain):
    until(terrain, "Shaped")
    turns(lambda: is_finished(terrain))
    state, folder = shaped_land.state_of(terrain), shaped_land.store_of(terrain)
    assert 0 < state.tiles[0] < state.tiles[1] and state.wanted, "Shape Now makes the others"
    assert land_folder.is_of_views(folder) and session.record_of(terrain).status.request.store == folder
    change = open_store(folder).heights() - open_store(terrain.adaptive_terrain.store).heights()
    fine = [np.abs(np.diff(part, 2)).mean() for part in (change[100:200, 50:150], change[550:650, 800:900])]
    assert fine[0] > 2.0 * fine[1], "below the camera"
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    live.mark_dirty()
    turns(lambda: not land_folder.is_of_views(shaped_land.store_of(terrain)))
    assert not shaped_land.state_of(terrain).wanted
    more = open_store(shaped_land.store_of(terrain)).heights() - open_store(folder).heights()
    seen, unseen = (np.abs(part).mean() for part in (more[100:200, 50:150], more[550:650, 800:900]))
    assert seen < 0.2 * unseen


def test_the_whole_land_is_made_where_it_costs_less_than_tiles(terrain):
    """A view of all the land needs all tiles, whose margins overlap; renders and Shape Now then find the land."""
    resting_land.stop()
    bpy.context.scene.camera.location = (0.0, 0.0, 9000.0)
    terrain.adaptive_terrain.viewport.error_px = 0.1
    bpy.context.view_layer.update()
    live.mark_dirty()
    turns(
        lambda: (
            (shown := shaped_land.store_of(terrain))
            and is_finished(terrain)
            and land_folder.is_land_name(Path(shown).name)
        )
    )
    state = shaped_land.state_of(terrain)
    assert state.shown == "Shaped" and state.tiles[0] == state.tiles[1] and not state.wanted
    assert not land_folder.is_of_views(shaped_land.store_of(terrain)), "tiles with margins cost more"


def test_a_shot_keeps_to_the_tiles_that_its_renders_need(terrain):
    """Tiles of some operators differ from land in one piece."""
    terrain.adaptive_terrain.land.where = "SEEN"
    test = shaped_land.store_of
    bpy.context.view_layer.update()
    live.mark_dirty()
    until(terrain, "Shaped")
    turns(lambda: is_finished(terrain))
    assert land_folder.is_of_views(test(terrain))


def test_another_view_gets_its_own_tiles_when_it_rests(terrain):
    until(terrain, "Shaped")
    built = shaped_land.state_of(terrain).tiles[0]
    bpy.context.scene.camera.location = (3000.0, 2000.0, 460.0)
    bpy.context.view_layer.update()
    live.mark_dirty()
    turns(lambda: shaped_land.state_of(terrain).tiles[0] > built)
    turns(lambda: is_finished(terrain))
    turns(lambda: session.record_of(terrain).field is session.open_field(shaped_land.store_of(terrain)))


def test_damaged_land_in_view_is_shaped_again(terrain, capsys):
    """The preview is shown meanwhile, and the repair needs no click."""
    until(terrain, "Shaped")
    turns(lambda: is_finished(terrain))
    folder, record, made = Path(shaped_land.store_of(terrain)), session.record_of(terrain), []
    session._fields.clear()
    samples = next(folder.glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    samples.unlink()  # the old one is still mapped
    samples.write_bytes(whole[: len(whole) // 2])
    terrain.adaptive_terrain.smooth = not terrain.adaptive_terrain.smooth
    bpy.context.view_layer.update()
    live.mark_dirty()
    for state in ("Preview", "Shaped"):
        turns(lambda state=state: made.append(record.status.error) or shaped_land.state_of(terrain).shown == state)
    assert set(made) == {""} and capsys.readouterr().out.count("_views' is damaged and is built again from its") == 1
    assert record.field is session.open_field(str(folder))
    assert next(folder.glob("data-*/samples.npy")).read_bytes() == whole


@pytest.mark.parametrize(
    ("fault", "stack"),
    [
        ("folder", True),
        ("rights", False),
        pytest.param("folder", False, marks=pytest.mark.thorough),
        pytest.param("rights", True, marks=pytest.mark.thorough),
    ],
)
def test_a_source_that_was_mended_is_seen_by_the_next_update(terrain, monkeypatch, fault, stack):
    """A store whose store.json became a folder or unreadable works again once the file is restored unchanged."""
    terrain.adaptive_terrain.live, record = True, session.record_of(terrain)
    monkeypatch.setattr(resting_land, "REST_S", 1e9)
    if not stack:
        bpy.ops.adaptive_terrain.land_remove()
        live.mark_dirty()
        turns(lambda: record.status.request.land is None)
    file = Path(terrain.adaptive_terrain.store) / "store.json"
    before = file.stat()
    opened, aside = stores.open_regular, file.with_suffix(".aside")
    file.rename(aside)
    if fault == "folder":
        file.mkdir()
    else:
        aside.rename(file)
        file.chmod(0)
        monkeypatch.setattr(
            stores, "open_regular", lambda f: opened(f) if f.stat().st_mode & 0o400 else opened(f.parent)
        )
    derived_store._key_of.cache_clear()
    session._fields.clear()
    live.mark_dirty()
    turns(lambda: "store.json cannot be read (" in record.status.error)
    if fault == "folder":
        file.rmdir()
        aside.rename(file)
    else:
        file.chmod(before.st_mode)
        monkeypatch.setattr(stores, "open_regular", opened)
    assert file.stat().st_mtime_ns == before.st_mtime_ns
    live.mark_dirty()
    turns(lambda: not record.status.error)


def test_a_changed_setting_restarts_the_shaping(terrain):
    turns(lambda: any(job.child is not None for job in jobs.running))
    [child] = [job.child for job in jobs.running]
    os.kill(child._process.pid, signal.SIGSTOP)  # on a busy machine it might end before the change is seen
    terrain.adaptive_terrain.land.entries[0].relief.wave = 90.0
    bpy.context.view_layer.update()
    live.mark_dirty()
    turns(lambda: child.poll().done)
    assert child.cancelled
    until(terrain, "Shaped")
    assert [entry.relief.wave for entry in terrain.adaptive_terrain.land.entries] == [90.0]


def test_cancelled_land_is_not_started_again(terrain):
    turns(lambda: jobs.running)
    assert bpy.ops.adaptive_terrain.cancel_job(kind="SHAPE") == {"FINISHED"}
    for _ in range(40):
        live.tick()
        time.sleep(0.005)
    assert not jobs.running and shaped_land.state_of(terrain).shown == "Preview"
    terrain.adaptive_terrain.land.entries[0].relief.wave = 70.0
    bpy.context.view_layer.update()
    live.mark_dirty()
    until(terrain, "Shaped")


def test_without_live_update_nothing_is_shaped(terrain):
    terrain.adaptive_terrain.live = False
    for _ in range(40):
        live.tick()
        time.sleep(0.005)
    assert not jobs.running and shaped_land.state_of(terrain).shown == "Preview"


@pytest.mark.thorough
def test_land_that_is_damaged_again_and_again_is_left(terrain, monkeypatch, capsys):
    """With a disk that damages every file, the panel shows an error after some tries, and shaping stops."""
    opened, record = session.open_store, session.record_of(terrain)

    def damaged(path):
        if land_folder.is_of_views(str(path)):
            raise TerrainError(f"{path} is damaged (its disk is worn out): import the terrain again.")
        return opened(path)

    monkeypatch.setattr(session, "open_store", damaged)
    turns(lambda: "its disk is worn out" in record.status.error)
    turns(lambda: not jobs.running)
    for _ in range(60):
        live.tick()
        time.sleep(0.005)
    assert not jobs.running and shaped_land.state_of(terrain).shown == "Preview"
    assert capsys.readouterr().out.count("is built again from its source") == derived_store.MAX_REBUILDS
