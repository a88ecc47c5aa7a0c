# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaped land with finer tiles beside plain numpy and a dense grid: heights, bounds, repeated and killed runs."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import finer_build
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE, known_tiles
from adaptive_terrain.cbt_terrain.field.packing import copy_store
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.height_operators import level_plan, shape_store
from adaptive_terrain.cbt_terrain.height_operators.finer_land import move_heights
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.preview import preview
from adaptive_terrain.cbt_terrain.height_operators.shape_process import ShapeJob
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.height_operators.tiles import levels_of, tiles_seen
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import contents
from finer_fields import KNOWN, dense_field, dense_heights, dense_raster, finer_store
from finer_views import assert_bound_in_metres, assert_bounds_in_random_views, places_on

HILL = Entry("hill", {"east": 1300.0, "north": 1500.0, "radius": 700.0})
# Snow lies where rivers have left sediment.
MASKED = Entry("snow", {"line": -900.0, "fall": 8.0}, mask=HeightMask(rules=(GroundRule("sediment", low=1e-3),)))
STACK = Stack((Entry("rivers", {"years": 4e5, "sea": -12000.0}), Entry("thermal"), Entry("relief"), MASKED))
ARRAYS = "numbers", "heights", "errors", "ranges", "limits"


@pytest.fixture(autouse=True)
def small_squares(monkeypatch):
    """Measure finer tiles in small squares: the bytes are the same."""
    monkeypatch.setattr(finer_build, "BLOCK", 5)


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """Return a store of 130 x 97 samples of 32 m, with finer tiles of 2 m in three places and a hole."""
    path = tmp_path_factory.mktemp("city") / "store"
    return finer_store(path, 97, 130, 4, KNOWN, hole=np.s_[60:70, 20:60])


@pytest.fixture(scope="module")
def shaped(city, tmp_path_factory):
    """Return the city's land after rivers, scree, relief, and snow on sediment."""
    path = tmp_path_factory.mktemp("shaped") / "land"
    run_shape(city, STACK, path)
    return path


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Return the field of the same land without a hole, shaped alike."""
    path = tmp_path_factory.mktemp("unbroken")
    run_shape(finer_store(path / "store", 97, 130, 4, KNOWN), STACK, path / "land")
    return open_store(path / "land")


@pytest.fixture(scope="module")
def country(tmp_path_factory):
    """Return a store of several levels: 650 x 600 samples of 20 m, with finer tiles of 5 m."""
    known = [(column, row) for column in range(3, 6) for row in range(3, 6)]
    return finer_store(tmp_path_factory.mktemp("country") / "store", 600, 650, 2, known, step=20.0)


def known_places(field, count, seed):
    """Return `places_on` a field outside of its holes."""
    found, lattice = places_on(field, count, seed), field.lattice
    if field.valid is None:
        return found
    cells = ((found - lattice.rectangle()[:2]) // (lattice.step_x, lattice.step_y)).astype(int)
    i, j = np.minimum(cells, (lattice.cells_x - 1, lattice.cells_y - 1)).T
    corners = [field.valid[j + down, i + across] for down in (0, 1) for across in (0, 1)]
    return found[np.all(corners, axis=0)]


@pytest.mark.thorough
def test_finer_heights_move_with_the_raster(city, shaped):
    """Also around the hole, and in tiles beyond the border."""
    before, after = open_store(city), open_store(shaped)
    bits = before.raster.finer.bits
    change = dense_raster(after, bits) - dense_raster(before, bits)
    found, expected = dense_heights(after), dense_heights(before) + change
    assert np.abs(found - expected).max() < 2.0 * np.spacing(np.float32(np.abs(expected).max()))
    relief = dense_heights(after) - dense_raster(after, bits)
    assert np.abs(change[np.abs(relief) > 0.5]).max() > 3.0
    assert after.samples.tobytes() != before.samples.tobytes() and set(after.layers) >= {"sediment", "snow"}
    assert (after.valid == before.valid).all() and after.layers["sediment"].shape == after.samples.shape
    assert after.layers["snow"].max() > 1.0


def test_unshaped_places_keep_their_bits(city, tmp_path):
    run_shape(city, Stack((HILL,)), tmp_path / "land")
    before, after = open_store(city), open_store(tmp_path / "land")
    bits, cells = before.raster.finer.bits, np.ones((96, 129), bool)
    for down, across in np.ndindex(2, 2):
        part = np.s_[down : down + 96, across : across + 129]
        cells &= before.heights()[part] == after.heights()[part]
    same = np.kron(cells, np.ones((1 << bits, 1 << bits), bool))
    counts = []
    for row, column in np.argwhere(before.raster.finer.numbers >= 0):
        part = same[SIDE * row : SIDE * (row + 1), SIDE * column : SIDE * (column + 1)]
        inner = np.s_[before.raster.finer.numbers[row, column], 1 : part.shape[0] + 1, 1 : part.shape[1] + 1]
        one, other = before.raster.finer.heights[inner], after.raster.finer.heights[inner]
        assert (one[part].view(np.uint32) == other[part].view(np.uint32)).all()
        counts += [part.sum(), (one != other).sum()]
    assert sum(counts[::2]) > 300_000 and sum(counts[1::2]) > 100_000


def test_a_mask_image_leaves_the_city_as_it_is(city, tmp_path):
    """It is black over all finer tiles and around them."""
    image = np.full((97, 130), 255, np.uint8)  # the first row is in the north
    image[96 - 85 :, :90] = 0
    np.save(tmp_path / "mask.npy", image)
    stack = Stack((Entry("rivers", STACK.entries[0].parameters), Entry("relief")))
    masked = HeightMask(str(tmp_path / "mask.npy"))
    run_shape(city, Stack(tuple(replace(entry, mask=masked) for entry in stack.entries)), tmp_path / "land")
    before, after = open_store(city), open_store(tmp_path / "land")
    assert np.abs(after.samples[:, 100:] - before.samples[:, 100:]).max() > 3.0
    for name in ("heights", "errors", "limits"):
        assert getattr(before.raster.finer, name).tobytes() == getattr(after.raster.finer, name).tobytes()


@pytest.mark.parametrize(
    "stack", [Stack((Entry("relief", on=False),)), pytest.param(Stack(), marks=pytest.mark.thorough)]
)
def test_an_empty_stack_copies_the_tiles(city, tmp_path, stack):
    run_shape(city, stack, tmp_path / "land")
    before, after = open_store(city), open_store(tmp_path / "land")
    assert before.samples.tobytes() == after.samples.tobytes() and before.error.tobytes() == after.error.tobytes()
    assert before.raster.finer.entry == after.raster.finer.entry
    for name in ARRAYS:
        assert getattr(before.raster.finer, name).tobytes() == getattr(after.raster.finer, name).tobytes()


def test_tiles_inside_the_ring_are_found_again():
    rng = np.random.default_rng(3)
    for _ in range(50):
        known = rng.random((rng.integers(1, 9), rng.integers(1, 9))) < rng.choice([0.05, 0.3, 0.9])
        there, wide = np.zeros(known.shape, bool), np.pad(known, 1)
        for down, across in np.ndindex(3, 3):
            there |= wide[down : down + known.shape[0], across : across + known.shape[1]]
        numbers = np.where(there, np.cumsum(there).reshape(there.shape) - 1, -1)
        found = set(known_tiles(numbers))
        assert {(column, row) for row, column in np.argwhere(known)} <= found
        again = np.zeros(known.shape, bool)
        for column, row in found:
            again[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
        assert (again == there).all()


def test_rounding_is_no_difference():
    before = np.array([100.1, 100.1, -0.0, 50.0])
    heights = np.array([100.1, 103.0, -0.0, 60.0], np.float32)
    found = move_heights(heights, before, np.array([70.3, 70.3, -0.0, 50.0]))
    assert found[0] == np.float32(70.3) and abs(found[1] - 73.2) < 1e-5
    assert found[2:].tobytes() == heights[2:].tobytes()


@pytest.mark.thorough
@pytest.mark.parametrize("meshlet", [0, 2])
def test_bounds_hold_in_random_views(unbroken, meshlet):
    field, places = unbroken, known_places(unbroken, 6000, 2)
    finest = assert_bounds_in_random_views(field, dense_field(field), places, 8 + meshlet, meshlet)
    assert finest > field.lattice.cell_depth + field.raster.finer.bits


@pytest.mark.parametrize("has_hole", [True, pytest.param(False, marks=pytest.mark.thorough)])
def test_bound_in_metres_holds_over_the_whole_mesh(request, shaped, has_hole):
    field = open_store(shaped) if has_hole else request.getfixturevalue("unbroken")
    assert_bound_in_metres(field, dense_field(field), known_places(field, 20_000, 3), (3.0, 1.0))


def files_of(path):
    """Return the bytes of the arrays of a store by name."""
    return {file.name: file.read_bytes() for file in path.glob("data-*/*.npy")}


@pytest.mark.thorough
def test_bytes_depend_on_neither_threads_nor_a_stopped_run(country, tmp_path, monkeypatch):
    """A run stops while finer tiles are measured; the next one measures the others alone."""
    stack, counts = Stack((Entry("smooth"), HILL)), []
    run_shape(country, stack, tmp_path / "one", threads=1)
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.run.launch.SLICE_ITEMS", 2)
    monkeypatch.setattr(finer_build, "BLOCK", 2)

    class NotedCache(shape_store.TileCache):
        """A cache whose counts are read afterwards."""

        def __init__(self, *arguments):
            super().__init__(*arguments)
            counts.append(self)

    monkeypatch.setattr(shape_store, "TileCache", NotedCache)

    def stop(fraction, message):
        if message == shape_store.FINER and fraction > 0.93:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_shape(country, stack, tmp_path / "three", on_progress=stop, threads=3)
    assert not list((tmp_path / "three").glob("data-*")) and not (tmp_path / "three" / "store.json").exists()
    run_shape(country, stack, tmp_path / "three", threads=3)
    assert files_of(tmp_path / "one") == files_of(tmp_path / "three")
    tiles = len(open_store(country).raster.finer.heights)
    for kind in ("finer_measured", "finer_ranged"):
        stopped, last = (cache.made[kind] for cache in counts)
        assert 0 < stopped < tiles and stopped + last == tiles and counts[1].kept[kind] == stopped
    assert counts[1].made["smooth"] == 0


@pytest.mark.thorough
def test_a_killed_process_leaves_what_it_has_measured(country, tmp_path):
    stack, land = Stack((Entry("relief"),)), tmp_path / "land"
    run_shape(country, stack, tmp_path / "undisturbed")
    job = ShapeJob(country, stack, land)
    while not (progress := job.poll()).done and (progress.message != shape_store.FINER or progress.fraction < 0.95):
        time.sleep(0.002)
    if not progress.done:
        os.kill(job._process.pid, signal.SIGKILL)
        while not job.poll().done:
            time.sleep(0.01)
        assert job.poll().error is not None and not (land / "store.json").exists()
    job = ShapeJob(country, stack, land)
    while not job.poll().done:
        time.sleep(0.01)
    assert job.poll().error is None and len(list(land.glob("data-*"))) == 1
    assert files_of(land) == files_of(tmp_path / "undisturbed")


@pytest.mark.thorough
def test_another_stack_measures_only_tiles_that_it_changes(country, tmp_path):
    """Ranges are measured again if the lowest or highest finer height differs."""
    low = Entry("hill", {"east": 5300.0, "north": 5300.0, "radius": 150.0, "height": 0.5})
    run_shape(country, Stack(), tmp_path / "one", tiles=tmp_path / "tiles")
    before = set(os.listdir(tmp_path / "tiles"))
    run_shape(country, Stack((low,)), tmp_path / "two", tiles=tmp_path / "tiles")
    sizes = [(tmp_path / "tiles" / name).stat().st_size for name in set(os.listdir(tmp_path / "tiles")) - before]
    measured = sum(136_192 + 4096 <= size < 136_192 + 4200 for size in sizes)
    assert 4 <= measured <= 16 < len(open_store(country).raster.finer.heights)


def test_land_in_tiles_has_the_finer_tiles_too(country, tmp_path, monkeypatch):
    """The visible tiles of a view are requested; later those of another one, too."""
    monkeypatch.setattr(level_plan, "MAX_WHOLE_FOR_TILES", 200)
    source = open_store(country)
    view = View.look((-5200.0, -4800.0, 900.0), (-4000.0, -4000.0, 0.0))
    wanted = tiles_seen(source, [view])
    assert 0 < len(wanted[0]) < levels_of(source.lattice)[0].tile_count
    report = run_shape(country, Stack((Entry("smooth"), Entry("relief"))), tmp_path / "land", wanted)
    assert report["tiles_built"] < report["tiles_there_are"] and report["finer_tiles"] == 25
    before, after = (dense_heights(f) - dense_raster(f, 2) for f in (source, open_store(tmp_path / "land")))
    assert np.abs(before - after).max() < 1e-4 < np.abs(before).max()
    assert "unchanged" in run_shape(country, Stack((Entry("smooth"), Entry("relief"))), tmp_path / "land", wanted)


def test_a_shaped_store_is_an_ordinary_one(city, shaped, tmp_path):
    content, before, after = read_json(shaped), open_store(city), open_store(shaped)
    assert content["version"] == 7 and content["finer"]["tiles"] == len(before.raster.finer.heights)
    report = describe(shaped)
    assert report["format"] == "shaped" and report["finer_step_m"] == [2.0, 2.0]
    assert {f"finer_{name}.npy" for name in ARRAYS} | {"layer_sediment.npy"} <= set(verify(shaped))
    assert run_shape(city, STACK, shaped)["unchanged"]
    copy_store(shaped, tmp_path / "copy")
    assert open_store(tmp_path / "copy").key == after.key != before.key
    run_shape(shaped, Stack((HILL,)), tmp_path / "again")
    again = open_store(tmp_path / "again")
    change = dense_raster(again, 4) - dense_raster(after, 4)
    assert np.abs(dense_heights(again) - dense_heights(after) - change).max() < 1e-4
    assert set(again.layers) > set(after.layers)


def test_keys_depend_on_the_finer_heights(city, tmp_path):
    """The rasters are equal, and so are their shaped surfaces."""
    other = finer_store(tmp_path / "other", 97, 130, 4, KNOWN[:2], hole=np.s_[60:70, 20:60])
    for number, source in enumerate((city, other)):
        run_shape(source, Stack((HILL,)), tmp_path / f"land{number}")
    one, two = (open_store(tmp_path / f"land{number}") for number in (0, 1))
    assert one.samples.tobytes() == two.samples.tobytes() and one.key != two.key


def test_a_preview_shows_the_raster_alone(city):
    found = preview(open_store(city), Stack((HILL, Entry("relief"))))
    assert found.field.raster.finer is None and found.field.samples.shape == (97, 130)
    assert Terrain(found.field).update(Criterion(error_px=0.0, error_m=5.0)).surface.triangles.size


def test_heights_that_are_not_finite_are_refused(city, tmp_path, monkeypatch):
    """Nothing is published, and files of the source stay."""
    before = contents(city)

    def not_finite(heights, *_surfaces):
        return np.full_like(heights, np.inf)

    monkeypatch.setattr("adaptive_terrain.cbt_terrain.height_operators.finer_land.move_heights", not_finite)
    with pytest.raises(TerrainError, match="not finite"):
        run_shape(city, Stack((HILL,)), tmp_path / "land")
    assert not (tmp_path / "land" / "store.json").exists() and contents(city) == before


def test_a_disk_without_room_for_the_tiles_is_refused(country, tmp_path, monkeypatch):
    class Usage:
        free = 25 * 477_000  # bytes of the tiles alone

    monkeypatch.setattr("shutil.disk_usage", lambda _path: Usage)
    with pytest.raises(TerrainError, match="MB"):
        run_shape(country, Stack(), tmp_path / "land")
