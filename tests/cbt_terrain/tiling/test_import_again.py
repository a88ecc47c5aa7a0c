# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports by tile in several processes, and after a kill; damaged work is not continued."""

import json
import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.field import store_folder
from adaptive_terrain.cbt_terrain.field.lattice import lattice_for
from adaptive_terrain.cbt_terrain.importing import tile_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.tile_crew import ProcessCrew
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling import tile_work
from adaptive_terrain.cbt_terrain.tiling.tile_grid import TileGrid
from adaptive_terrain.cbt_terrain.tiling.tile_records import MEASURED, READ, line_of, record_of
from forked_programs import run_program
from rasters import hills
from tiled_stores import CountingCrew, assert_same, content, tiled, write_tiles  # noqa: F401

MODULES = {"file": "cbt_terrain.importing.tile_crew", "mosaic": "cbt_terrain.mosaic.import_child"}


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "count"), [("file", 3), ("mosaic", 2)])
def test_processes_give_the_bytes_of_one_tile(tmp_path, tiled, kind, count):  # noqa: F811
    run = run_import if kind == "file" else run_mosaic_import
    if kind == "file":
        np.save(tmp_path / "a.npy", hills(200, 150))
        settings = ImportSettings(str(tmp_path / "a.npy"))
    else:
        write_tiles(tmp_path / "tiles")
        settings = ImportSettings(str(tmp_path / "tiles"))
    tiled(None)
    run(settings, tmp_path / "whole")
    tiled(6)
    crew = ProcessCrew(MODULES[kind], count)
    try:
        run(settings, tmp_path / "tiled", crew=crew)
    finally:
        crew.close()
    assert [process.wait(60) for process in crew._processes] == [0] * count
    assert_same(tmp_path / "tiled", tmp_path / "whole")


def test_a_small_import_uses_no_other_process(tmp_path):
    np.save(tmp_path / "a.npy", hills(200, 150))
    crew = ProcessCrew(MODULES["file"], 1)
    try:
        run_import(ImportSettings(str(tmp_path / "a.npy")), tmp_path / "store", crew=crew)
        assert not crew._has_begun and crew._processes[0].poll() is None
    finally:
        crew.close()
    assert crew._processes[0].wait(60) == 0


def test_an_error_in_a_process_is_one_sentence(tmp_path, tiled, fork_children):  # noqa: F811
    write_tiles(tmp_path / "tiles")
    tiled(6)
    crew = ProcessCrew(MODULES["mosaic"], 2)

    def run(work, source, tasks, on_progress):
        file = tmp_path / "tiles" / "t00.tif"
        file.write_bytes(file.read_bytes()[:3000])
        return ProcessCrew.run(crew, work, source, tasks, on_progress)

    spoiling = tile_import.Crew()
    spoiling.run = run
    with pytest.raises(TerrainError, match="t00.tif is damaged or incomplete in rows"):
        run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store", crew=spoiling)
    crew.close()


KILLED = """
import os, sys
from adaptive_terrain.cbt_terrain.rasters import raster
from adaptive_terrain.cbt_terrain.importing import import_work, tile_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
raster.BLOCK_SAMPLES = 2000
import_work.TILE_BITS = 5
class Crew(tile_import.Crew):
    left = int(sys.argv[3])
    def run(self, work, source, tasks, on_progress):
        for task in tasks:
            if self.left == 0:
                work.note("measured", task.number) if task.step == "measured" else None
                (work.folder / f"tiles-{0:032}.jsonl").write_text('{"kind": "read", "number": 0, "a')
                os._exit(9)
            tile_import.perform(work, source, task, 1)
            self.left -= 1
        return True
run_import(ImportSettings(sys.argv[1], no_data=0.0), sys.argv[2], crew=Crew())
"""


@pytest.mark.parametrize("done", [2, pytest.param(12, marks=pytest.mark.thorough)])
def test_a_killed_import_goes_on_where_it_was(tmp_path, tiled, monkeypatch, done):  # noqa: F811
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.rasters.raster.BLOCK_SAMPLES", 2000)
    heights = hills(160, 140)
    heights[30:60, 50:90] = 0.0
    np.save(tmp_path / "a.npy", heights)
    settings, store = ImportSettings(str(tmp_path / "a.npy"), no_data=0.0), tmp_path / "store"
    assert run_program(KILLED, settings.source, store, done).returncode == 9
    assert len(list(store.glob("data-*"))) == 1 and not (store / "store.json").exists()
    store_folder.remove_abandoned(store)
    tiled(None)
    run_import(settings, tmp_path / "whole")
    tiled(5)
    crew = CountingCrew()
    run_import(settings, store, crew=crew)
    assert (len(crew.read), len(crew.measured)) == (max(3 - done, 0), 25 - max(done - 3, 0))
    assert len(list(store.glob("data-*"))) == 1
    assert_same(store, tmp_path / "whole")


KILLED_AFTER_ALL_TILES = """
import os, sys
from adaptive_terrain.cbt_terrain.importing import import_work
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
import_work.TILE_BITS = 5
event, name = sys.argv[3:]
def kill(found, values):
    if found == event and os.path.basename(str(values[0])).startswith(name) and values[1] not in (None, "r", "rb"):
        os._exit(9)
sys.addaudithook(kill)
run_import(ImportSettings(sys.argv[1], no_data=0.0, holes=True), sys.argv[2])
"""
AFTER_ALL_TILES = {  # event of Python, and the beginning of the file's name
    "the records are in one file": ("os.remove", "tiles-"),
    "the arrays have checksums": ("open", "store.json"),
    "the new version is complete": ("os.rename", "store.json"),
}


@pytest.mark.thorough
@pytest.mark.parametrize(
    "moment",
    [pytest.param(m, marks=[] if "complete" in m else [pytest.mark.thorough]) for m in AFTER_ALL_TILES],
)
def test_a_kill_after_the_last_tile_loses_no_tile(tmp_path, tiled, moment):  # noqa: F811
    heights = hills(160, 140)
    heights[30:60, 50:90] = 0.0
    np.save(tmp_path / "a.npy", heights)
    settings, store = ImportSettings(str(tmp_path / "a.npy"), no_data=0.0, holes=True), tmp_path / "store"
    assert run_program(KILLED_AFTER_ALL_TILES, settings.source, store, *AFTER_ALL_TILES[moment]).returncode == 9
    assert len(list(store.glob("data-*/tiles.jsonl"))) == 1 and not (store / "store.json").exists()
    store_folder.remove_abandoned(store)  # as each import begins
    tiled(None)
    run_import(settings, tmp_path / "whole")
    tiled(5)
    crew = CountingCrew()
    run_import(settings, store, crew=crew)
    assert (crew.read, crew.measured) == ([], [])
    assert not list(store.glob("data-*/missing.npy")) and len(list(store.glob("data-*"))) == 1
    assert_same(store, tmp_path / "whole")


def test_marks_beside_a_published_store_are_removed(tmp_path, tiled, monkeypatch):  # noqa: F811
    np.save(tmp_path / "a.npy", hills(100, 90))
    tiled(5)
    with monkeypatch.context() as patch:
        patch.setattr(stores, "remove_abandoned", lambda *_, **__: None)  # as if it was killed before
        run_import(ImportSettings(str(tmp_path / "a.npy")), tmp_path / "store")
    [marks] = (tmp_path / "store").glob("data-*/missing.npy")
    store_folder.remove_abandoned(tmp_path / "store")  # as each import begins
    assert not marks.exists()
    tiled(None)
    run_import(ImportSettings(str(tmp_path / "a.npy")), tmp_path / "whole")
    assert_same(tmp_path / "store", tmp_path / "whole")


def test_another_import_removes_what_was_left(tmp_path, tiled):  # noqa: F811
    np.save(tmp_path / "a.npy", hills(100, 90))
    tiled(5)
    with pytest.raises(KeyboardInterrupt):
        run_import(ImportSettings(str(tmp_path / "a.npy")), tmp_path / "store", crew=CountingCrew(5))
    [left] = (tmp_path / "store").glob("data-*")
    crew = CountingCrew()
    run_import(ImportSettings(str(tmp_path / "a.npy"), height_scale=2.0), tmp_path / "store", crew=crew)
    assert len(crew.read) == 1 and not left.exists()


def damage_work(folder, kind, user_file):
    """Damage the work of a killed import, with valid checksums."""
    if kind == "no marks":
        (folder / "missing.npy").unlink()
    elif kind == "header":
        text = (folder / "error.npy").read_bytes()
        (folder / "error.npy").write_bytes(text.replace(b"|u1", b"|O8", 1))
    elif kind == "hard link":
        user_file.write_bytes((folder / "samples.npy").read_bytes())
        (folder / "samples.npy").unlink()
        os.link(user_file, folder / "samples.npy")
    elif kind == "other tiles":
        content = json.loads((folder / "work.json").read_text()) | {"bits": 4}
        del content["sum"]
        (folder / "work.json").write_text(json.dumps(content | {"sum": tile_work._sum_of(content)}))
    else:
        [log] = folder.glob("tiles-*.jsonl")
        records = [json.loads(line)["record"] for line in log.read_text().splitlines()]
        for record in records:
            if kind == "figures":
                record["figures"] = "none" if record["kind"] == READ else record.get("figures")
            elif kind == "number":
                record["number"] = 10**9 if record["kind"] == MEASURED else [record["number"]]
            elif "above" in record:
                record["above"][1] = [[-5, 1 << 40, 99, 1.0]]
        log.write_text("".join(map(line_of, records)))


RARE = "figures", "no marks", "other tiles", "number", "vertices"


@pytest.mark.parametrize(
    "kind", ["header", "hard link", *(pytest.param(kind, marks=pytest.mark.thorough) for kind in RARE)]
)
def test_a_damaged_work_is_not_continued(tmp_path, tiled, kind):  # noqa: F811
    np.save(tmp_path / "a.npy", hills(100, 90))
    settings, store = ImportSettings(str(tmp_path / "a.npy")), tmp_path / "store"
    tiled(None)
    run_import(settings, tmp_path / "whole")
    tiled(5)
    with pytest.raises(KeyboardInterrupt):
        run_import(settings, store, crew=CountingCrew(8))
    [left] = store.glob("data-*")
    damage_work(left, kind, tmp_path / "user.npy")
    before = (tmp_path / "user.npy").read_bytes() if kind == "hard link" else None
    run_import(settings, store)
    assert_same(store, tmp_path / "whole")
    assert before is None or (tmp_path / "user.npy").read_bytes() == before


def test_a_work_with_impossible_heights_is_removed(tmp_path, tiled):  # noqa: F811
    np.save(tmp_path / "a.npy", hills(100, 90))
    settings, store = ImportSettings(str(tmp_path / "a.npy")), tmp_path / "store"
    tiled(5)
    with pytest.raises(KeyboardInterrupt):
        run_import(settings, store, crew=CountingCrew(8))
    [left] = store.glob("data-*/samples.npy")
    np.load(left, mmap_mode="r+")[-1, ::2] = np.inf
    with pytest.raises(TerrainError, match="is damaged, and is removed: check the disk, and import again"):
        run_import(settings, store)
    run_import(settings, store)
    tiled(None)
    run_import(settings, tmp_path / "whole")
    assert_same(store, tmp_path / "whole")


def test_a_cut_or_changed_record_is_none():
    grid = TileGrid(lattice_for(100, 90), 5)
    figures = {"largest": 1.0, "converted": 0.0, "moved": 0.0, "shifted": 0.0, "marks": [], "values": [1.0, 2.0]}
    record = {"kind": READ, "number": 0, "at": 5, "inputs": "", "missing": 0, "limits": [1.0, 2.0], "figures": figures}
    line = line_of(record).encode().rstrip(b"\n")
    assert record_of(line, grid) == record
    assert all(record_of(line[:end], grid) is None for end in range(len(line)))
    for at in range(len(line)):
        assert record_of(line[:at] + bytes([line[at] ^ 1]) + line[at + 1 :], grid) is None
