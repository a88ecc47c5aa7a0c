# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of finer tiles after a kill: they go on where they were, with the bytes of an undisturbed import."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import finer_heights, store_folder
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.importing import finer_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling import tile_work
from adaptive_terrain.cbt_terrain.tiling.tile_records import FINER, line_of
from finer_imports import BLOCK, WINDOW, assert_same, count_records, make_small
from mosaic_files import EAST, NORTH, UTM32, sheet

THOROUGH = pytest.mark.thorough
CITY = EAST + 1800.0, NORTH - 3200.0  # its corner in the north-west; its tiles meet four squares


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Let a small mosaic have finer tiles, in several windows and squares."""
    make_small(monkeypatch)


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    """Return the settings of a country of 32 m and of a city of 2 m on it, with missing heights."""
    folder = tmp_path_factory.mktemp("country")
    sheet(UTM32, EAST, NORTH, 32.0, 32.0, 220, 150).write(folder / "a_country.tif")
    sheet(UTM32, *CITY, 2.0, 2.0, 250, 250, shift=3.0).write(folder / "b_city.tif")
    return ImportSettings(source=str(folder))


@pytest.fixture(scope="module")
def whole(settings, tmp_path_factory):
    """Return a store that was imported without a disturbance, and the number of records of each kind."""
    store, counts = tmp_path_factory.mktemp("whole") / "store", dict.fromkeys(FINER, 0)
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        counted = count_records(patch)
        run_mosaic_import(settings, store)
        counts |= counted
    return store, counts


def test_the_mosaic_has_several_windows_and_squares(whole):
    counts = whole[1]
    assert counts[finer_heights.FILLED] >= 6
    assert counts[finer_heights.LIMITED] == counts[finer_heights.MEASURED] >= 4
    text = (store_folder.named_folder(whole[0]) / tile_work.RECORDS_NAME).read_text()
    assert {kind: text.count(f'"{kind}"') for kind in FINER} == counts


@pytest.mark.parametrize("share", [pytest.param(0.0, marks=THOROUGH), 0.3, pytest.param(0.8, marks=THOROUGH)])
def test_a_stopped_import_makes_only_what_is_missing(settings, whole, tmp_path, monkeypatch, share):
    total = sum(whole[1].values())
    done = int(share * total)
    with monkeypatch.context() as patch:
        count_records(patch, done)
        with pytest.raises(KeyboardInterrupt):
            run_mosaic_import(settings, tmp_path / "store")
    assert len(list((tmp_path / "store").glob("data-*"))) == 1 and not (tmp_path / "store" / "store.json").exists()
    store_folder.remove_abandoned(tmp_path / "store")
    counts, boxes, read = count_records(monkeypatch), [], finer_import._Windows._read

    def reading(self, *box):
        boxes.append(box)
        return read(self, *box)

    monkeypatch.setattr(finer_import._Windows, "_read", reading)
    run_mosaic_import(settings, tmp_path / "store")
    assert sum(counts.values()) == total - done
    assert len(boxes) == counts[finer_heights.FILLED]
    assert_same(tmp_path / "store", whole[0])


@pytest.fixture(scope="module")
def unpublished(settings, tmp_path_factory):
    """Return a store whose import was stopped just before it was published."""
    store = tmp_path_factory.mktemp("unpublished") / "store"

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        patch.setattr(stores, "check_version", stop)
        with pytest.raises(KeyboardInterrupt):
            run_mosaic_import(settings, store)
    return store


@pytest.fixture
def complete(unpublished, tmp_path):
    """Return the folder of arrays of a complete import into tmp_path / "store" that was not published."""
    shutil.copytree(unpublished, tmp_path / "store")
    [folder] = (tmp_path / "store").glob("data-*")
    return folder


def test_a_complete_import_is_not_made_again(settings, whole, complete, tmp_path, monkeypatch):
    store_folder.remove_abandoned(tmp_path / "store")  # as each import begins
    counts = count_records(monkeypatch)
    run_mosaic_import(settings, tmp_path / "store")
    assert sum(counts.values()) == 0
    assert_same(tmp_path / "store", whole[0])


KILLED = """
import os, signal, sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.field import finer_build, finer_heights
from adaptive_terrain.cbt_terrain.importing import finer_import
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
finer_plan.FEWEST, finer_build.BLOCK = 1 << 20, int(sys.argv[4])
finer_heights.WINDOW = finer_import.WINDOW = int(sys.argv[5])
left, note = int(sys.argv[3]), finer_import._WorkRecords.note
def killing(self, kind, number, **values):
    global left
    if not left:
        self._work.folder.joinpath(f"tiles-{0:032}.jsonl").write_text('{"sum": "0123')
        os.kill(os.getpid(), signal.SIGKILL)
    left -= 1
    note(self, kind, number, **values)
finer_import._WorkRecords.note = killing
run_mosaic_import(ImportSettings(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.thorough
@pytest.mark.parametrize("done", [3, 11])
def test_an_import_that_was_killed_goes_on(settings, whole, tmp_path, monkeypatch, done):
    store = tmp_path / "store"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", KILLED, settings.source, str(store), str(done), str(BLOCK), str(WINDOW)]
    assert subprocess.run(command, env=environment).returncode == -9
    counts = count_records(monkeypatch)
    run_mosaic_import(settings, store)
    assert sum(counts.values()) == sum(whole[1].values()) - done
    assert_same(store, whole[0])


@pytest.fixture(scope="module")
def almost_whole(settings, whole, tmp_path_factory):
    """Return a store whose import was stopped at its last record."""
    store = tmp_path_factory.mktemp("stopped") / "store"
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        count_records(patch, sum(whole[1].values()) - 1)
        with pytest.raises(KeyboardInterrupt):
            run_mosaic_import(settings, store)
    return store


@pytest.fixture
def stopped(almost_whole, tmp_path):
    """Return the folder of arrays of a stopped import into tmp_path / "store"."""
    shutil.copytree(almost_whole, tmp_path / "store")
    [folder] = (tmp_path / "store").glob("data-*")
    return folder


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["finer_heights", "finer_errors"])
@pytest.mark.parametrize("damage", ["cut off", "altered", "header", "gone"])
def test_damaged_leftovers_are_made_again(settings, whole, stopped, tmp_path, monkeypatch, name, damage):
    file = stopped / f"{name}.npy"
    array = np.load(file)
    if damage == "cut off":
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    elif damage == "altered":
        np.load(file, mmap_mode="r+")[len(array) // 2 + 3].reshape(-1)[20_000] += 1
    elif damage == "header":
        file.write_bytes(file.read_bytes().replace(b"shape", b"shaqe", 1))
    else:
        file.unlink()
    counts = count_records(monkeypatch)
    run_mosaic_import(settings, tmp_path / "store")
    kind = finer_heights.FILLED if name == "finer_heights" else finer_heights.MEASURED
    # The altered tile is in one window, and in one square, which may be the one that was not finished.
    assert 1 <= counts[kind] <= (2 if damage == "altered" else whole[1][kind])
    assert_same(tmp_path / "store", whole[0])


def test_links_in_leftovers_are_refused(settings, complete, tmp_path):
    file = complete / "finer_heights.npy"
    text = file.read_bytes()
    (tmp_path / "user.npy").write_bytes(text)
    file.unlink()
    file.symlink_to(tmp_path / "user.npy")
    with pytest.raises(TerrainError, match="holds 'data-.*finer_heights.npy'"):
        run_mosaic_import(settings, tmp_path / "store")
    assert (tmp_path / "user.npy").read_bytes() == text


def test_an_altered_raster_is_noticed(settings, whole, complete, tmp_path, monkeypatch):
    """Heights of the raster that were altered after they were measured are measured again, and so are finer tiles."""
    samples = np.load(complete / "samples.npy", mmap_mode="r+")
    samples[100:105] += samples.dtype.type(9)
    samples.flush()
    counts = count_records(monkeypatch)
    run_mosaic_import(settings, tmp_path / "store")
    # A tile has 16 cells: rows 100 to 104 are in its row 6, and measures depend on the tiles around.
    tiles = np.load(store_folder.named_folder(whole[0]) / "finer_numbers.npy")[5:8] >= 0
    assert counts[finer_heights.LIMITED] == tiles.sum() < whole[1][finer_heights.LIMITED]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change", [{"sums": 7, "limits": ["a", 1.0]}, {"figures": {}, "limits": [1.0]}, {"inputs": None}]
)
def test_records_with_impossible_entries_count_as_none(settings, whole, stopped, tmp_path, monkeypatch, change):
    for log in stopped.glob("tiles-*.jsonl"):
        records = [json.loads(line)["record"] for line in log.read_text().splitlines()]
        for record in records:
            if record["kind"] in FINER:
                record |= {name: value for name, value in change.items() if name in record}
        log.write_text("".join(map(line_of, records)))
    counts = count_records(monkeypatch)
    run_mosaic_import(settings, tmp_path / "store")
    assert sum(counts.values()) > 1
    assert_same(tmp_path / "store", whole[0])


def test_another_import_begins_again(settings, whole, complete, tmp_path, monkeypatch):
    counts = count_records(monkeypatch)
    run_mosaic_import(ImportSettings(settings.source, height_scale=2.0), tmp_path / "store")
    assert counts == whole[1] and len(list((tmp_path / "store").glob("data-*"))) == 1


def test_heights_of_another_shape_are_refused(settings, monkeypatch, tmp_path):
    monkeypatch.setattr(finer_import._Windows, "heights", lambda self, box: np.zeros((3, 3), np.float32))
    with pytest.raises((TerrainError, ValueError)):
        run_mosaic_import(settings, tmp_path / "store")
