# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels and tiles: they cover a raster, their weights add up to 1, and a camera's tiles are found."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.height_operators.levels import coarser, finer, finer_window
from adaptive_terrain.cbt_terrain.height_operators.tiles import (
    BAND,
    TileNeed,
    add_coarser,
    all_tiles,
    levels_of,
    tiles_seen,
)
from adaptive_terrain.cbt_terrain.view.view import View

SIZES = [(700, 1000), (513, 513), (514, 2050), (258, 1600), (3, 900), (1025, 770)]


@pytest.mark.parametrize("shape", SIZES)
def test_levels_are_every_second_sample(shape):
    samples = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    expected = samples
    for level in levels_of(fit(shape[1], shape[0], 2.0, 3.0)):
        rows, columns = (
            np.minimum(np.arange(n) << level.number, last - 1) for n, last in zip(level.shape, shape, strict=True)
        )
        expected = coarser(expected) if level.number else expected
        assert expected.shape == level.shape and level.step_y == 3.0 * 2**level.number
        assert (expected == samples[np.ix_(rows, columns)]).all()
    assert max(level.shape) <= 257


@pytest.mark.parametrize("shape", SIZES)
def test_weights_of_tiles_add_up_to_exactly_1(shape):
    for level in levels_of(fit(shape[1], shape[0], 1.0, 1.0)):
        total = np.zeros(level.shape, np.float32)
        for tile in reversed(range(level.tile_count)):
            total[level.window(tile, BAND, BAND)] += level.weights(tile)
        assert (total == 1.0).all()


@pytest.mark.parametrize("shape", SIZES)
def test_a_tile_is_inside_its_parent(shape):
    levels = levels_of(fit(shape[1], shape[0], 1.0, 1.0))
    for fine, coarse in zip(levels, levels[1:], strict=False):
        for tile in range(fine.tile_count):
            mine, its = fine.window(tile), coarse.window(fine.parent(tile))
            assert all(
                2 * i.start <= m.start and m.stop - 1 <= 2 * (i.stop - 1) for m, i in zip(mine, its, strict=True)
            )


def test_a_window_of_a_finer_level_has_the_bits_of_the_whole():
    rng = np.random.default_rng(3)
    for _ in range(200):
        rows, columns = rng.integers(2, 40, 2)
        coarse = rng.normal(size=(rows // 2 + 1, columns // 2 + 1)).astype(np.float32)
        r, c = (np.sort(rng.choice(n + 1, 2, replace=False)) for n in (rows, columns))
        part = finer_window(coarse, slice(*r), slice(*c))
        assert part.tobytes() == finer(coarse, (rows, columns))[r[0] : r[1], c[0] : c[1]].tobytes()


def test_coarser_tiles_that_tiles_start_from_are_needed():
    levels = levels_of(fit(4097, 4097, 1.0, 1.0))
    wanted = [{17: 0.25}, *({} for _ in levels[1:])]
    found = add_coarser(levels, wanted, [(100, 300)] * len(levels))
    # Tile 17 is the second of the second row: samples 256 to 512 both ways; with a band and its halo from 140 to 629
    # north and from -60 to 829 east, of which half are 70 to 315 and 0 to 415, and a band more.
    assert found[0] == {17: TileNeed(0.25, frozenset({17}))} and found[1] == {
        0: TileNeed(0.25, frozenset({0, 1, 8, 9}))
    }
    assert found[2] == {0: TileNeed(0.25, frozenset({0, 1, 4, 5}))}
    assert [len(tiles) for tiles in all_tiles(fit(4097, 4097, 1.0, 1.0))] == [256, 64, 16, 4, 1]


def flat(rows=1500, columns=2100):
    return from_array(np.zeros((rows, columns), np.float32), 10.0)


def test_a_view_from_above_needs_the_tiles_in_its_frame():
    """From 2 km, 1000 pixels over 90 degrees are 4 m apart below the eye. Level 0, of 10 m, is visible up to pixels of
    20 m, 10 km away; the frame reaches 2 km in each direction."""
    field = flat()
    seen = tiles_seen(field, [View.look((0, 0, 2000), (0, 0, 0), fov_deg=90, resolution=(1000, 1000))], pixel_error=0.5)
    level, west, south = levels_of(field.lattice)[0], -10495.0, -7495.0
    for tile in range(level.tile_count):
        j, i = divmod(tile, level.tiles[1])
        x, y = (np.clip((low, low + 2560.0), low, -low) for low in (west + i * 2560.0, south + j * 2560.0))
        inside = x[0] <= 2000 and x[1] >= -2000 and y[0] <= 2000 and y[1] >= -2000
        assert (tile in seen[0]) == inside
        if inside:
            nearest = np.hypot(np.hypot(*(max(a[0], -a[1], 0.0) for a in (x, y))), 2000.0) * 2 / 1000
            assert 2**-0.25 * 0.5 * nearest <= seen[0][tile] <= 0.5 * nearest * 1.0001
    assert 4 <= len(seen[0]) < level.tile_count == 54


def test_a_distant_view_needs_only_coarse_levels():
    field = flat()
    seen = tiles_seen(field, [View.look((0, -90_000, 9000), (0, 0, 0), fov_deg=50, resolution=(1000, 600))])
    assert seen[0] == seen[1] == {} and tiles_seen(field, []) == [{}] * len(seen)
    assert len(seen[3]) == levels_of(field.lattice)[3].tile_count


def test_a_view_of_the_sky_needs_no_tiles():
    assert tiles_seen(flat(), [View.look((0, 0, 500), (0, 0, 5000))]) == [{}] * 5
