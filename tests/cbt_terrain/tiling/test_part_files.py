# SPDX-License-Identifier: GPL-3.0-or-later
"""Computers that share only a disk do tasks of one import at the same time, and lose nothing of each other."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.tile_import import BEGIN, FILL, MEASURE, READ_TILES, ImportPart
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters import raster
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling import tile_work
from rasters import hills
from tiled_stores import assert_same, tiled, write_tiles  # noqa: F401

PAGE = 4096


def files_of(store):
    """Return the bytes of all files in the folder of a work, except the lock."""
    [folder] = [file.parent for file in store.glob("data-*/work.json")]
    return {file: file.read_bytes() for file in folder.iterdir() if file.is_file() and file.suffix != ".lock"}


def pages_of(content):
    return [content[at : at + PAGE] for at in range(0, len(content), PAGE)]


def do_at_once(store, tasks):
    """Do tasks as computers that all read their pages when they begin, and write whole changed pages when they end."""
    before, ended = files_of(store), []
    for task in tasks:
        for file in files_of(store).keys() - before.keys():
            file.unlink()
        for file, content in before.items():
            file.write_bytes(content)
        tile_work._log_name.cache_clear()  # each computer has its own file of records
        task()
        ended.append(files_of(store))
    for file in {file for after in ended for file in after}:
        pages = pages_of(before.get(file, b""))
        for after in ended:
            for number, page in enumerate(pages_of(after.get(file, b""))):
                if number >= len(pages):
                    pages.append(page)
                elif number >= len(pages_of(before.get(file, b""))) or page != pages_of(before[file])[number]:
                    pages[number] = page
        file.write_bytes(b"".join(pages))


@pytest.fixture
def mosaic(tmp_path, tiled):  # noqa: F811
    """Return settings of a mosaic with gaps, and the store of its import in one tile."""
    (tmp_path / "tiles").mkdir()
    write_tiles(tmp_path / "tiles", columns=3, rows=2)
    settings = ImportSettings(str(tmp_path / "tiles"), step=10.0)
    tiled(None)
    run_mosaic_import(settings, tmp_path / "whole")
    tiled(5)
    return settings


@pytest.mark.thorough
@pytest.mark.parametrize("holes", [False, True])
def test_tasks_at_once_have_the_bytes_of_one_import(tmp_path, tiled, monkeypatch, holes):  # noqa: F811
    heights = hills(200, 140).copy()
    heights[40:70, 90:180] = np.nan
    np.save(tmp_path / "a.npy", heights)
    settings = ImportSettings(str(tmp_path / "a.npy"), holes=holes)
    monkeypatch.setattr(raster, "BLOCK_SAMPLES", 1)
    tiled(None)
    run_import(settings, tmp_path / "whole")
    tiled(5)
    share(settings, tmp_path / "store", run_import)
    assert_same(tmp_path / "store", tmp_path / "whole")


def share(settings, store, run, of=3):
    """Import by parts, whose tasks are done at once."""
    run(settings, store, part=ImportPart(BEGIN))

    def task(step, number):
        return lambda: run(settings, store, part=ImportPart(step, range(number, 200, of)))

    do_at_once(store, [task(READ_TILES, number) for number in range(of)])
    run(settings, store, part=ImportPart(FILL))
    assert not list(store.glob("data-*/read-*.part"))
    do_at_once(store, [task(MEASURE, number) for number in range(of)])
    run(settings, store)
    assert not list(store.glob("data-*/*.part"))


@pytest.mark.thorough
def test_tasks_of_a_mosaic_lose_nothing_either(tmp_path, mosaic):
    share(mosaic, tmp_path / "store", run_mosaic_import)
    assert_same(tmp_path / "store", tmp_path / "whole")


def test_damaged_parts_are_made_again(tmp_path, mosaic):
    store, numbers = tmp_path / "store", range(200)
    run_mosaic_import(mosaic, store, part=ImportPart(BEGIN))
    run_mosaic_import(mosaic, store, part=ImportPart(READ_TILES, numbers))
    damage(sorted(store.glob("data-*/read-*.part")))
    run_mosaic_import(mosaic, store, part=ImportPart(FILL))
    run_mosaic_import(mosaic, store, part=ImportPart(MEASURE, numbers))
    damage(sorted(store.glob("data-*/measured-*.part")))
    run_mosaic_import(mosaic, store)
    assert_same(store, tmp_path / "whole")


def damage(files):
    """Damage files: change a byte at the beginning or at the end, cut one short, empty one."""
    assert len(files) >= 5
    for file, at in zip(files, (0, -12, 7, -1), strict=False):
        content = bytearray(file.read_bytes())
        content[at] ^= 255
        file.write_bytes(content)
    files[3].write_bytes(files[3].read_bytes()[:-20])
    files[4].write_bytes(b"")


def test_a_task_that_runs_again_writes_nothing(tmp_path, mosaic):
    store = tmp_path / "store"
    run_mosaic_import(mosaic, store, part=ImportPart(BEGIN))
    for step in (READ_TILES, FILL, MEASURE):
        run_mosaic_import(mosaic, store, part=ImportPart(step, range(200) if step != FILL else ()))
        times = {file: file.stat().st_mtime_ns for file in store.glob("data-*/*.part")}
        run_mosaic_import(mosaic, store, part=ImportPart(step, range(200) if step != FILL else ()))
        assert times == {file: file.stat().st_mtime_ns for file in store.glob("data-*/*.part")}
