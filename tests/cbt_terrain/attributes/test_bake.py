# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked images hold the attributes at their texels, without seams, and only changed images are baked."""

import json
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import OpenEXR
import pytest
from adaptive_terrain.cbt_terrain.attributes import bake as baking
from adaptive_terrain.cbt_terrain.attributes import exr, png, tiling
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.bake import bake
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.decals import Decal, picture
from adaptive_terrain.cbt_terrain.attributes.folder import JSON_NAME, read_index
from adaptive_terrain.cbt_terrain.attributes.tiling import tiling_of
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from fields import rough
from matplotlib.image import imread
from rasters import imported, write_raster

NORMAL, SLOPE, BENT = (AttributeRequest(name, ("a test",)) for name in ("detail_normal", "slope", "mean_curvature"))


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(tiling, "SINGLE_CELLS", 32)
    monkeypatch.setattr(tiling, "TILE_CELLS", 31)


def values(folder, name: str, tile: int) -> np.ndarray:
    """float64 [rows, columns, channels] in the effect's unit, row 0 north, as other readers see the file."""
    entry = read_index(folder)["maps"][name]
    file = folder / entry["tiles"][tile]["file"]
    coding = entry["coding"]
    if file.suffix == ".png":
        pixels = np.atleast_3d(imread(file).astype(np.float64))
        return coding["zero"] + (coding["one"] - coding["zero"]) * pixels
    channels = OpenEXR.File(str(file)).channels()
    return np.atleast_3d(next(iter(channels.values())).pixels.astype(np.float64))


def waves(x, y):
    """Return heights in metres and their derivatives to the east and the north."""
    return (
        9 * np.sin(x / 40) * np.cos(y / 30),
        9 / 40 * np.cos(x / 40) * np.cos(y / 30),
        -0.3 * np.sin(x / 40) * np.sin(y / 30),
    )


def wavy(rows: int, columns: int, step: float):
    x = (np.arange(columns) - (columns - 1) / 2) * step
    y = (np.arange(rows) - (rows - 1) / 2) * step
    return from_array(waves(*np.meshgrid(x, y))[0].astype(np.float32), step)


def test_requests_of_an_iterator_are_baked_for_every_tile(tmp_path, small_tiles):
    field = wavy(60, 90, 2.0)
    num_tiles = len(tiling_of(field.lattice))
    done = bake(field, iter([SLOPE, NORMAL]), tmp_path, [64] * num_tiles)
    assert num_tiles > 1
    assert {name: len(entry["tiles"]) for name, entry in done.index["maps"].items()} == {
        "detail_normal": num_tiles,
        "slope": num_tiles,
    }


@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.thorough), -2.5])
def test_normals_are_those_of_the_ground_under_each_texel(tmp_path, small_tiles, scale):
    field = wavy(150, 200, 2.0)
    tiles = tiling_of(field.lattice)
    bake(field, [NORMAL, SLOPE], tmp_path, [128] * len(tiles), vertical_scale=scale, vertical_offset=7.0)
    for tile in range(len(tiles)):
        x0, y0 = tiles.first_texel(tile, 128)
        step_x, step_y = tiles.texel(128)
        x, y = np.meshgrid(x0 + np.arange(128) * step_x, y0 - np.arange(128) * step_y)
        west, south, east, north = field.lattice.rectangle()
        _, dx, dy = waves(np.clip(x, west, east), np.clip(y, south, north))
        dx, dy = dx * scale, dy * scale
        wanted = np.stack([-dx, -dy, np.ones_like(dx)], -1) / np.sqrt(1 + dx * dx + dy * dy)[..., None]
        inner = (abs(x) < east - 6) & (abs(y) < north - 6)
        assert abs(values(tmp_path, "detail_normal", tile) - wanted)[inner].max() < 0.5 / 127 + 0.004
        found = values(tmp_path, "slope", tile)[..., 0]
        assert abs(found - np.arctan(np.hypot(dx, dy)))[inner].max() < 0.004


@pytest.mark.parametrize("form", ["png", "exr"])
def test_neighbours_show_the_same_ground_beyond_their_seam(tmp_path, small_tiles, form):
    """Tiles of one resolution share the texels of their margins bit by bit: so interpolation shows no seam."""
    field = rough(95, 130, step=2.0)
    tiles = tiling_of(field.lattice)
    bake(field, [SLOPE], tmp_path, [128] * len(tiles), form=form)
    shared = 2 * round(128 * tiling.MARGIN)
    for tile in range(len(tiles)):
        here = values(tmp_path, "slope", tile)
        if tile % tiles.columns < tiles.columns - 1:
            assert (here[:, -shared:] == values(tmp_path, "slope", tile + 1)[:, :shared]).mean() > 0.995
        if tile + tiles.columns < len(tiles):
            north = values(tmp_path, "slope", tile + tiles.columns)
            assert (here[:shared] == north[-shared:]).mean() > 0.995
        assert np.isfinite(here).all()


def test_tiles_of_other_resolutions_meet_without_a_step(tmp_path, small_tiles):
    field = wavy(64, 128, 2.0)
    tiles = tiling_of(field.lattice)
    sides = [64 << (tile % 3) for tile in range(len(tiles))]
    bake(field, [SLOPE], tmp_path, sides)

    def at(tile: int, part: float, v: float) -> float:
        """Linear interpolation in a tile's image, `part` of its ground from its western rim."""
        image = values(tmp_path, "slope", tile)[::-1, :, 0]
        x = (tiles.margin + part * tiles.inner) * len(image) - 0.5
        y = (tiles.margin + v * tiles.inner) * len(image) - 0.5
        i, j = math.floor(x), math.floor(y)
        a, b = x - i, y - j
        return (image[j, i] * (1 - a) + image[j, i + 1] * a) * (1 - b) + (
            image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a
        ) * b

    for tile in range(tiles.columns - 1):
        for v in (0.1, 0.5, 0.77):
            assert abs(at(tile, 1.0, v) - at(tile + 1, 0.0, v)) < 0.002


def test_only_what_has_changed_is_baked_again(tmp_path, small_tiles):
    field = rough(60, 95, step=2.0)
    tiles = tiling_of(field.lattice)
    sides = [64] * len(tiles)
    first = bake(field, [NORMAL, SLOPE], tmp_path, sides)
    assert (first.written, first.unchanged) == (2 * len(tiles), 0)
    assert (bake(field, [NORMAL, SLOPE], tmp_path, sides).written) == 0
    finer = [128, *sides[1:]]
    again = bake(field, [NORMAL, SLOPE], tmp_path, finer)
    assert (again.written, again.unchanged) == (2, 2 * len(tiles) - 2)
    assert bake(field, [SLOPE], tmp_path, finer, vertical_scale=2.0).written == len(tiles)
    damaged = tmp_path / "slope.1002.png"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    assert bake(field, [SLOPE], tmp_path, finer, vertical_scale=2.0).written == 1
    other = rough(60, 95, seed=1, step=2.0)
    assert bake(other, [SLOPE], tmp_path, finer, vertical_scale=2.0).written == len(tiles)


def test_maps_of_the_same_ground_stay_and_others_go(tmp_path):
    field = rough(40, 50)
    bake(field, [SLOPE], tmp_path, [64])
    assert set(bake(field, [NORMAL], tmp_path, [64]).index["maps"]) == {"slope", "detail_normal"}
    index = bake(rough(40, 50, seed=2), [BENT], tmp_path, [64]).index
    assert set(index["maps"]) == {"mean_curvature"}
    assert {file.name for file in tmp_path.iterdir()} == {JSON_NAME, "mean_curvature.exr"}


def test_a_parameter_makes_another_image(tmp_path):
    field, key = rough(40, 50), {}
    for metres in (5.0, 5.0, 9.0):
        asked = AttributeRequest("ambient_occlusion", (), parameters=(("radius", metres),))
        baked = bake(field, [asked], tmp_path, [64])
        key.setdefault(baked.written, []).append(metres)
    assert key == {1: [5.0, 9.0], 0: [5.0]}


def test_the_same_bytes_with_any_number_of_threads(tmp_path):
    field = rough(70, 90)
    names = [NORMAL, SLOPE, BENT]
    folders = [tmp_path / "one", tmp_path / "three"]
    for folder, threads in zip(folders, (1, 3), strict=True):
        bake(field, names, folder, [256], threads=threads)
    files = sorted(file.name for file in folders[0].iterdir())
    assert len(files) == 4
    for file in files:
        assert (folders[0] / file).read_bytes() == (folders[1] / file).read_bytes()


def test_what_is_cancelled_leaves_the_folder_as_it_was(tmp_path, small_tiles):
    field = rough(60, 95)
    tiles = tiling_of(field.lattice)
    bake(field, [SLOPE], tmp_path, [64] * len(tiles))
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def stop(fraction: float) -> None:
        if fraction > 0.6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bake(field, [SLOPE, NORMAL, BENT], tmp_path, [128] * len(tiles), on_progress=stop)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_holes_and_coded_rasters_give_finite_numbers(tmp_path):
    heights = rough(70, 100).heights().copy()
    heights[20:50, 30:60] = np.nan
    field = from_array(heights, 3.0, holes=True)
    assert field.valid is not None
    names = list(ATTRIBUTES)
    bake(field, [AttributeRequest(name, ()) for name in names], tmp_path, [64])
    assert all(np.isfinite(values(tmp_path, name, 0)).all() for name in names)


def test_a_store_of_16_bit_numbers(tmp_path):
    """The same ground as floats and as the numbers of its source."""
    source = write_raster(tmp_path / "heights.tif", (1000 + 4 * rough(41, 57).heights()).astype(np.uint16))
    field, _ = imported(tmp_path, source)
    assert field.samples.dtype == np.uint16
    bake(field, [NORMAL], tmp_path / "coded", [64])
    plain = from_array(field.heights().copy(), field.lattice.step_x, field.lattice.step_y)
    bake(plain, [NORMAL], tmp_path / "plain", [64])
    same = values(tmp_path / "coded", "detail_normal", 0) == values(tmp_path / "plain", "detail_normal", 0)
    assert same.all()


def test_files_say_what_they_are_only_when_complete(tmp_path):
    field = rough(40, 50)
    bake(field, [SLOPE, BENT], tmp_path, [64])
    for file, text_of in ((tmp_path / "slope.png", png.comment_of), (tmp_path / "mean_curvature.exr", exr.comment_of)):
        assert len(text_of(file)) == 32
        whole = file.read_bytes()
        for part in (b"", whole[:100], whole[: len(whole) // 2], whole[:-1], b"x" + whole[1:]):
            file.write_bytes(part)
            assert text_of(file) is None


@pytest.mark.parametrize("text", ["", "[]", '{"version": 1}', "{", json.dumps({"version": 1, "maps": {"a": 3}})])
def test_a_damaged_index_is_refused(tmp_path, text):
    (tmp_path / JSON_NAME).write_text(text)
    with pytest.raises(TerrainError, match="bake them again"):
        read_index(tmp_path)


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(TerrainError, match="choose another folder"):
        bake(rough(20, 20), [SLOPE], tmp_path / "file", [64])


@pytest.mark.parametrize("form", ["png", "exr"])
@pytest.mark.parametrize(("side", "texels"), [(256, 1), (100, 4000)])  # 100 rows: three bands of 32, and one of 4
def test_bands_change_nothing(tmp_path, monkeypatch, form, side, texels):
    field = rough(60, 60)
    bake(field, [SLOPE], tmp_path / "a", [side], form=form)
    monkeypatch.setattr(baking, "BAND_TEXELS", texels)
    fractions = []
    bake(field, [SLOPE], tmp_path / "b", [side], form=form, on_progress=fractions.append)
    found = values(tmp_path / "b", "slope", 0)
    assert found.shape == (side, side, 1) and (values(tmp_path / "a", "slope", 0) == found).all()
    assert fractions[-1] == 1.0


def test_a_decal_may_be_finer_than_the_samples(tmp_path):
    """A checker of 2 m pixels on ground of 16 m: its own colours are in the map, not their mean."""
    field = from_array(np.zeros((17, 17), np.float32), 16.0)
    checker = np.ones((128, 128, 4), np.float32)
    checker[..., :3] = (np.indices((128, 128)).sum(0) % 2)[..., None]
    decal = Decal("d", picture(checker, False), (-128.0, -128.0), (256.0, 0.0), (0.0, 256.0))
    asked = [AttributeRequest("color", ("a test",), parameters=(("decals", (decal,)),))]
    shares = []
    for side in (16, 512):
        bake(field, asked, tmp_path / str(side), [side])
        shares.append(np.ptp(values(tmp_path / str(side), "color", 0)[..., 0]))
    assert shares[0] < 0.05 and shares[1] > 0.95


@pytest.mark.parametrize(("side", "lines"), [(40, 7), (16, 33), (200, 48), (5, 5)])
def test_an_exr_of_any_shape_has_its_comment(tmp_path, side, lines):
    file = tmp_path / "map.exr"
    with ThreadPoolExecutor(1) as pool:
        exr_file = exr.ExrFile(file, side, 3, 16, "made by a test", pool, lines=lines)
        exr_file.add(np.random.default_rng(0).random((lines, side, 3), np.float32))
        exr_file.close()
    whole = file.read_bytes()
    assert exr.comment_of(file) == "made by a test"
    file.write_bytes(whole[:-1])
    assert exr.comment_of(file) is None
