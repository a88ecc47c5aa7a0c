# SPDX-License-Identifier: GPL-3.0-or-later
"""Stacks applied by levels and tiles: results, the tiles that are computed, and the cache."""

import dataclasses
from collections import namedtuple

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators import level_plan
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.height_operators.tile_cache import TileCache
from adaptive_terrain.cbt_terrain.height_operators.tiles import BAND, all_tiles, levels_of, whole_land
from land_effects import HILL, LEVEL, SMOOTH, bumpy

Usage = namedtuple("Usage", "total used free")
STEPS = 8.0, 11.0
STACK = Stack((Entry("smooth"), Entry("hill", {"east": 4000.0, "north": 3000.0}), Entry("level")))


@pytest.fixture(scope="module")
def land():
    return from_array(bumpy(700, 1000), *STEPS)


def some_tiles(field, *tiles):
    return [dict.fromkeys(tiles, 0.0), *({} for _ in levels_of(field.lattice)[1:])]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("asked", [whole_land, all_tiles])
def test_smoothing_equals_that_of_the_whole_raster(asked, seed):
    """Tiles with a halo of all sweeps give the same values to a float's last bits, for unequal steps."""
    heights = bumpy(700, 1000, seed)
    expected = apply_by_levels(SMOOTH, OperatorGround(heights, *STEPS), SMOOTH.defaults())
    field = from_array(heights, *STEPS)
    made = shape(field, Stack((Entry("smooth"),)), asked(field.lattice))
    assert abs(expected.heights).max() > 15
    assert abs(made.change - expected.heights).max() < 1e-4
    assert abs(made.layers["worn"] - expected.layers["worn"]).max() < 1e-4


def test_threads_and_the_order_of_tiles_change_no_bit(land, tmp_path):
    every = all_tiles(land.lattice)
    first = shape(land, STACK, every, threads=1)
    backwards = [dict(reversed(tiles.items())) for tiles in every]
    others = [shape(land, STACK, backwards, threads=n, cache=TileCache(tmp_path / "c")) for n in (2, 3)]
    for other in others:
        assert first.change.tobytes() == other.change.tobytes()
        assert all(first.layers[name].tobytes() == other.layers[name].tobytes() for name in first.layers)


def test_operators_read_the_results_of_earlier_ones(land):
    """The third operator reads a layer and the heights; the change is the sum of all."""
    made = shape(land, STACK, all_tiles(land.lattice))
    one = shape(land, Stack(STACK.entries[:1]), all_tiles(land.lattice))
    assert abs(made.layers["twice"] - 2 * one.layers["worn"]).max() < 1e-4
    two = shape(land, Stack(STACK.entries[:2]), all_tiles(land.lattice))
    before = land.heights() + two.change
    assert abs(made.change - two.change - 0.25 * (before.mean() - before)).max() < 1e-2
    assert made.depths == {"worn", "fresh", "twice"} and (made.layers["mark"] == 100).all()


def test_inactive_entries_are_not_computed(land):
    cache, off = TileCache(), Stack((Entry("smooth", on=False), Entry("hill", mask=HeightMask(factor=0.0))))
    made = shape(land, off, whole_land(land.lattice), cache=cache)
    assert not cache.made and not made.change.any() and not made.added and made.layers == {}


def test_only_requested_tiles_and_their_sources_are_computed(land):
    cache = TileCache()
    made = shape(land, Stack((Entry("smooth"),)), some_tiles(land, 7), cache=cache)
    assert [tuple(tiles) for tiles in made.tiles] == [(7,), (0, 1, 2, 3), (0,)]
    assert made.tile_counts == [12, 4, 1] and cache.made["smooth"] == 3
    whole = shape(land, Stack((Entry("smooth"),)), whole_land(land.lattice))
    rows, columns = levels_of(land.lattice)[0].window(7)
    inner = slice(rows.start + 16, rows.stop - 16), slice(columns.start + 16, columns.stop - 16)
    assert abs(made.change[inner] - whole.change[inner]).max() < 1e-4
    away = np.ones(land.samples.shape, bool)
    away[rows.start - 16 : rows.stop + 16, columns.start - 16 : columns.stop + 16] = False
    coarse = shape(land, Stack((Entry("smooth"),)), some_tiles(land))
    assert (made.change[away] == coarse.change[away]).all() and coarse.level == 1
    assert 0.5 < made.left_out_m[0] < made.left_out_m[1]


def test_a_tile_has_the_same_bytes_in_every_request(land, tmp_path):
    """One shot sees two tiles, another all, a third adds two to those of the first."""
    stack, level = Stack((Entry("smooth"),)), levels_of(land.lattice)[0]
    first = shape(land, stack, some_tiles(land, 2, 7), cache=TileCache(tmp_path))
    every = shape(land, stack, all_tiles(land.lattice))
    cache = TileCache(tmp_path)
    more = shape(land, stack, some_tiles(land, 2, 3, 7, 8), cache=cache)
    assert cache.made["smooth"] == 2 and not any(added.whole for added in every.added if added.level == 0)
    for tile in (2, 7):
        rows, columns = level.window(tile)
        inner = slice(rows.start + BAND, rows.stop - BAND), slice(columns.start + BAND, columns.stop - BAND)
        for other in (every, more):
            assert first.change[inner].tobytes() == other.change[inner].tobytes()
            assert first.layers["worn"][inner].tobytes() == other.layers["worn"][inner].tobytes()


def inner_of(level, tile):
    """Return the samples of a tile where no other tile has a weight."""
    return tuple(
        slice(part.start + BAND * (part.start > 0), part.stop - BAND * (part.stop < count))
        for part, count in zip(level.window(tile), level.shape, strict=True)
    )


SLOPE = HeightMask(rules=(GroundRule("slope", high=30.0, edge=10.0),))
MASKED = Stack((Entry("scree"), Entry("hill", mask=SLOPE), Entry("snow", {"line": -300.0}, mask=SLOPE)))
TWICE = Stack((Entry("scree", {"scree_angle": 40.0}, 3), Entry("scree", {"scree_angle": 24.0}, 5)))


@pytest.mark.parametrize("stack", [MASKED, pytest.param(TWICE, marks=pytest.mark.thorough)])
def test_a_tile_of_a_stack_has_the_same_bytes_in_every_request(stack):
    """It differs from the level in one piece by 1 % of the finest level's change. Over all tiles scree equals the
    removed rock to 1e-5, and slides of snow balance to 1e-4. Uneven samples, sides that fit no tile, holes."""
    heights = 2.0 * bumpy(290, 560, 4)
    heights[100:131, 140:200] = heights[200, 77] = np.nan
    field = from_array(heights, 9.0, 13.0, holes=True)
    every, lone = shape(field, stack, all_tiles(field.lattice)), shape(field, stack, some_tiles(field, 1), threads=2)
    level = levels_of(field.lattice)[0]
    inner, beside = inner_of(level, 1), inner_of(level, 2)
    assert lone.change[inner].tobytes() == every.change[inner].tobytes()
    assert all(layer[inner].tobytes() == every.layers[name][inner].tobytes() for name, layer in lone.layers.items())
    assert (lone.change[beside] != every.change[beside]).any()
    whole, coarse = (shape(field, stack, whole_land(field.lattice, finest)) for finest in (0, 1))
    off, moved = ((made.change - whole.change)[inner].std() for made in (lone, coarse))
    assert off < 0.01 * moved
    scree, wear = (every.layers[name].sum(dtype=np.float64) for name in ("scree", "wear"))
    assert wear > 1e4 and abs(scree - wear) < 1e-5 * wear and every.layers["scree"].min() >= 0.0
    slides = every.layers.get("slides", np.zeros(1)).astype(np.float64)
    assert abs(slides.sum()) <= 1e-4 * abs(slides).sum()


def test_no_operator_removes_more_scree_than_there_is():
    """A second operator moves scree from 40 to 24 degrees in one tile alone; a depth was once -0.75 m there."""
    y, x = np.indices((300, 700))
    land = 200 * np.sin(x / 31) * np.cos(y / 27) + 60 * np.random.default_rng(1).standard_normal(x.shape)
    field = from_array(land.astype(np.float32), 10.0, 10.0)
    stack = Stack(tuple(Entry("scree", {"scree_angle": angle}) for angle in (40.0, 24.0)))
    made = shape(field, stack, [{1: 0.0}, {}, {}][: len(levels_of(field.lattice))])
    assert made.layers["scree"].max() > 1.0 and made.layers["scree"].min() == 0.0


def test_the_ground_has_no_step_at_the_border_of_a_lone_tile(land):
    """Heights change from sample to sample along its border no more than inside."""
    made = shape(land, Stack((Entry("smooth"),)), some_tiles(land, 5))
    _, columns = levels_of(land.lattice)[0].window(5)
    jumps = abs(np.diff(made.change, axis=1)).max(axis=0)
    border = jumps[columns.stop - 20 : columns.stop + 20].max()
    assert border <= jumps.max() and border < 1.2 * jumps[columns.start + 20 : columns.stop - 20].max()


def test_further_requests_compute_only_new_tiles(land, tmp_path):
    stack = Stack(STACK.entries[:2])

    def made_by(stack, *tiles):
        cache = TileCache(tmp_path)
        shape(land, stack, some_tiles(land, *tiles), cache=cache)
        return dict(cache.made)

    assert made_by(stack, 0) == {"smooth": 3, "hill": 3}
    assert made_by(stack, 0) == {}
    assert made_by(stack, 0, 11) == {"smooth": 1, "hill": 1}
    other = Stack((stack.entries[0], Entry("hill", {"height": 7.0})))
    assert made_by(other, 0, 11) == {"hill": 4}
    assert made_by(Stack((Entry("smooth", {"sweeps": 2}), *other.entries[1:])), 0)["smooth"] == 3


def test_a_damaged_tile_is_computed_again(land, tmp_path):
    stack = Stack((Entry("hill"),))
    first = shape(land, stack, some_tiles(land, 0), cache=TileCache(tmp_path))
    for number, file in enumerate(sorted(tmp_path.glob("*.npy"))):
        content = bytearray(file.read_bytes())
        content[5000 + number] ^= 1
        file.write_bytes(content[: len(content) - 1000 * (number == 1)])
    cache = TileCache(tmp_path)
    again = shape(land, stack, some_tiles(land, 0), cache=cache)
    assert cache.made["hill"] == 3 and not cache.kept and first.change.tobytes() == again.change.tobytes()


def test_tiles_leave_room_for_the_store(land, tmp_path, monkeypatch):
    """9 of 10 free MB stay free; without any to spare nothing is cached. The result is the same."""
    free = 10_000_000

    def usage(_folder):
        return Usage(0, 0, free - sum(file.stat().st_size for file in tmp_path.glob("*.npy")))

    monkeypatch.setattr("shutil.disk_usage", usage)
    first = shape(land, Stack((Entry("smooth"),)), some_tiles(land, 0), cache=TileCache(tmp_path, 9_000_000))
    assert 9_000_000 <= usage(None).free < 10_000_000
    assert first.change.tobytes() == shape(land, Stack((Entry("smooth"),)), some_tiles(land, 0)).change.tobytes()
    shape(land, Stack((Entry("smooth"),)), some_tiles(land, 0), cache=TileCache(tmp_path / "other", 10_000_000))
    assert not list((tmp_path / "other").glob("*.npy"))


def test_levels_that_add_less_than_the_error_are_skipped(land):
    """Coarse levels show a wide hill; finer ones add millimetres, less than the allowed 1 m."""
    stack = Stack((Entry("hill", {"radius": 4e4, "east": 4000.0, "north": 3000.0}),))
    wanted = [dict.fromkeys(range(level.tile_count), 1.0) for level in levels_of(land.lattice)]
    cache = TileCache()
    made = shape(land, stack, wanted, cache=cache)
    exact = HILL.apply(OperatorGround(land.heights(), *STEPS), stack.entries[0].values, None).heights
    assert made.tiles[0] == [] and made.left_out_m[1] < 1.0 and abs(made.change - exact).max() < 1.0
    assert shape(land, stack, whole_land(land.lattice)).tiles[0] == list(range(12))


def test_a_tile_does_not_depend_on_the_allowed_error():
    """A tile next to a plain, which needs no finer level, starts from all tiles that it reads; and the plain's tiles
    that are computed for it request no finer ones."""
    y, x = np.indices((300, 1700))
    heights = np.where(x > 1040, 40.0, 0.5) * np.sin(x / 9) * np.cos(y / 11)
    field = from_array(heights.astype(np.float32), *STEPS)
    stack, levels = Stack((Entry("smooth", {"sweeps": 12}),)), levels_of(field.lattice)
    all_of, some = (
        shape(field, stack, [dict.fromkeys(tiles, metres) for tiles in all_tiles(field.lattice)])
        for metres in (0.0, 2.0)
    )
    assert 0 < len(some.tiles[0]) < len(all_of.tiles[0]) == levels[0].tile_count
    for number, tiles in enumerate(some.tiles[:2]):
        assert {levels[number].parent(tile) for tile in tiles} <= set(some.tiles[number + 1])
    for tile in some.tiles[0]:
        inner = tuple(slice(part.start + BAND, part.stop - BAND) for part in levels[0].window(tile))
        assert some.change[inner].tobytes() == all_of.change[inner].tobytes()


def test_holes_and_unchanged_samples_keep_their_bits():
    heights = bumpy(400, 333)
    heights[50:90, 60:99] = np.nan
    field = from_array(heights, 30.0, holes=True)
    made = shape(field, Stack((Entry("smooth"), Entry("hill", {"radius": 900.0}))), whole_land(field.lattice))
    assert not made.change[field.valid == 0].any() and made.change[field.valid == 1].any()
    hill = shape(field, Stack((Entry("hill", {"radius": 900.0}),)), whole_land(field.lattice)).change
    assert (hill[100:] == 0.0).all() and hill[33, 33] > 90


@pytest.mark.parametrize("asked", ["of a coarser level", "of an effect that ends there"])
def test_interpolated_changes_are_zero_in_holes(monkeypatch, asked):
    """Depths and states of 4 m samples are interpolated over holes of single samples."""
    monkeypatch.setitem(
        HEIGHT_OPERATORS, "hill", dataclasses.replace(HILL, finest=400 if asked.endswith("there") else 0)
    )
    heights = bumpy(700, 600)
    heights[np.random.default_rng(2).random(heights.shape) < 0.05] = np.nan
    field = from_array(heights, 2.0, holes=True)
    wanted = whole_land(field.lattice, 0 if asked.endswith("there") else 1)
    made = shape(field, Stack((Entry("hill", {"east": 500.0}),)), wanted)
    for samples in (made.change, made.layers["fresh"], made.layers["mark"]):
        assert not samples[field.valid == 0].any() and (samples[field.valid == 1] > 50.0).any()


def test_a_mask_scales_heights_and_depths_once(land):
    """A factor of 0.5 halves the result, however many levels there are."""
    whole = shape(land, Stack((Entry("hill"),)), whole_land(land.lattice))
    half = shape(land, Stack((Entry("hill", mask=HeightMask(factor=0.5)),)), whole_land(land.lattice))
    assert abs(half.change - 0.5 * whole.change).max() < 1e-5
    assert abs(half.layers["fresh"] - 0.5 * whole.layers["fresh"]).max() < 1e-5
    assert (half.layers["mark"] == whole.layers["mark"]).all(), "a state is no depth"
    high = HeightMask(rules=(GroundRule("height", low=50.0, edge=20.0),))
    ruled = shape(land, Stack((Entry("hill", {"radius": 1e5}, mask=high),)), whole_land(land.lattice))
    ground = land.heights()
    unmasked = shape(land, Stack((Entry("hill", {"radius": 1e5}),)), whole_land(land.lattice))
    assert not ruled.change[ground < 40].any() and abs(ruled.change / unmasked.change - 1)[ground > 60].max() < 1e-5


def test_no_tile_is_computed_where_the_mask_is_black(land):
    image = np.zeros((7, 10), np.float32)
    image[:, :2] = 1.0
    cache, stack = TileCache(), Stack((Entry("smooth", mask=HeightMask("m.png")),))
    made = shape(land, stack, some_tiles(land, 0, 3, 11), images={"m.png": image}, cache=cache)
    assert made.tiles[0] == [0] and made.added[-1].computed == 1
    assert made.change[:, :150].any() and not made.change[:, 300:].any()


def test_finishing_early_gives_the_complete_levels(land):
    calls = []

    def finish():
        calls.append(1)
        return len(calls) > 7  # five times a level, except the coarsest

    made = shape(land, Stack((Entry("smooth"),)), whole_land(land.lattice), finish=finish)
    coarse = shape(land, Stack((Entry("smooth"),)), some_tiles(land))
    assert made.finished_early and made.level == 1
    assert made.change[::2, ::2].tobytes() == coarse.change[::2, ::2].tobytes()


def test_finishing_early_leaves_no_spikes_at_cliffs():
    """Averages of heights never leave their range, unlike changes that are interpolated without regard to the cliff."""
    rows, columns = np.mgrid[:601, :301].astype(np.float32)
    ground = np.where(columns < 150 + 7 * np.sin(rows / 11), np.float32(100.0), np.float32(0.0))
    field, stack = from_array(ground, 10.0), Stack((Entry("smooth", {"sweeps": 40}),))
    made = shape(field, stack, whole_land(field.lattice), finish=lambda: True)
    after = ground + made.change
    assert made.finished_early and made.level == 2 and np.abs(made.change).max() > 10.0
    assert -1e-3 <= after.min() and after.max() <= 100.001
    assert not made.change[:, :20].any()
    plain = ground + shape(field, stack, some_tiles(field)).change
    assert plain.min() < -10.0 and plain.max() > 110.0


def test_tiles_of_a_global_operator_come_from_a_coarser_level(monkeypatch):
    monkeypatch.setattr(level_plan, "MAX_WHOLE_FOR_TILES", 600)
    field, cache = from_array(bumpy(300, 900), 5.0), TileCache()
    made = shape(field, Stack((Entry("level"),)), some_tiles(field, 0), cache=cache)
    assert cache.made["level"] == 2 and made.tiles[0] == [0]
    exact = LEVEL.apply(OperatorGround(field.heights(), 5.0, 5.0, whole=(300, 900)), LEVEL.defaults(), None).heights
    assert abs(made.change - exact)[::2, ::2].max() < 1.0


def test_doubted_levels_are_computed_in_one_piece(monkeypatch):
    """Two levels of 1300 samples would be computed in tiles. Only the whole level, of 20 m, is judged."""
    calls = []

    def doubts(_coarser, change, cell):
        calls.append((change.heights.shape, cell))
        return True

    field, plain = from_array(bumpy(300, 1300), 5.0), Stack((Entry("smooth"),))
    expected = shape(field, plain, whole_land(field.lattice))
    monkeypatch.setitem(HEIGHT_OPERATORS, "smooth", dataclasses.replace(SMOOTH, doubts=doubts))
    made = shape(field, Stack((Entry("smooth"),)), some_tiles(field, 3))
    assert all(added.whole and not added.doubtful for added in made.added) and len(made.added) == 4
    assert calls == [((76, 326), 400.0)] and made.tiles[0] == [3]
    assert made.change.tobytes() == expected.change.tobytes()


@pytest.mark.parametrize("asked", [whole_land, all_tiles])
def test_large_doubted_levels_are_computed_in_tiles_and_marked(asked, monkeypatch):
    monkeypatch.setattr(level_plan, "MAX_WHOLE", 900)
    monkeypatch.setitem(HEIGHT_OPERATORS, "smooth", dataclasses.replace(SMOOTH, doubts=lambda *_: True))
    field = from_array(bumpy(300, 1300), 5.0)
    made = shape(field, Stack((Entry("smooth"), Entry("hill"))), asked(field.lattice))
    finer = {(added.effect, added.level): (added.whole, added.doubtful) for added in made.added if added.level < 2}
    assert finer["smooth", 1] == (True, False) and finer["smooth", 0] == (False, True)
    assert not finer["hill", 0][1]


def test_the_cache_distinguishes_rasters_by_their_size(tmp_path):
    """Rasters whose rows differ by one have the same samples at level 1, but uplift fades towards their borders."""
    heights = bumpy(131, 601)
    heights[-2] = heights[-1]
    longer, shorter = from_array(heights, 20.0), from_array(heights[:-1].copy(), 20.0)
    stack = Stack((Entry("rivers", {"years": 1e5, "rise": 1e-3}),))
    shape(longer, stack, whole_land(longer.lattice), cache=TileCache(tmp_path))
    own, other = (shape(shorter, stack, whole_land(shorter.lattice), cache=c) for c in (None, TileCache(tmp_path)))
    assert own.change.tobytes() == other.change.tobytes()
