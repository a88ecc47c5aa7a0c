# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 57: tiles of shaped land equal the whole.

Where rivers decide by the whole drainage network, tiles differ from the whole by a fraction of the change that the fine
levels make: `assert_tiles_close` limits the fraction over all tiles and over the worst one.
"""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.fitted import fitted
from adaptive_terrain.cbt_terrain.height_operators.level_plan import LevelPlan
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack, read_stack
from adaptive_terrain.cbt_terrain.height_operators.tile_cache import TileCache
from adaptive_terrain.cbt_terrain.height_operators.tiles import BAND, all_tiles, levels_of, whole_land
from land_effects import SMOOTH, bumpy, ragged

PRESETS = Path(__file__).resolve().parents[2] / "operators/presets/adaptive_terrain/land"
# The largest difference of tiles, as a fraction of the change by fine levels. 0: they read nothing beyond their halo.
BOUNDS = {"smooth": 0.0, "relief": 0.0, "droplets": 0.0, "scree": 0.001, "rivers": 0.05, "snow": 0.05}
EXACT = "smooth", "relief"  # in every run; the other rivers below are, too
PARAMETERS = {"droplets": {"droplets": 400.0, "strength": 10.0}}
ROUNDING = 1e-4  # metres, of changes of some hundred


def three_ways(field, stack, tiles):
    """Return the change of the whole, of the coarsest level and of tiles, with the coarser levels computed once."""
    lattice = field.lattice
    plans = (whole_land(lattice), whole_land(lattice, len(levels_of(lattice)) - 1), tiles)
    with tempfile.TemporaryDirectory() as folder:
        cache = TileCache(Path(folder))
        return [shape(field, stack, plan, threads=2, cache=cache).change for plan in plans]


def errors_and_changes(field, stack):
    """Return two arrays in metres: all tiles minus the whole, and the coarsest level minus the whole."""
    whole, coarse, tiles = three_ways(field, stack, all_tiles(field.lattice))
    return tiles - whole, coarse - whole


def assert_tiles_close(field, stack, bound: float, worst: float, min_change: float):
    """Assert the rms difference of all tiles and of the worst, as fractions of the change by the fine levels."""
    errors, changes = errors_and_changes(field, stack)
    level = levels_of(field.lattice)[0]
    windows = [level.window(tile) for tile in range(level.tile_count)]
    assert rms(changes) > min_change and rms(errors) < bound * rms(changes)
    assert max(rms(errors[window]) / rms(changes[window]) for window in windows) < worst


def rolling_hills(noise: float, seed: int) -> np.ndarray:
    """Return float64 [560, 930] metres: bowls and hills with white noise."""
    y, x = np.indices((560, 930))
    land = 300 + 160 * np.sin(x / 60) * np.cos(y / 47)
    return land + noise * np.random.default_rng(seed).standard_normal(land.shape)


def rms(metres) -> float:
    return float(np.sqrt(np.mean(np.square(metres, dtype=np.float64))))


@pytest.mark.parametrize(
    "name",
    [*EXACT, *(pytest.param(name, marks=pytest.mark.thorough) for name in BOUNDS if name not in EXACT)],
)
def test_case_57_tile_by_tile_equals_the_whole(monkeypatch, name):
    """Tiles computed alone equal the whole: exactly but for rounding, to 0.1 % (thermal) or 5 % (rivers, snow)."""
    monkeypatch.setitem(HEIGHT_OPERATORS, "smooth", SMOOTH)
    field = from_array(bumpy(560, 930) * 2 + 400, 12.0, 10.0)
    error, change = map(rms, errors_and_changes(field, Stack((Entry(name, PARAMETERS.get(name, {})),))))
    assert change > 0.05 and error <= BOUNDS[name] * change + ROUNDING


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("waves", "noise", "part"), [("samples", 2.0, np.s_[:, 256:1281]), ("metres", 0.3, np.s_[:513, :1025])]
)
def test_case_57_rivers_on_young_land_full_of_pits(waves, noise, part):
    """Rivers out of a lake wider than a tile and out of a chain of lakes: tiles within 5 %, the worst within 10 %."""
    y, x = np.indices((700, 1300)) * (np.array([9.0, 8.0])[:, None, None] if waves == "metres" else 1.0)
    land = 300 + 60 * np.sin(x / 190) * np.sin(y / 230) + 20 * np.sin(x / 37) * np.sin(y / 41)
    land += noise * np.random.default_rng(3 if waves == "metres" else 0).standard_normal(land.shape)
    field = from_array(land[part].astype(np.float32), 8.0, 9.0)
    assert_tiles_close(field, Stack((Entry("rivers", {"years": 3e5}),)), 0.05, 0.1, min_change=1)


@pytest.mark.thorough
@pytest.mark.parametrize(("noise", "bound"), [(0.05, 0.05), (0.002, 0.03)])
def test_case_57_rivers_on_a_plain_that_rises(noise, bound):
    """Rivers on a plain lifted by 60 m: tiles within 5 % at a slope of 1e-4, within 3 % at 1e-3, the worst 10 %."""
    y, x = np.indices((560, 930))
    land = 50 + (1e-3 * (y + 0.4 * x) if noise > 0.01 else 1e-2 * y)
    land += noise * np.random.default_rng(11).standard_normal(land.shape)
    field = from_array(land.astype(np.float32), 10.0, 10.0)
    assert_tiles_close(field, Stack((Entry("rivers", {"rise": 2e-4}),)), bound, 0.1, min_change=0.2)


@pytest.mark.thorough
@pytest.mark.parametrize(("noise", "step_y"), [(8.0, 11.0), (1.0, 10.0)])
def test_case_57_rivers_from_lakes_with_similar_outlets(noise, step_y):
    """Rivers out of bowls, a quarter of which change their outlet with the level: tiles within 4 %, the worst 5 %."""
    land = rolling_hills(noise, seed=7 if noise > 1 else 5)
    field = from_array(land[:, :769].astype(np.float32), 10.0, step_y)
    assert_tiles_close(field, Stack((Entry("rivers"),)), 0.04, 0.05, min_change=2)


@pytest.fixture
def always_tiles(monkeypatch):
    """Compute tiles also where the level plan would prefer the whole level."""
    monkeypatch.setattr(LevelPlan, "doubt", lambda _plan, _number: None)


@pytest.mark.thorough
def test_case_57_rivers_on_land_that_is_worn_nearly_flat(always_tiles):
    """Rivers in rock so soft that they erode 200 m: tiles within 3 %, the worst within 5 %."""
    field = from_array(rolling_hills(8.0, 7).astype(np.float32), 10.0, 10.0)
    assert_tiles_close(field, Stack((Entry("rivers", {"erodibility": 1e-3}),)), 0.03, 0.05, min_change=5)


@pytest.mark.thorough
def test_case_57_rivers_for_a_single_year():
    """Rivers of one year, when slopes slide and basins fill before their dams are cut: within 2 %, the worst 5 %."""
    field = from_array(rolling_hills(8.0, 7).astype(np.float32), 10.0, 10.0)
    assert_tiles_close(field, Stack((Entry("rivers", {"years": 1.0}),)), 0.02, 0.05, min_change=2)


def sinkholes():
    """Return a plain with 260 funnels, 2 to 8 m deep, and single samples as lakes everywhere."""
    y, x = np.indices((545, 914))
    land, rng = 500 + waves(1.8, 16, 120), np.random.default_rng(7017)
    for _ in range(260):
        south, west, wide = rng.uniform(0, 545), rng.uniform(0, 914), rng.uniform(3, 14)
        land -= 0.6 * np.maximum(wide - np.hypot(y - south, x - west), 0)
    return land, 8.0


def scarps():
    """Return tilted blocks that end in cliffs 650 m high and one sample wide."""
    y, x = np.indices((545, 914)) * 18.0
    land = 1250 - 650 * ((0.9 * x + 0.4 * y + 500 * np.sin(y / 2100)) / 3800 % 1)
    return land + waves(1.5, 19, 120), 18.0


def plateaus():
    """Return flat steps with walls of 120 m."""
    steps = waves(1.7, 3, 500) / 120
    return 700 + 120 * (np.floor(steps) + np.clip(steps % 1 * 9, 0, 1)) + waves(1.2, 4, 6), 10.0


def waves(power: float, seed: int, relief: float, shape: tuple[int, int] = (545, 914)) -> np.ndarray:
    """Return waves of every length and random phase, float64 [rows, columns], standard deviation `relief` / 4 m."""
    length = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    length[0, 0] = np.inf
    noise = np.fft.rfft2(np.random.default_rng(7000 + seed).standard_normal(shape))
    land = np.fft.irfft2(noise * length**-power, s=shape)
    return relief / 4 * land / land.std()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("ground", "parameters"),
    [(sinkholes, {}), (scarps, {"years": 2e6, "rise": 3e-4}), (plateaus, {"erodibility": 1e-4})],
)
def test_case_57_rivers_on_three_unseen_terrains(ground, parameters, always_tiles):
    """Rivers on sinkholes, scarps and plateaus, which tuned no constant: tiles within 5 %, the worst within 10 %."""
    land, step = ground()
    field = from_array(land.astype(np.float32), step)
    assert_tiles_close(field, Stack((Entry("rivers", parameters, seed=5),)), 0.05, 0.1, min_change=0.4)


@pytest.mark.thorough
def test_case_57_rivers_that_leave_a_tile_and_come_back():
    """A stream that leaves a tile and returns within a river from outside: tiles within 3 %, the worst 6 %."""
    _, x = np.indices((914, 545))
    land = 150 - abs(waves(1.6, 55, 60, x.shape)) + waves(1.3, 56, 12, x.shape) - 0.02 * x
    field = from_array(land.astype(np.float32), 2.0)
    stack = Stack((Entry("rivers", {"erodibility": 3e-5}, seed=9),))
    assert_tiles_close(field, stack, 0.03, 0.06, min_change=0.5)


def badlands():
    """Return gullies 60 m deep at 2 m per sample, which erode to a plain in soft rock."""
    y, _ = np.indices((545, 914))
    return 150 - abs(waves(1.6, 5, 60)) + waves(1.3, 6, 12) + 0.02 * y, 2.0


def needles():
    """Return hills 20 km high at 10 m per sample."""
    y, x = np.indices((545, 914))
    return 20e3 * (1.2 + np.sin(x / 61 + 0.3) * np.cos(y / 83 + 1)) + waves(0.0, 53, 160), 10.0


def basin():
    """Return a basin without an outlet."""
    y, x = np.indices((545, 914))
    away = np.hypot((y - 272) / 0.6, x - 548) / 548
    return 700 + 500 * np.clip(away, 0.2, 1.1) ** 2 + waves(1.5, 58, 90), 11.0


@pytest.mark.parametrize(
    ("ground", "parameters"),
    [
        (badlands, {"erodibility": 1e-4}),
        pytest.param(needles, {}, marks=pytest.mark.thorough),
        pytest.param(basin, {"erodibility": 6e-5}, marks=pytest.mark.thorough),
    ],
)
def test_case_57_rivers_that_run_elsewhere_at_each_level(ground, parameters):
    """A single tile is within 5 % also if coarser levels lack the big rivers of the finer ones."""
    land, step = ground()
    field = from_array(land.astype(np.float32), step)
    stack, levels = Stack((Entry("rivers", parameters, seed=5),)), levels_of(field.lattice)
    whole, coarse, tile = three_ways(field, stack, [{5: 0.0}, {}, {}])
    rows, columns = levels[0].window(5)
    inside = slice(rows.start + BAND, rows.stop - BAND), slice(columns.start + BAND, columns.stop - BAND)
    assert rms((whole - coarse)[inside]) > 0.4
    assert rms((tile - whole)[inside]) < 0.05 * rms((whole - coarse)[inside])


@pytest.mark.parametrize(
    "preset", ["volcanic_island", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("old_hills", "desert"))]
)
def test_case_57_rivers_of_ordinary_land_are_made_in_tiles(preset):
    """A picture of one valley of the island computes only its tiles, for three presets."""
    found = fitted(read_stack(PRESETS / f"{preset}.json"), 0.0, 1000.0)
    rivers = Stack(tuple(entry for entry in found.active if entry.effect == "rivers"))
    field = from_array(island(601), SIDE / 600)
    land = shape(field, rivers, [{4: 0.0}, {}, {}], threads=2)
    assert [added.whole for added in land.added if added.level == 0] == [False] and land.tiles[0] == [4]


@pytest.mark.thorough
def test_case_57_neighbours_share_their_borders(monkeypatch):
    """A tile has the same bytes with or without its neighbour, and the change of heights has no step at borders."""
    field = from_array(bumpy(560, 930) * 2 + 400, 12.0, 10.0)
    stack, level = Stack((Entry("rivers"),)), levels_of(field.lattice)[0]
    none = [{} for _ in levels_of(field.lattice)[1:]]
    pair = shape(field, stack, [{5: 0.0, 6: 0.0}, *none]).change
    assert pair.tobytes() == shape(field, stack, [{6: 0.0, 5: 0.0}, *none], threads=3).change.tobytes()
    one = shape(field, stack, [{5: 0.0}, *none]).change
    rows, columns = level.window(5)
    inside = slice(rows.start + BAND, rows.stop - BAND), slice(columns.start + BAND, columns.stop - BAND)
    assert pair[inside].tobytes() == one[inside].tobytes()
    jumps = abs(np.diff(pair, axis=1))[rows]
    rms = np.sqrt((jumps**2).mean(axis=0))
    across = rms[columns.stop - 1 - BAND : columns.stop - 1 + BAND]
    assert across.max() < 1.5 * rms[columns.start + BAND : columns.stop - 2 * BAND].max()


@pytest.mark.parametrize("name", [pytest.param("snow", marks=pytest.mark.thorough), "scree"])
def test_case_57_slides_keep_their_mass_in_tiles(name):
    """Slides on cliffs: tiles within 1 %, the worst within 2 %; mass is kept to 2e-5; no depth is negative.

    A finer level starts from slides that do not fit its slopes, and compensates for them nearby.
    """
    field = from_array(ragged(330, 600), 7.0, 12.0)
    stack = Stack((Entry(name, {"line": 700.0} if name == "snow" else {}),))
    errors, changes = errors_and_changes(field, stack)
    windows = (levels_of(field.lattice)[0].window(tile) for tile in range(levels_of(field.lattice)[0].tile_count))
    by_tile = [(rms(errors[window]), rms(changes[window])) for window in windows]
    assert min(change for _, change in by_tile) > 1.0 and rms(errors) < 0.01 * rms(changes)
    assert all(error < 0.02 * change for error, change in by_tile)
    layers = shape(field, stack, all_tiles(field.lattice), threads=2).layers
    slid = layers["slides"] if name == "snow" else np.concatenate([layers["scree"], -layers["wear"]])
    assert abs(slid.sum(dtype=np.float64)) < 2e-5 * abs(slid).sum(dtype=np.float64)
    assert min(layer.min() for kind, layer in layers.items() if kind != "slides") == 0.0


@pytest.mark.parametrize(("name", "rows"), [("scree", 2), ("snow", 4), ("scree", 8), ("scree", 40)])
def test_case_57_a_tile_of_a_strip_is_as_the_whole(name, rows):
    """In rasters of 2 to 40 rows and 700 columns, a tile in the middle is within 2 % of the whole."""
    field = from_array(ragged(700, rows).T.copy(), 10.0, 10.0)
    stack, count = Stack((Entry(name, {"line": 700.0} if name == "snow" else {}),)), len(levels_of(field.lattice))
    tile = shape(field, stack, [{1: 0.0}, *[{}] * (count - 1)]).change
    whole = shape(field, stack, whole_land(field.lattice)).change
    inner = np.s_[:, 256 + BAND : 512 - BAND]
    assert rms(whole[inner]) > 0.5 and rms((tile - whole)[inner]) < 0.02 * rms(whole[inner])
