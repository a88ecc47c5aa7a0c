# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong from outside while a height map is imported: one clear error, and the store as it was."""

import os
import signal
import time

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.operators.cli import command_line
from forked_programs import COMMAND_LINE, run_program
from invariants import assert_invariants
from rasters import hills, write_exr, write_raster

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals, mounts and limits are those of POSIX")
LONG = ImportSettings(source="island", size=2049)


def wait_for(job, fraction):
    """Until the import is so far; it must not be done."""
    while job.poll().fraction < fraction and not job.poll().done:
        time.sleep(0.005)
    assert not job.poll().done


def assert_works(store):
    """Assert that the store opens and a mesh of it keeps the invariants."""
    field = open_store(store)
    assert_invariants(Terrain(field, 1).update(Criterion(error_px=0, error_m=20.0)).surface, field.lattice)


KILLS = [(0.3, signal.SIGTERM), (0.6, signal.SIGKILL)]
MORE_KILLS = [(0.001, signal.SIGKILL), (0.3, signal.SIGSEGV)]


@pytest.mark.usefixtures("fork_children")
@pytest.mark.parametrize(
    ("fraction", "killed_by"), [*KILLS, *(pytest.param(*kill, marks=pytest.mark.thorough) for kill in MORE_KILLS)]
)
def test_the_child_is_killed(tmp_path, contents, fraction, killed_by):
    store = tmp_path / "store"
    run_import(ImportSettings(source="island", size=65), store)
    before = contents(store)
    job = ImportJob(LONG, store)
    wait_for(job, fraction)
    os.kill(job._process.pid, killed_by)
    while not job.poll().done:
        time.sleep(0.005)
    assert f"signal {killed_by.name}" in str(job.poll().error) and "\n" not in str(job.poll().error)
    assert contents(store) == before
    run_import(ImportSettings(source="island", size=129), store)
    assert open_store(store).samples.shape == (129, 129) and len(list(store.glob("data-*"))) == 1
    assert_works(store)


@pytest.mark.usefixtures("fork_children")
def test_the_child_of_a_first_import_is_killed(tmp_path):
    job = ImportJob(LONG, tmp_path / "store")
    wait_for(job, 0.001)
    os.kill(job._process.pid, signal.SIGKILL)
    while not job.poll().done:
        time.sleep(0.005)
    assert not (tmp_path / "store").exists()


def fill(disk):
    """Take all the room that a disk has left."""
    with (disk / "ballast").open("wb", buffering=0) as ballast:
        size = 1 << 16
        while size:
            try:
                ballast.write(bytes(size))
            except OSError:
                size //= 2


@pytest.mark.parametrize("when", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("holes", [False, True])
def test_the_disk_fills_up_while_the_import_runs(small_disk, contents, tmp_path, when, holes):
    disk = small_disk(24 << 20)
    store = disk / "store"
    run_import(ImportSettings(source="island", size=65), store)
    before, seen = contents(store), []
    heights = np.random.default_rng(0).normal(0.0, 100.0, (1025, 1025)).astype(np.float32)
    heights[300:700, 300:900] = np.nan
    np.save(tmp_path / "hills.npy", heights)

    def on_progress(fraction, _message):
        if fraction >= when and not seen:
            fill(disk)
            seen.append(fraction)

    try:
        run_import(ImportSettings(source=str(tmp_path / "hills.npy"), holes=holes), store, on_progress)
    except TerrainError as error:
        assert "No space left on device" in str(error) and "make room" in str(error)
        assert contents(store) == before
    else:
        assert not holes, "all arrays but that of holes had their room, and so had store.json in a page that was there"
    assert seen and len(list(store.glob("data-*"))) == 1
    (disk / "ballast").unlink()
    run_import(ImportSettings(source="island", size=513), store)
    assert open_store(store).samples.shape == (513, 513) and len(list(store.glob("data-*"))) == 1
    assert_works(store)


FILLED_WHILE_READING = """
import sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling.tile_work import TileWork
from faults.test_import_faults import fill
source, disk = sys.argv[1:]
write = TileWork.write_heights
def write_on_a_full_disk(*arguments):
    fill(Path(disk))
    return write(*arguments)
TileWork.write_heights = write_on_a_full_disk
run_import(ImportSettings(source=source), disk + "/store")
"""


def test_the_disk_is_full_when_gaps_are_marked(small_disk, tmp_path):
    """The file of marks has no room yet; writing to its mapping would end the process."""
    disk, heights = small_disk(12 << 20), hills().astype(np.float32)
    heights[3:9, 3:9] = np.nan
    np.save(tmp_path / "hills.npy", heights)
    done = run_program(FILLED_WHILE_READING, tmp_path / "hills.npy", disk)
    assert done.returncode == 1 and "No space left on device): make room" in done.stderr, done.stderr
    assert not list((disk / "store").glob("data-*"))


def test_the_disk_is_full_before_the_import_begins(small_disk, capfd, contents):
    disk = small_disk(2 << 20)
    store = disk / "store"
    run_import(ImportSettings(source="island", size=65), store)
    before = contents(store)
    fill(disk)
    assert command_line.main(["import", "island", "--size", "257", "--store", str(store)]) == 1
    said = capfd.readouterr().err
    assert "make room" in said and "Traceback" not in said
    assert contents(store) == before


def test_a_mesh_is_made_though_its_expanded_errors_find_no_room(small_disk):
    disk = small_disk(2 << 20)
    run_import(ImportSettings(source="island", size=257), disk / "store")
    fill(disk)
    field = open_store(disk / "store")
    update = Terrain(field, 1).update(Criterion(error_px=0, error_m=20.0, meshlet=2))
    assert_invariants(update.surface, field.lattice, meshlet=2)
    [folder] = (disk / "store").glob("data-*")
    assert sorted(path.name for path in folder.iterdir()) == ["error.npy", "ranges.npy", "samples.npy"]


LIMITED = """
import resource, sys
size = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
"""


@pytest.mark.parametrize("size", [100, pytest.param(5000, marks=pytest.mark.thorough), 300_000])
def test_no_file_may_be_larger(tmp_path, contents, size):
    """A limit of the system on the size of files (a quota ends the same way)."""
    store = tmp_path / "store"
    run_import(ImportSettings(source="island", size=65), store)
    before = contents(store)
    done = run_program(LIMITED + COMMAND_LINE, size, "import", "island", "--size", "513", "--store", store)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert contents(store) == before


HOW = ["deleted", "cut to half", "emptied"]
SOURCES = {
    "a.tif": lambda path: write_raster(path, hills(1025, 1025), tiled=True, blockxsize=256, blockysize=256),
    "a.exr": lambda path: write_exr(path, Y=hills(1025, 513)),
    "a.npy": lambda path: np.save(path, hills(1025, 1025)),
    "a.png": lambda path: write_raster(path, hills(1025, 513).astype(np.uint16)),
}


@pytest.mark.usefixtures("fork_children")
@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize(
    "name", ["a.tif", *(pytest.param(name, marks=pytest.mark.thorough) for name in SOURCES if name != "a.tif")]
)
def test_the_file_vanishes_while_it_is_imported(tmp_path, contents, name, how):
    store, source = tmp_path / "store", tmp_path / name
    run_import(ImportSettings(source="island", size=65), store)
    before = contents(store)
    SOURCES[name](source)
    job = ImportJob(ImportSettings(source=str(source), height_scale=1.0), store)
    while job.poll().fraction == 0.0 and not job.poll().done:
        time.sleep(0.001)
    if how == "deleted":
        source.unlink()
    else:
        os.truncate(source, source.stat().st_size // 2 if how == "cut to half" else 0)
    while not job.poll().done:
        time.sleep(0.005)
    progress = job.poll()
    if progress.error is None:  # all of it had been read, or an open file stays whole
        assert open_store(store).max_height > 700.0
    else:
        assert name in str(progress.error) and "\n" not in str(progress.error)
        assert contents(store) == before
    assert len(list(store.glob("data-*"))) == 1
    assert_works(store)
