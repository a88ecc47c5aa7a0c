# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports in a child process: progress, cancel, rerun, crash, two at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing import build_store, earlier_import, tile_crew
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.earlier_import import finished_import, source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob, import_source
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.importing.source_list import absolute_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import child
from rasters import hills, write_exr, write_raster


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Return the settings of an import that soon reports progress and then has seconds of work: a file of zeros."""
    file = tmp_path_factory.mktemp("long") / "a.tif"
    shape = {"width": 1025, "height": 12 * 1024 + 1, "count": 1, "dtype": "float32"}
    with rasterio.open(file, "w", driver="GTiff", SPARSE_OK=True, **shape):
        pass
    assert file.stat().st_size < tile_crew.MIN_BYTES, "more processes would be started"
    return ImportSettings(str(file))


def snapshot(path):
    """Return the bytes and the modification time of everything in a folder."""
    return {p: p.stat().st_mtime_ns for p in path.rglob("*") if p.is_file()}


@pytest.fixture
def previous(tmp_path):
    """Write a store that must survive."""
    path = tmp_path / "store"
    run_import(ImportSettings(source="island", size=65), path)
    return path


def wait_until_working(job):
    while job.poll().fraction == 0.0 and not job.poll().done:
        time.sleep(0.01)
    assert not job.poll().done


def test_an_import_reports_progress_and_a_rerun_does_nothing(tmp_path, fork_children, monkeypatch):
    source = write_exr(tmp_path / "a.exr", Y=hills(129, 65))
    settings, store, seen = ImportSettings(source=str(source), extent=(1280.0, 640.0)), tmp_path / "store", []
    report = import_source(settings, store, on_progress=lambda fraction, message: seen.append((fraction, message)))
    assert report["step_m"] == [10.0, 10.0] and "unchanged" not in report
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0
    assert np.array_equal(open_store(store).heights(), hills(129, 65)[::-1])

    before = snapshot(store)
    monkeypatch.setattr(child, "start", lambda *_, **__: pytest.fail("a process was started"))
    again = import_source(settings, store)
    assert again == report | {"unchanged": True} and snapshot(store) == before


def test_a_digest_follows_the_settings_and_all_files(tmp_path):
    source = write_raster(tmp_path / "a.tif", hills())
    named = write_raster(tmp_path / "b.tif", hills())
    settings = ImportSettings(source=str(source))
    digests = [source_digest(settings), source_digest(ImportSettings(source=str(source), height_scale=2.0))]
    digests.append(source_digest(settings, (named,)))
    (tmp_path / "a.prj").write_text("LOCAL_CS")
    digests.append(source_digest(settings))
    os.utime(source, (0, 0))
    digests.append(source_digest(settings))
    digests.append(source_digest(settings, (named,)))
    os.utime(named, (0, 0))
    digests.append(source_digest(settings, (named,)))
    assert len(set(digests)) == len(digests) and source_digest(settings) in digests
    with pytest.raises(TerrainError, match="does not exist"):
        source_digest(ImportSettings(source=str(tmp_path / "c.tif")))


def test_a_file_has_the_same_digest_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    (tmp_path / "far" / "below").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "below")
    for path in (tmp_path / "inner", tmp_path / "far"):
        write_raster(path / "a.tif", hills())
    monkeypatch.chdir(tmp_path / "inner")
    inner, far = str(tmp_path / "inner" / "a.tif"), str(tmp_path / "far" / "a.tif")
    for written, whole in (
        (("a.tif",), (inner,)),
        (("../inner/a.tif", "../far/a.tif"), (inner, far)),
        (("../inner",), (str(tmp_path / "inner"),)),
        (("../inner/*.tif",), (str(tmp_path / "inner" / "*.tif"),)),
    ):
        digests = [source_digest(ImportSettings(names[0], more_sources=names[1:])) for names in (written, whole)]
        assert digests[0] == digests[1], written
    through = str(tmp_path / "link" / ".." / "a.tif")
    assert absolute_source(through) == through, "it is in the folder above the link's target"
    assert absolute_source("island") == "island" and absolute_source("../no.tif") == str(tmp_path / "no.tif")


def test_stores_of_relative_paths_are_found_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_raster(tmp_path / "a.tif", hills())
    write_raster(tmp_path / "b.tif", hills())
    (tmp_path / "elsewhere").mkdir()
    run_import(ImportSettings("a.tif"), "new")
    with monkeypatch.context() as older:  # these versions recorded sources as they were written
        for module in (earlier_import, build_store):
            older.setattr(module, "absolute_source", lambda source: source)
        run_import(ImportSettings("a.tif"), "old")
        run_import(ImportSettings(str(tmp_path / "a.tif")), "absolute")
    assert read_json(Path("new"))["provenance"]["settings"]["source"] == str(tmp_path / "a.tif")
    assert read_json(Path("old"))["provenance"]["settings"]["source"] == "a.tif"
    monkeypatch.chdir(tmp_path / "elsewhere")
    for store in ("new", "old", "absolute"):
        for source in (tmp_path / "a.tif", Path("../a.tif")):
            assert finished_import(tmp_path / store, ImportSettings(str(source))) is not None, (store, source)
        other = ImportSettings(str(tmp_path / "b.tif"))
        assert finished_import(tmp_path / store, other) is None, "a file of another name"
        assert finished_import(tmp_path / store, ImportSettings(str(tmp_path / "a.tif"), band=2)) is None
    os.utime(tmp_path / "a.tif", (0, 0))
    assert all(finished_import(tmp_path / store, ImportSettings("../a.tif")) is None for store in ("new", "old"))


def test_undeclared_no_data_warns(tmp_path):
    heights = np.arange(81, dtype=np.float32).reshape(9, 9)
    heights[4, 4] = -9999.0
    np.save(tmp_path / "a.npy", heights)
    settings = {"source": str(tmp_path / "a.npy"), "height_scale": 0.1, "height_offset": 7.0, "extent": (800.0, 800.0)}
    assert (
        "1 sample holds -9999, which stands apart"
        in run_import(ImportSettings(**settings), tmp_path / "a")["warnings"][0]
    )
    declared = run_import(ImportSettings(**settings, no_data=-9999.0), tmp_path / "b")
    assert declared["warnings"] == [] and declared["filled"] == 1
    heights[4, 4] = -9998.0
    np.save(tmp_path / "a.npy", heights)
    assert run_import(ImportSettings(**settings), tmp_path / "c")["warnings"] == []


def test_cancelling_leaves_the_previous_store(previous, long, fork_children):
    before = snapshot(previous)
    job = ImportJob(long, previous)
    wait_until_working(job)
    assert len(list(previous.glob("data-*"))) == 2
    job.cancel()
    progress = job.poll()
    assert progress.done and "was cancelled" in progress.error.what and progress.report is None
    assert snapshot(previous) == before and len(list(previous.glob("data-*"))) == 1
    job.cancel()  # nothing to do
    assert job.poll() == progress


def test_cancelling_a_first_import_leaves_no_folder(tmp_path, long, fork_children):
    def cancel(_fraction: float, _message: str) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        import_source(long, tmp_path / "new" / "store", cancel)
    assert not (tmp_path / "new").exists()


def test_a_file_that_cannot_be_read_leaves_no_folder(tmp_path, fork_children):
    (tmp_path / "dem.npy").write_bytes(b"damaged")
    with pytest.raises(TerrainError, match="not a whole .npy file"):
        import_source(ImportSettings(source=str(tmp_path / "dem.npy")), tmp_path / "a" / "b" / "store")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("SIGKILL", "memory"), pytest.param("SIGBUS", "make room on the disk", marks=pytest.mark.thorough)],
)
def test_a_killed_import_is_an_error_that_names_the_signal(previous, long, fork_children, name, remedy):
    before = snapshot(previous)
    job = ImportJob(long, previous)
    wait_until_working(job)
    os.kill(job._process.pid, signal.Signals[name])
    while not job.poll().done:
        time.sleep(0.01)
    error = job.poll().error
    assert f"signal {name}" in error.what and "the store is as it was before" in error.what and remedy in error.fix
    assert snapshot(previous).items() >= before.items()
    assert len(list(previous.glob("data-*/work.json"))) == 1, "it can be continued"


def test_a_killed_import_of_built_in_land_names_no_file(tmp_path, fork_children):
    job = ImportJob(ImportSettings(source="island", size=4097), tmp_path / "store")
    os.kill(job._process.pid, signal.SIGKILL)
    while not job.poll().done:
        time.sleep(0.01)
    assert "signal SIGKILL" in job.poll().error.what and job.poll().error.fix == "free some memory and try again"


def test_a_child_killed_after_publishing_has_done_its_work(previous, fork_children):
    job = ImportJob(ImportSettings(source="island", size=129), previous)
    job._process.wait()
    job._reader.join()
    del job._messages["report"]  # as if the child had not sent it
    assert job.poll().error is None and job.poll().report["samples"] == [129, 129]
    assert open_store(previous).samples.shape == (129, 129)


def test_an_import_ends_with_its_parent(tmp_path, long):
    script = (
        "import sys, time\n"
        "from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob\n"
        "from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings\n"
        f"job = ImportJob(ImportSettings({long.source!r}), {str(tmp_path / 'store')!r})\n"
        "while job.poll().fraction == 0.0: time.sleep(0.01)\n"
        "print(job._process.pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, env=environment())
    child = int(parent.stdout.readline())
    assert list((tmp_path / "store").glob("data-*"))
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 60.0
    while running(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not running(child) and not (tmp_path / "store" / "store.json").exists()
    assert len(list((tmp_path / "store").glob("data-*/work.json"))) == 1, "it can be continued"


def environment():
    return os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


def running(pid):
    """Return whether another's child process is alive (an unreaped zombie is not)."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.thorough
def test_two_imports_into_one_store_do_not_corrupt_it(tmp_path):
    jobs = [ImportJob(ImportSettings(source="island", size=513, seed=seed), tmp_path / "store") for seed in (1, 2)]
    while not all([job.poll().done for job in jobs]):
        time.sleep(0.01)
    assert [job.poll().error for job in jobs] == [None, None]
    field = open_store(tmp_path / "store")
    assert field.provenance["settings"]["seed"] in (1, 2)
    assert field.max_height == field.heights().max() and field.error.max() > 0.0


def test_errors_of_the_child_come_through_as_one_sentence(previous, fork_children):
    before = snapshot(previous)
    source = previous.parent / "a.tif"
    source.write_bytes(b"II*\0" + bytes(range(200)))
    with pytest.raises(TerrainError, match="a.tif cannot be read as GTiff .*; expected a whole file of that kind.$"):
        import_source(ImportSettings(source=str(source)), previous)
    assert snapshot(previous) == before


@pytest.mark.thorough
def test_the_calling_process_never_loads_the_file_libraries(tmp_path):
    source = write_raster(tmp_path / "a.tif", hills(33, 33))
    script = (
        "import sys\n"
        "from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings\n"
        "from adaptive_terrain.cbt_terrain.importing.import_process import import_source\n"
        f"report = import_source(ImportSettings(source={str(source)!r}), {str(tmp_path / 'store')!r})\n"
        "assert report['raster'] == [33, 33]\n"
        "assert not {'rasterio', 'OpenEXR', 'bpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env=environment(), timeout=300)


def test_the_steps_of_the_stored_values_are_reported(tmp_path):
    heights = hills(33, 33)
    for kind, scale, half in (
        ("uint16", 1.0, 0.5),
        ("int16", 0.25, 0.125),
        ("float16", 2.0, 0.5),
        ("float32", 1.0, 2.0**-15),
    ):
        source = tmp_path / f"{kind}.npy"
        np.save(source, heights.astype(kind))
        report = run_import(ImportSettings(source=str(source), height_scale=scale), tmp_path / kind)
        assert report["source_step_m"] == half == describe(tmp_path / kind)["source_step_m"]
        assert open_store(tmp_path / kind).source_max == half
    report = run_import(ImportSettings(source="island", size=65, height_scale=0.3), tmp_path / "island")
    assert report["source_step_m"] == open_store(tmp_path / "island").source_max == 0.0, "it is what it is"


def test_a_store_keeps_the_raster_itself_and_the_steepest_slopes(tmp_path):
    source = tmp_path / "a.npy"
    np.save(source, hills(40, 60))
    run_import(ImportSettings(source=str(source), extent=(390.0, 590.0)), tmp_path / "store")
    kept, made = open_store(tmp_path / "store"), from_array(hills(40, 60)[::-1], 10.0)
    assert kept.lattice.is_padded and np.array_equal(kept.heights(), hills(40, 60)[::-1])
    assert np.array_equal(kept.error, made.error)
    assert (kept.steepest_x, kept.steepest_y) == (made.steepest_x, made.steepest_y) and made.steepest_x > 0


def test_a_file_whose_scale_is_0_is_flat_ground(tmp_path):
    source = write_raster(tmp_path / "a.tif", hills(33, 33).astype(np.float32))
    with rasterio.open(source, "r+") as file:
        file.scales, file.offsets = (0.0,), (5.0,)
    report = run_import(ImportSettings(source=str(source)), tmp_path / "store")
    assert (report["lowest_m"], report["highest_m"], report["source_step_m"]) == (5.0, 5.0, 0.0)
