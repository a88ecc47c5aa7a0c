# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores: written atomically, opened by mapping, damaged ones refused."""

import errno
import json
import math
import os
import shutil
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import bicubic, codes, store, store_arrays, store_folder
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import partial_files


@pytest.fixture
def island(tiny, tmp_path):
    return shutil.copytree(tiny, tmp_path / "store")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Write a store for tests that restore it."""
    path = tmp_path_factory.mktemp("tiny") / "store"
    run_import(ImportSettings(source="island", size=129), path)
    return path


DELETED = object()


def folders(path):
    return sorted(p.name for p in path.iterdir() if p.is_dir())


def test_a_store_opens_fast_and_read_only_on_disk(island):
    before = {p: p.stat().st_mtime_ns for p in island.rglob("*")}
    start = time.thread_time()  # of the processor, so that other programs do not count
    field = store.open_store(island)
    assert time.thread_time() - start < 0.05
    assert field.samples.shape == (129, 129) and field.path == island
    assert field.lattice.step_x == 64.0
    field.samples[:] = 0.0  # the mapping is private
    assert store.open_store(island).max_height == store.open_store(island).samples.max() > 1000.0
    assert {p: p.stat().st_mtime_ns for p in island.rglob("*")} == before


def test_meshlet_errors_are_kept_in_the_store(island):
    errors = error_for(store.open_store(island), 1)
    assert len(list(island.glob("data-*/error_m1.npy"))) == 1
    kept = error_for(store.open_store(island), 1)
    assert np.array_equal(kept, errors) and not list(island.glob("data-*/.partial-*"))


def test_a_bicubic_surface_is_kept_in_the_store(island):
    made = interpolated(store.open_store(island), "bicubic")
    names = {p.name for p in island.glob("data-*/*_c*")}
    assert names == {"error_c.npy", "ranges_c.npy", "numbers_c.npy"}
    assert error_for(made, 2).shape == made.error.shape and len(list(island.glob("data-*/error_c_m2.npy"))) == 1
    times = {p: p.stat().st_mtime_ns for p in island.rglob("*")}
    kept = interpolated(store.open_store(island), "bicubic")
    assert kept.key == made.key and kept.path == island
    for name in ("error", "ranges"):
        assert getattr(kept, name).tobytes() == getattr(made, name).tobytes()
    for name in bicubic.NUMBERS:
        assert getattr(kept, name) == getattr(made, name)
    assert np.array_equal(error_for(kept, 2), error_for(made, 2))
    assert {p: p.stat().st_mtime_ns for p in island.rglob("*")} == times
    assert np.array_equal(error_for(store.open_store(island), 2), error_for(interpolated(kept, "bilinear"), 2))
    run_import(ImportSettings(source="island", size=65), island)  # which takes all of it away
    assert not list(island.glob("data-*/*_c*")) and len(folders(island)) == 1


@pytest.mark.parametrize("how", ["missing", "short", "numbers", "not a number"])
def test_a_damaged_bicubic_surface_is_computed_again(island, how):
    made = interpolated(store.open_store(island), "bicubic")
    made = replace(made, error=made.error.copy(), ranges=made.ranges.copy())  # its files are about to change
    numbers = next(island.glob("data-*/numbers_c.npy"))
    if how == "missing":  # killed between two files, with a part left over
        left_over = numbers.parent / f".partial-{'0' * 32}"
        left_over.mkdir()
        (left_over / "ranges_c.npy").write_bytes(b"half")
        (numbers.parent / "ranges_c.npy").unlink()
    elif how == "short":
        os.truncate(numbers.parent / "error_c.npy", 5000)
    else:
        np.save(numbers, np.load(numbers) * (np.nan if how == "not a number" else -1.0))
    again = interpolated(store.open_store(island), "bicubic")
    assert again.error.tobytes() == made.error.tobytes() and again.ranges.tobytes() == made.ranges.tobytes()
    assert (again.range_base, again.min_height, again.steepest_x) == (made.range_base, made.min_height, made.steepest_x)
    kept = interpolated(store.open_store(island), "bicubic")
    assert kept.max_height == made.max_height and np.load(numbers)[1] > 0
    run_import(ImportSettings(source="island", size=65), island)  # the left-over is the store's own
    assert len(folders(island)) == 1


def test_a_readonly_store_still_gives_meshlet_errors(island, monkeypatch):
    def full(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_arrays, "all_checksums", full)
    assert error_for(store.open_store(island), 1).shape == store.open_store(island).error.shape
    assert interpolated(store.open_store(island), "bicubic").error.any()
    assert not list(island.glob("data-*/error_m1*")) and not list(island.glob("data-*/*_c*"))


def test_a_new_version_replaces_the_old_one_while_it_is_in_use(island):
    old = store.open_store(island)
    peak, names = float(old.samples.max()), folders(island)
    run_import(ImportSettings(source="island", size=129, seed=8), island)
    assert len(folders(island)) == 1 and folders(island) != names
    assert float(old.samples.max()) == peak  # still mapped
    assert error_for(old, 1).shape == old.error.shape  # kept in memory, not in the other terrain's folder
    assert not list(island.glob("data-*/error_m1*"))
    assert store.open_store(island).key != old.key


def test_leftovers_of_dead_imports_go(island):
    """At once those of this machine; those of others, which may be at work, after a day."""
    here = store_folder.new_data_name()
    fresh, stale, users, named = (island / f"data-{name}" for name in ("0" * 32, "1" * 32, "2" * 32, "2023"))
    for folder in (island / here, fresh, stale, users, named):
        folder.mkdir()
        (folder / "error_m1.npy").touch()
    (users / "photo.jpg").touch()
    for file in (stale / "error_m1.npy", stale, users, named):
        os.utime(file, (time.time() - 2 * partial_files.STALE_SECONDS,) * 2)
    living = store.Draft(island)
    run_import(ImportSettings(source="island", size=65), island)
    assert fresh.exists() and living.folder.exists() and not stale.exists() and not (island / here).exists()
    assert (users / "photo.jpg").exists() and named.exists()  # the user's own
    living.discard_unless_published()
    assert not living.folder.exists()


def test_the_current_arrays_of_a_store_stay_unlocked(island):
    [current] = folders(island)
    (island / current / "lock").touch()  # killed just after it was published
    store_folder.remove_abandoned(island)
    assert folders(island) == [current] and not (island / current / "lock").exists()
    (island / "store.json").write_text("{")
    store_folder.remove_abandoned(island)
    assert folders(island) == [current], "of a damaged store nobody knows what is of use"


@pytest.mark.parametrize("target", ["", ".", "photos", "file", "x" * 300, "a\0b"])
def test_a_store_is_only_written_into_a_folder_of_its_own(tmp_path, monkeypatch, target):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos" / "data-2023").mkdir(parents=True)
    (tmp_path / "file").touch()
    for start in (run_import, ImportJob):
        with pytest.raises(TerrainError, match="choose|expected the name"):
            start(ImportSettings(source="island", size=65), target)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["data-2023", "file", "photos"]


def test_empty_folders_and_leftovers_become_a_store(tmp_path):
    (tmp_path / f"data-{'0' * 32}").mkdir()
    run_import(ImportSettings(source="island", size=65), tmp_path)
    assert store.open_store(tmp_path).samples.shape == (65, 65)


def test_a_store_replaced_while_it_is_opened_is_opened_again(island, monkeypatch):
    real, calls = store.read_json, []

    def outdated_once(path):
        content = real(path)
        calls.append(1)
        return content | {"data": f"data-{'0' * 32}"} if len(calls) == 1 else content

    monkeypatch.setattr(store, "read_json", outdated_once)
    assert store.open_store(island).samples.shape == (129, 129)


def small_field(draft):
    samples = draft.allocate("samples", (9, 9), np.float32)
    samples[:] = np.arange(81, dtype=np.float32).reshape(9, 9)
    return build(samples, 1.0, 1.0, missing=0, allocate=draft.allocate)


UNFIT = {
    "source_max": {"source_max": math.inf},
    "origin": {"origin": np.array([1e301, 0.0, 0.0])},
    "steepest_x": {"steepest_x": math.nan},
    "steps": {"steps": codes.Steps(0, 1e31, 0.0)},
    "provenance": {"provenance": {"settings": {"source": 5}}},
    "description": {"crs": "x" * store.MAX_JSON_BYTES},
    "samples.npy": {},
}


@pytest.mark.parametrize("entry", UNFIT)
def test_a_version_that_cannot_be_opened_is_not_published(tiny, entry, monkeypatch):
    before = {file: file.read_bytes() for file in tiny.rglob("*") if file.is_file()}
    draft = store.Draft(tiny)
    field = small_field(draft)
    if entry == "samples.npy":
        monkeypatch.setattr(
            store_arrays, "all_checksums", lambda array: b"0000" * store_arrays.block_count(array.nbytes)
        )
    else:
        [name] = UNFIT[entry]
        change = field.with_raster if hasattr(field.raster, name) else partial(replace, field)
        field = change(**UNFIT[entry])
    with pytest.raises(TerrainError, match=entry):
        draft.publish(field, "", {})
    draft.discard_unless_published()
    assert {file: file.read_bytes() for file in tiny.rglob("*") if file.is_file()} == before


def test_a_report_that_cannot_be_read_is_not_published(tiny):
    key, draft = store.open_store(tiny).key, store.Draft(tiny)
    with pytest.raises(TerrainError, match="'report'"):
        draft.publish(small_field(draft), "", {"lowest_m": math.inf})
    draft.discard_unless_published()
    assert store.open_store(tiny).key == key


# Flat ground has no height beyond the limit, whatever its scale is.
EXTREME = [("int16", 1e31, 0.0), ("float32", 1e305, 0.0), ("uint8", 1e-320, 1e29)]


@pytest.mark.parametrize("kind, scale, offset", EXTREME)
def test_an_import_of_extreme_scales_never_ruins_a_store(tiny, tmp_path, kind, scale, offset):
    key = store.open_store(tiny).key
    np.zeros((9, 9), kind).tofile(tmp_path / "flat.raw")
    settings = ImportSettings(str(tmp_path / "flat.raw"), raw_dtype=kind, height_scale=scale, height_offset=offset)
    try:
        run_import(settings, tiny)
    except TerrainError as error:
        assert f"The store {tiny} stays as it was" in str(error) and store.open_store(tiny).key == key
    else:
        assert store.open_store(tiny).samples.shape == (9, 9)
        run_import(ImportSettings(source="island", size=129), tiny)


def damage(path, how):
    content = json.loads((path / "store.json").read_text())
    data = path / content["data"]
    if how == "no json":
        (path / "store.json").unlink()
    elif how == "half a json":
        (path / "store.json").write_text('{"version": 2, "da')
    elif how == "other version":
        (path / "store.json").write_text(json.dumps(content | {"version": 99}))
    elif how == "other version with finer tiles":
        (path / "store.json").write_text(json.dumps(content | {"version": 6, "finer": {}}))
    elif how == "no term of the source":
        del content["source_max"]
        (path / "store.json").write_text(json.dumps(content | {"version": 3}))
    elif how == "no lattice":
        del content["lattice"]
        (path / "store.json").write_text(json.dumps(content))
    elif how == "array missing":
        (data / "error.npy").unlink()
    elif how == "array a folder":
        (data / "error.npy").unlink()
        (data / "error.npy").mkdir()
    elif how == "array truncated":
        os.truncate(data / "error.npy", 1000)
    elif how == "array of another shape":
        np.save(data / "samples.npy", np.zeros((5, 5), np.float32))


DAMAGES = {
    "no json": "no terrain store",
    "half a json": "cannot be read",
    "other version": "version 99; expected version 6",
    "other version with finer tiles": "version 6; expected version 7",
    "no term of the source": "version 3; expected version 6: import it again",
    "no lattice": "damaged",
    "array missing": "lacks error.npy",
    "array a folder": "error.npy is damaged",
    "array truncated": "error.npy is damaged",
    "array of another shape": r"samples.npy is damaged \(its header is not that of float32 \(129, 129\)",
}


@pytest.mark.parametrize("how", DAMAGES)
def test_a_damaged_store_is_a_clear_error(island, how):
    damage(island, how)
    with pytest.raises(TerrainError, match=DAMAGES[how]):
        store.open_store(island)
    run_import(ImportSettings(source="island", size=129), island)  # and importing again mends it
    assert store.open_store(island).samples.shape == (129, 129)


LATTICE = {"width": 129, "height": 129, "step_x": 64.0, "step_y": 64.0}
BAD_ENTRIES = [
    *(("lattice", LATTICE | {"width": width}) for width in (-3, 1_200_000_000, 129.0, True, "129", None)),
    *(("lattice", LATTICE | {"step_x": step}) for step in (0, -1.0, math.nan, math.inf, 1e300, 10**400, "1", None)),
    *(("lattice", LATTICE | {name: value}) for name in ("width", "height") for value in (0, 1, 2**40, 1.5)),
    *(("lattice", value) for value in ([], 5, LATTICE | {"more": 1}, {"width": 129})),
    *(("origin", value) for value in ("abc", None, [1, 2], [1, 2, math.nan], [1, 2, "3"], [1, 2, 10**400], 5)),
    *((name, value) for name in ("min_height", "range_base") for value in (math.nan, "1", None, True, [1])),
    *(("max_height", value) for value in (math.inf, -1e9)),
    *((name, value) for name in ("range_step",) for value in (-1, math.nan, "1")),
    *(("source_max", value) for value in (-1, math.nan, "1", None, DELETED)),
    *(("filled", value) for value in (-1, 0.5, "0")),
    *(("holes", value) for value in (1, None, DELETED)),
    *((name, value) for name in ("key", "crs", "digest") for value in (5, None, [])),
    *(("report", value) for value in (5, None, [], DELETED)),
    *(("provenance", value) for value in (None, 5, {"settings": None}, {"settings": {"source": 5}}, DELETED)),
    *(("data", value) for value in ("", "..", "data-", "/tmp", 5, None, "data-" + "0" * 31 + "/")),
]


@pytest.mark.parametrize(("name", "value"), BAD_ENTRIES)
def test_every_entry_is_checked(tiny, name, value):
    content = json.loads((tiny / "store.json").read_text())
    changed = content | {name: value}
    if value is DELETED:
        del changed[name]
    (tiny / "store.json").write_text(json.dumps(changed))
    for opened in (store.open_store, describe):
        with pytest.raises(TerrainError, match="store.json is damaged") as caught:
            opened(tiny)
        assert ("min_height" if name == "max_height" else name) in str(caught.value) or "max_height" in str(
            caught.value
        )
    (tiny / "store.json").write_text(json.dumps(content))


def test_a_nested_json_and_a_pipe_are_no_store(tiny):
    kept = (tiny / "store.json").read_text()
    (tiny / "store.json").write_text("[" * 100_000)
    with pytest.raises(TerrainError, match="cannot be read"):
        store.open_store(tiny)
    (tiny / "store.json").unlink()
    os.mkfifo(tiny / "store.json")
    with pytest.raises(TerrainError, match="not a regular file"):
        store.open_store(tiny)
    (tiny / "store.json").unlink()
    (tiny / "store.json").write_text(kept)


def test_describe_names_units_and_is_plain_data(island):
    about = describe(island)
    assert about["samples"] == [129, 129] and about["extent_m"] == [8192.0, 8192.0]
    assert about["highest_m"] > 1000.0 and about["largest_error_m"] > 0.0
    assert 7.0 < about["bytes_per_sample"] < 16.0  # of a small raster, with its padding
    json.dumps(about)
    with pytest.raises(TerrainError, match="no terrain store"):
        describe(island / "nowhere")


def test_arrays_begin_on_a_page(tmp_path):
    """A page of the hierarchy is a page of memory, and the files are .npy files that numpy reads."""
    draft = store.Draft(tmp_path / "store")
    array = draft.allocate("ranges", (5, 2), np.uint16)
    array[:] = np.arange(10).reshape(5, 2)
    del array
    file = draft.folder / "ranges.npy"
    assert file.stat().st_size == 4096 + 20 + 4  # with one checksum
    assert np.array_equal(np.load(file), np.arange(10).reshape(5, 2))


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limit of file sizes")
def test_an_array_that_does_not_fit_names_the_reason(tmp_path):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError) as failure:
            store_arrays.write_array(tmp_path / "a.npy", np.zeros(10_000, np.float32))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert failure.value.errno == errno.EFBIG and list(tmp_path.iterdir()) == []
