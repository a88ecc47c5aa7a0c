# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong from outside while a terrain is shaped: the store is as it was, and the next run goes on."""

import os
import shutil
import signal
import time

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.height_operators.shape_process import ShapeJob
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
RELIEF = Stack((Entry("relief", seed=1), Entry("relief", seed=2)))


@pytest.fixture(scope="module")
def island(tmp_path_factory):
    store = tmp_path_factory.mktemp("island") / "store"
    run_import(ImportSettings("island", size=1200), store)
    return store


def without_tiles(contents, store):
    """Return all files of a store without its tiles, which a run may leave for the next."""
    return {name: digest for name, digest in contents(store).items() if not name.startswith("tiles/")}


@pytest.mark.usefixtures("fork_children")
def test_a_killed_child_leaves_the_store_as_it_was(island, tmp_path, contents):
    run_shape(island, Stack((Entry("relief", seed=9),)), tmp_path / "out")
    before, killed = without_tiles(contents, tmp_path / "out"), 0
    for fraction in (0.0, 0.1, 0.4, 0.7, 0.81, 0.95):
        job = ShapeJob(island, RELIEF, tmp_path / "out")
        while job.poll().fraction < fraction and not job.poll().done:
            time.sleep(0.002)
        if not job.poll().done:
            os.kill(job._process.pid, signal.SIGKILL)
        while not job.poll().done:
            time.sleep(0.005)
        if job.poll().error is None:
            break  # it was quicker
        killed += 1
        assert "SIGKILL" in job.poll().error.what and without_tiles(contents, tmp_path / "out") == before
    assert killed >= 3
    report = run_shape(island, RELIEF, tmp_path / "out")
    assert "known before" in " ".join(report["levels"]) or "unchanged" in report
    verify(tmp_path / "out")
    run_shape(island, RELIEF, tmp_path / "alone")
    assert open_store(tmp_path / "out").samples.tobytes() == open_store(tmp_path / "alone").samples.tobytes()
    assert len(list((tmp_path / "out").glob("data-*"))) == 1


def test_a_cancelled_first_run_leaves_tiles_alone(island, tmp_path):
    job = ShapeJob(island, RELIEF, tmp_path / "out")
    while job.poll().fraction < 0.2:
        time.sleep(0.002)
    job.cancel()
    assert job.cancelled and "cancelled" in job.poll().error.what
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["tiles"]
    assert run_shape(island, RELIEF, tmp_path / "out")["samples"] == [1200, 1200]


def test_finishing_early_publishes_the_finished_levels(island, tmp_path):
    job = ShapeJob(island, RELIEF, tmp_path / "out")
    while job.poll().message == "Starting":
        time.sleep(0.002)
    job.finish_early()
    while not job.poll().done:
        time.sleep(0.005)
    report = job.poll().report
    assert report["finished_early"] and report["tiles_built"] < report["tiles_there_are"]
    assert report["finest_spacing_m"] > 7 and open_store(tmp_path / "out").samples.shape == (1200, 1200)
    rest = run_shape(island, RELIEF, tmp_path / "out")
    assert not rest["finished_early"] and rest["left_out_most_m"] == 0.0 and "unchanged" not in rest


def test_a_disk_that_fills_up_is_one_sentence(small_disk, contents):
    disk = small_disk(48 << 20)
    run_import(ImportSettings("island", size=700), disk / "island")
    run_shape(disk / "island", Stack(), disk / "out")
    before = without_tiles(contents, disk / "out")

    def fill(fraction, _message):
        if fraction > 0.5 and not (disk / "ballast").exists():
            (disk / "ballast").write_bytes(bytes(shutil.disk_usage(disk).free - (1 << 20)))

    with pytest.raises(TerrainError, match="make room"):
        run_shape(disk / "island", RELIEF, disk / "out", on_progress=fill)
    assert without_tiles(contents, disk / "out") == before
    (disk / "ballast").unlink()
    assert run_shape(disk / "island", RELIEF, disk / "out")["samples"] == [700, 700]
