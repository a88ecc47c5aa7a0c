# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles cover the ground, are numbered as UDIM counts, and are as fine as what looks at them needs."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sizing, tiling
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.decals import Decal, picture
from adaptive_terrain.cbt_terrain.attributes.tiling import MAX_SIDE, tiling_of
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from fields import rough


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(tiling, "SINGLE_CELLS", 32)
    monkeypatch.setattr(tiling, "TILE_CELLS", 31)


@pytest.mark.parametrize("size", [(4097, 4097), (16385, 16385), (1001, 9001), (100_001, 3001), (2000, 40_001)])
@pytest.mark.parametrize("steps", [(1.0, 1.0), (2.0, 5.0)])
def test_tiles_cover_the_ground_and_can_be_numbered(size, steps):
    lattice = fit(*size, *steps)
    tiles = tiling_of(lattice)
    west, south, east, north = lattice.rectangle()
    assert tiles.columns <= 10 and tiles.rows <= 99
    assert tiles.box(0)[:2] == (west, south)
    assert np.allclose(tiles.box(len(tiles) - 1)[2:], (east, north))
    numbers = [tiles.udim_number(tile) for tile in range(len(tiles))]
    assert numbers[0] == 1001 and len(set(numbers)) == len(tiles) and max(numbers) < 2001


def test_a_small_terrain_is_one_image_over_all_of_it():
    tiles = tiling_of(fit(1000, 700))
    assert len(tiles) == 1 and tiles.margin == 0.0
    assert lookup(tiles, 0.25, 1.0) == (0.25, 1.0)


def lookup(tiles, u: float, v: float) -> tuple[float, float]:
    """Return the image coordinates of the ground at `u`, `v` (0 .. 1 over the raster), as a material's nodes do."""
    found = []
    for at, count in ((u, tiles.columns), (v, tiles.rows)):
        place = at * count
        tile = min(math.floor(place), count - 1)
        found.append(place * tiles.inner + (tile * 2.0 + 1.0) * tiles.margin)
    return found[0], found[1]


@pytest.mark.parametrize("side", [64, 256, 1024])
def test_a_look_up_finds_the_texel_of_the_place(small_tiles, side):
    lattice = fit(200, 150, 2.0, 3.0)
    tiles = tiling_of(lattice)
    west, south, east, north = lattice.rectangle()
    step_x, step_y = tiles.texel(side)
    for u, v in np.random.default_rng(0).random((200, 2)).tolist() + [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0)]:
        across, up = lookup(tiles, u, v)
        column, row = math.floor(across), math.floor(up)
        tile = row * tiles.columns + column
        first_x, first_y = tiles.first_texel(tile, side)
        # Texel k is centred (k + 1/2) / side from the image's western rim; rows are counted from the north.
        x = first_x + ((across - column) * side - 0.5) * step_x
        y = first_y - ((1 - (up - row)) * side - 0.5) * step_y
        assert abs(x - (west + u * (east - west))) < 1e-9 * (east - west)
        assert abs(y - (south + v * (north - south))) < 1e-9 * (north - south)
        least = tiling.MARGIN - 1e-12  # at least one texel from the image's rim
        assert least <= across - column <= 1 - least and least <= up - row <= 1 - least


def sized(tiles, field, footprints, texel_bytes, **budget):
    return sizing.resolutions(tiles, footprints, sizing.shown_by(tiles, field, ()), texel_bytes, **budget)


def _boxes(field):
    return sizing.boxes(tiling_of(field.lattice), field, 1.0, 0.0)


def test_boxes_hold_the_ground_of_their_tiles(small_tiles):
    field = rough(90, 130, step=2.0)
    tiles = tiling_of(field.lattice)
    boxes = sizing.boxes(tiles, field, -2.0, 30.0)
    west, south, _, _ = field.lattice.rectangle()
    x, y = west + np.arange(130) * 2.0, south + np.arange(90) * 2.0
    for tile, (low, high) in enumerate(boxes):
        inside = (y >= low[1])[:, None] & (y <= high[1])[:, None] & (x >= low[0]) & (x <= high[0])
        z = field.heights()[inside] * -2.0 + 30.0
        assert low[2] <= z.min() and z.max() <= high[2]
        assert tiles.box(tile) == (*low[:2], *high[:2])


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_no_texel_is_larger_than_the_finest_pixel(small_tiles, scale):
    """Against every sample of each tile, one by one."""
    field = rough(120, 150, step=2.0)
    tiles, placement = tiling_of(field.lattice), np.diag([scale, scale, scale, 1.0])
    placement[:3, 3] = 10.0, -20.0, 30.0
    view = View.look((900.0, -700.0, 400.0), (0, 0, 0), fov_deg=40)
    sides = sized(tiles, field, sizing.footprints(_boxes(field), [view], placement), 4)
    west, south, _, _ = field.lattice.rectangle()
    grid = np.stack([*np.meshgrid(west + np.arange(150) * 2.0, south + np.arange(120) * 2.0), field.heights()], -1)
    world = grid * scale + placement[:3, 3]
    pixels = np.sqrt(((world - (900.0, -700.0, 400.0)) ** 2).sum(-1)) / view.pixels_per_unit / scale
    for tile, side in enumerate(sides):
        w, s, e, n = tiles.box(tile)
        inside = (grid[..., 0] >= w) & (grid[..., 0] <= e) & (grid[..., 1] >= s) & (grid[..., 1] <= n)
        assert side == 64 or max(tiles.texel(side)) <= max(pixels[inside].min(), 2.0) * (1 + 1e-9)


def test_resolutions_do_not_change_when_the_camera_turns(small_tiles):
    field = rough(120, 150, step=2.0)
    tiles, eye, found = tiling_of(field.lattice), np.array([-400.0, 100.0, 150.0]), set()
    for turn in np.linspace(0, 6, 12):
        view = View.look(eye, eye + (math.cos(turn), math.sin(turn), -0.2), fov_deg=15, resolution=(800, 300))
        found.add(tuple(sized(tiles, field, sizing.footprints(_boxes(field), [view], np.eye(4)), 4)))
    assert len(found) == 1


def test_a_shot_leaves_out_only_what_no_frame_sees(small_tiles):
    field = rough(120, 150, step=2.0)
    boxes = _boxes(field)
    views = [View.look((0, 0, 200), (300, 20 * k, 0), fov_deg=30) for k in range(3)]
    finest = sizing.footprints(boxes, views, np.eye(4), only_seen=True)
    middles = boxes.mean(axis=1)
    assert np.isinf(finest[middles[:, 0] < -40]).all()
    for middle, metres in zip(middles, finest, strict=True):
        for view in views:
            x, y, _, w = view.projection @ view.world_to_camera @ [*middle, 1.0]
            if w > 0 and abs(x) < w and abs(y) < w:
                assert np.isfinite(metres)
    anywhere = sizing.footprints(boxes, views, np.eye(4))
    assert (finest[np.isfinite(finest)] == anywhere[np.isfinite(finest)]).all()


@pytest.mark.parametrize("kind", [ORTHOGRAPHIC, PANORAMIC])
def test_other_cameras(small_tiles, kind):
    field = rough(120, 150, step=2.0)
    view = View.look((0, 0, 500), (0, 1, 0), kind=kind, ortho_width=960.0, resolution=(96, 54), fov_deg=90)
    metres = sizing.footprints(_boxes(field), [view], np.eye(4), only_seen=True)
    if kind == ORTHOGRAPHIC:
        assert np.allclose(metres, 10.0)
    else:
        assert np.isfinite(metres).all() and (metres > 300 * view.radians_per_pixel).all()


def test_a_budget_is_kept_and_coarsens_all_alike(small_tiles):
    field = rough(500, 600, step=2.0)
    tiles = tiling_of(field.lattice)
    finest = np.geomspace(2.0, 40.0, len(tiles)) / 8
    whole = sized(tiles, field, finest * 0 + 0.01, 8)
    monkey = sized(tiles, field, finest, 8, budget_mb=1e6)
    assert monkey == sized(tiles, field, finest, 8) and sum(whole) >= sum(monkey)
    for megabytes in (8.0, 2.0, 0.5):
        sides = sized(tiles, field, finest, 8, budget_mb=megabytes)
        assert sum(side * side for side in sides) * 8 <= megabytes * 1e6 or set(sides) == {64}
        assert sides == sorted(sides, reverse=True)
    eye_inside = sized(tiles, field, finest * 0, 8, budget_mb=8.0)
    assert sum(side * side for side in eye_inside) * 8 <= 8e6, "footprints of 0 get coarser, too"
    with pytest.raises(TerrainError, match="expected more than 0"):
        sized(tiles, field, finest, 8, budget_mb=0.0)


def test_a_placement_that_is_flat_is_refused():
    field = from_array(np.zeros((5, 5), np.float32), 1.0)
    view = View.look((0, 0, 9), (0, 1, 0))
    with pytest.raises(TerrainError, match="axes lie in one plane"):
        sizing.footprints(_boxes(field), [view], np.diag([1.0, 1.0, 0.0, 1.0]))


def test_a_tile_is_as_fine_as_the_decals_on_it(small_tiles):
    """A decal of 0.5 m pixels on ground of 10 m: tiles that it touches have texels of 0.5 m or less, others of 10 m."""
    field = from_array(np.zeros((70, 90), np.float32), 10.0)
    tiles = tiling_of(field.lattice)
    decal = Decal("d", picture(np.ones((64, 64, 4), np.float32), False), (-440.0, -340.0), (32.0, 0.0), (0.0, 32.0))
    asked = [AttributeRequest("color", ("a test",), parameters=(("decals", (decal,)),))]
    shown = sizing.shown_by(tiles, field, asked)
    touched = [k for k in range(len(tiles)) if tiles.box(k)[0] <= -408 and tiles.box(k)[1] <= -308]
    assert 1 <= len(touched) < len(tiles)
    assert all((shown[k] == 0.5) == (k in touched) and shown[k] in (0.5, 10.0) for k in range(len(tiles)))
    sides = sizing.resolutions(tiles, shown, shown, 4)
    texels = [max(tiles.texel(side)) for side in sides]
    assert all(texels[k] <= 0.5 or sides[k] == MAX_SIDE for k in touched)
    far = sizing.resolutions(tiles, np.full(len(tiles), 40.0), shown, 4)
    assert max(far) <= min(sides) < max(sides), "what looks from afar needs no more"
