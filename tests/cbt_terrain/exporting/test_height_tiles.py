# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of heights and masks, read back by other libraries and by numpy."""

import json
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import OpenEXR
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.splat_rules import DEFAULT
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.exporting import height_tiles, tile_layers
from adaptive_terrain.cbt_terrain.exporting.height_tiles import HeightTiles, export_height_tiles
from adaptive_terrain.cbt_terrain.exporting.tile_grid import UNREAL_SIZES, axes_of
from adaptive_terrain.cbt_terrain.field.heightfield import anchored
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.height_operators import exported_rows
from adaptive_terrain.cbt_terrain.height_operators.export import export_raster
from adaptive_terrain.cbt_terrain.query.grid import check_grid_size, grid_axes
from rasterio.transform import Affine
from rasters import hills, imported, write_raster

UTM = {"crs": "EPSG:32632", "transform": Affine(30.0, 0, 500_000.0, 0, -20.0, 5_200_000.0)}
EXTENT = 99 * 700.0, 74 * 300.0  # metres


@pytest.fixture(scope="module")
def land(tmp_path_factory):
    """Return a function that imports 100 x 75 pixels, once with holes and once without: heights and field."""

    @cache
    def land(holes):
        folder, heights = tmp_path_factory.mktemp("land"), hills(100, 75)
        if holes:
            heights[10:20, 30:50] = np.nan
        return heights, imported(folder, write_raster(folder / "in.tif", heights, **UTM), holes=holes)[0]

    return land


placing = cache(height_tiles.placing_or_middle)  # a child process finds it out, once for each field


@pytest.fixture
def make(land, tmp_path, monkeypatch):
    """Write tiles of 100 x 75 pixels, and return the heights and the JSON file."""
    monkeypatch.setattr(height_tiles, "placing_or_middle", placing)

    def make(settings, masks=(), holes=False, heights=None, **place):
        if heights is None:
            heights, field = land(holes)
        else:
            field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", heights, **place))
        (tmp_path / "tiles").mkdir()
        export_height_tiles(field, tmp_path / "tiles", settings, [AttributeRequest(m, ("test",)) for m in masks])
        return heights, json.loads((tmp_path / "tiles" / f"{settings.name}.json").read_text())

    return make


def read(path, index):
    """Return the numbers of a tile [rows, columns], without this package."""
    width, height = index["tile_size"]
    if path.suffix in (".r16", ".r32"):
        return np.fromfile(path, "<u2" if path.suffix == ".r16" else "<f4").reshape(height, width)
    if path.suffix == ".exr":
        return OpenEXR.File(str(path), separate_channels=True).parts[0].channels["Y"].pixels
    with rasterio.open(path) as file:
        assert file.count == 1
        return file.read(1)


def joined(folder, index, mask=None):
    """Return the whole grid of numbers; assert that shared samples are equal."""
    width, height = index["num_samples"]
    whole = np.full((height, width), np.inf)
    for tile in index["tiles"]:
        numbers = read(folder / (tile["masks"][mask] if mask else tile["file"]), index)
        assert numbers.shape == tuple(index["tile_size"][::-1])
        rows = slice(tile["row"], tile["row"] + len(numbers))
        part = whole[rows, tile["column"] : tile["column"] + numbers.shape[1]]
        known = part != np.inf
        assert (part[known] == numbers[known]).all()
        part[...] = numbers
    assert (whole != np.inf).all()
    return whole


def padded(heights, index):
    width, height = index["num_samples"]
    return np.pad(heights, ((0, height - heights.shape[0]), (0, width - heights.shape[1])), "edge")


@pytest.mark.parametrize(("form", "overlap"), [("r32", 0), ("r32", 1), ("exr", 0), ("tif", 1)])
def test_float_tiles_hold_the_heights_of_the_source(make, tmp_path, form, overlap):
    heights, index = make(HeightTiles(form, size=40, overlap=overlap))
    assert index["num_tiles"] == [3, 2] and index["num_samples_on_terrain"] == [100, 75]
    assert index["num_samples"] == [3 * (40 - overlap) + overlap, 2 * (40 - overlap) + overlap]
    assert (joined(tmp_path / "tiles", index) == padded(heights, index)).all()
    assert index["heights"]["max_error"] == 0.0 and (index["heights"]["scale"], index["heights"]["offset"]) == (1, 0)
    assert sorted(p.name for p in (tmp_path / "tiles").iterdir()) == sorted(
        ["terrain.json"] + [f"terrain_x{x}_y{y}.{form}" for x in range(3) for y in range(2)]
    )


@pytest.mark.parametrize("form", ["png", "r16"])
def test_integer_tiles_are_off_by_the_counted_error(make, tmp_path, form):
    heights, index = make(HeightTiles(form, size=51))
    numbers = joined(tmp_path / "tiles", index)
    coding = index["heights"]
    assert numbers.min() == 0 and numbers.max() == 65535
    off = abs(coding["offset"] + coding["scale"] * numbers - padded(heights, index)).max()
    assert coding["max_error"] == pytest.approx(off, rel=1e-9) and 0.4 < off / coding["scale"] <= 0.5 + 1e-9
    assert coding["low"] == heights.min() and coding["high"] == heights.max()


def test_unreal_numbers_give_the_heights_in_centimetres(make, tmp_path):
    """Unreal: z = location + (number - 32768) / 128 * scale, y points south."""
    heights, index = make(HeightTiles("r16"))
    unreal, numbers = index["unreal"], joined(tmp_path / "tiles", index)
    z = unreal["location_z"] + (numbers - 32768) / 128 * unreal["scale_z"]
    assert abs(z / 100 - heights).max() < 0.51 * index["heights"]["scale"]
    assert (unreal["scale_x"], unreal["scale_y"]) == (3000, 2000)
    assert (unreal["location_x"], unreal["location_y"]) == (-99 * 30 * 100 / 2, -74 * 20 * 100 / 2)


def test_each_tile_has_its_location_in_unreal(make):
    """Landscapes of single tiles meet: each begins where the one before ends, at the sample that both have."""
    _, index = make(HeightTiles("r16", size=40))
    assert len(index["tiles"]) == 6
    for tile in index["tiles"]:
        west, north = index["unreal"]["location_x"], index["unreal"]["location_y"]
        assert tile["unreal_location"] == [west + 39 * 3000 * tile["x"], north + 39 * 2000 * tile["y"]]


def test_locations_in_unreal_count_from_the_anchor(tmp_path):
    """Vertices of a mesh, which count from there, too, then fit to the landscape."""
    field, _ = imported(
        tmp_path, write_raster(tmp_path / "in.tif", hills(100, 75), transform=Affine(9, 0, 0, 0, -9, 0))
    )
    found = []
    for name, exported in (("plain", field), ("moved", anchored(field, 256.0, -64.0))):
        (tmp_path / name).mkdir()
        index = export_height_tiles(exported, tmp_path / name, HeightTiles("r16", size=40))
        found.append([index["unreal"][f"location_{axis}"] for axis in "xyz"] + index["tiles"][-1]["unreal_location"])
    assert np.subtract(*found).tolist() == pytest.approx([25_600.0, 6_400.0, 0.0, 25_600.0, 6_400.0])


def test_geotiff_tiles_lie_where_their_samples_are(make, tmp_path):
    heights, index = make(HeightTiles("tif", size=40))
    assert index["crs"] == "EPSG:32632" and index["origin"] == [500_015.0, 5_199_990.0] and index["step"] == [30, -20]
    for tile in index["tiles"]:
        with rasterio.open(tmp_path / "tiles" / tile["file"]) as file:
            assert file.crs.to_epsg() == 32632
            rows, columns = np.nonzero(np.ones(file.shape, bool))
            x, y = file.xy(rows, columns)
            column = np.rint((np.array(x) - 500_015) / 30).astype(int)
            row = np.rint((5_199_990 - np.array(y)) / 20).astype(int)
            on = (column < 100) & (row < 75)
            assert (file.read(1).ravel()[on] == heights[row[on], column[on]]).all() and on.any()


@pytest.mark.parametrize(
    ("crs", "extent"),
    [
        ("EPSG:4326", None),
        ("EPSG:32632", EXTENT),
        *(pytest.param(crs, None, marks=pytest.mark.thorough) for crs in ("EPSG:32632", None)),
        *(pytest.param(crs, EXTENT, marks=pytest.mark.thorough) for crs in ("EPSG:4326", None)),
    ],
)
def test_an_anchor_does_not_move_the_tiles(tmp_path, crs, extent):
    """rasterio reads the same transform and system from tiles of a field with an anchor as from those of its raster."""
    place = Affine(0.003, 0, 8.0, 0, -0.002, 46.0) if crs == "EPSG:4326" else Affine(300.0, 0, 5e5, 0, -200.0, 5.2e6)
    source = write_raster(tmp_path / "in.tif", hills(100, 75), crs=crs, transform=place)
    field, _ = imported(tmp_path, source, extent=extent)
    found = {}
    for name, exported in (("plain", field), ("moved", anchored(field, 3072.0, -2048.0))):
        (tmp_path / name).mkdir()
        index = export_height_tiles(exported, tmp_path / name, HeightTiles("tif", size=40))
        files = [tmp_path / name / tile["file"] for tile in index["tiles"]]
        with rasterio.open(files[0]) as first, rasterio.open(files[-1]) as last:
            found[name] = first.crs, np.array([*index["origin"], *index["step"], *first.transform, *last.transform])
    assert found["moved"][0] == found["plain"][0] and (found["plain"][0] is None) == bool(extent or crs is None)
    assert found["moved"][1] == pytest.approx(found["plain"][1], rel=1e-11, abs=1e-8)
    across, down = found["moved"][1][2:4]
    middle = (0.0, 0.0) if extent else (place.c + 50.0 * place.a, place.f + 37.5 * place.e)
    assert found["moved"][1][:2] + (49.5 * across, 37 * down) == pytest.approx(middle, rel=1e-11, abs=1e-8)


def test_flipped_tiles_begin_in_the_south(make, tmp_path):
    heights, index = make(HeightTiles("r32", size=75, is_flipped=True))
    assert (joined(tmp_path / "tiles", index) == padded(heights[::-1], index)).all()
    assert index["first_row"] == "south" and "unreal" not in index
    assert index["origin"] == [500_015.0, 5_200_000.0 - 74.5 * 20] and index["step"] == [30, 20]


def test_a_number_of_tiles_covers_the_terrain_exactly(make, tmp_path):
    """The samples are those of the bilinear surface at the new spacing."""
    heights, index = make(HeightTiles("r32", size=64, tiles=(2, 3), overlap=1))
    assert index["num_samples"] == index["num_samples_on_terrain"] == [127, 190]
    assert index["spacing_m"] == pytest.approx([99 * 30 / 126, 74 * 20 / 189])
    x, y = np.meshgrid(np.linspace(0, 99, 127), np.linspace(0, 74, 190))
    i, j = np.minimum(x.astype(int), 98), np.minimum(y.astype(int), 73)
    s, t, h = x - i, y - j, heights.astype(float)
    top, bottom = h[j, i] * (1 - s) + h[j, i + 1] * s, h[j + 1, i] * (1 - s) + h[j + 1, i + 1] * s
    found = joined(tmp_path / "tiles", index)
    assert abs(found - (top * (1 - t) + bottom * t)).max() < 1e-3
    assert 0 < index["heights"]["max_error"] < 4e-5


@pytest.mark.parametrize("form", ["png", "tif"])
def test_holes_become_a_mask(make, tmp_path, form):
    heights, index = make(HeightTiles(form, size=60), holes=True)
    holes = joined(tmp_path / "tiles", index, "holes")
    wanted = np.isnan(padded(heights, index))
    assert (holes == 255 * wanted).all() and wanted.sum() == 200
    found = joined(tmp_path / "tiles", index)
    assert index["holes"] == {"png": "filled", "tif": "NaN"}[form]
    assert np.isnan(found).sum() == (200 if form == "tif" else 0)
    good = index["heights"]["offset"] + index["heights"]["scale"] * found
    assert abs(good - padded(heights, index))[~wanted].max() <= index["heights"]["max_error"] + 1e-9


def test_masks_with_like_names_have_files_of_their_names(make, tmp_path):
    """A by-product scree, the default layer Scree, and names that no file can have."""
    named = [replace(DEFAULT[0], name=name) for name in ("Scree", "Rock/Ice", "holes", "scree_2")]
    requests = [
        AttributeRequest("scree", ("test",)),
        AttributeRequest("splat_1", ("test",), parameters=(("layers", tuple(named)),)),
    ]
    found = [layer.name for layer in tile_layers.mask_layers(requests)]
    assert found == ["scree", "Scree_2", "Rock_Ice", "holes_2", "scree_2_2"]


def test_masks_hold_attributes_and_layers_by_name(make, tmp_path):
    """The slope of a parabola is known."""
    x = np.arange(100) * 20.0
    parabola = np.repeat(x[None] ** 2 / 4000, 75, 0).astype(np.float32)
    square = {"crs": "EPSG:32632", "transform": Affine(20.0, 0, 5e5, 0, -20.0, 5e6)}
    _, index = make(HeightTiles("png", size=51), ("slope", "splat_1"), heights=parabola, **square)
    masks = {mask["name"]: mask for mask in index["masks"]}
    assert list(masks) == ["slope", "Grass", "Scree", "Rock", "Snow"]
    weights = [joined(tmp_path / "tiles", index, name) for name in list(masks)[1:]]
    assert abs(sum(weights) - 255).max() <= 2 and all(weight.max() > 200 for weight in weights)
    slope = joined(tmp_path / "tiles", index, "slope") * masks["slope"]["scale"] + masks["slope"]["offset"]
    off = abs(slope[:75, :100] - np.arctan(x / 2000))[5:-5, 5:-5].max()
    assert (
        0 < off < masks["slope"]["max_error"] + 1e-3 and masks["slope"]["max_error"] <= 0.51 * masks["slope"]["scale"]
    )


def test_a_flat_terrain_has_numbers(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", np.full((9, 9), 7, np.float32)))
    index = export_height_tiles(field, tmp_path, HeightTiles("r16"))
    assert (np.fromfile(tmp_path / "terrain_x0_y0.r16", "<u2") == 0).all()
    assert index["heights"]["offset"] == 7 and index["heights"]["scale"] > 0 and index["crs"] == ""


def test_unreal_sizes_and_counts():
    for size in UNREAL_SIZES:
        for overlap in (0, 1):
            for axis in axes_of(fit(20_001, 8_129), size, None, overlap):
                samples = round(axis.length) + 1
                assert axis.total >= samples > axis.total - (size - overlap) and axis.spacing == 1
                assert axis.inside == samples and axis.places[-1] == axis.length


@pytest.mark.parametrize(
    "settings",
    [
        HeightTiles("jpg"),
        HeightTiles(size=1),
        HeightTiles(size=40, overlap=2),
        HeightTiles(tiles=(2, 2)),
        HeightTiles(size=40, pattern="{name}_x{x}"),
        HeightTiles(size=40, pattern="{name}_{z}"),
        HeightTiles(size=40, pattern="{x}{y}{0}"),
        HeightTiles(size=40, pattern="{x:>999999999999}_{y}"),
        HeightTiles(size=40, pattern="../{name}_x{x}_y{y}"),
        HeightTiles(size=40, pattern="{name}_{x[0]}_{y}"),
        HeightTiles(size=40, pattern="{name[a]}_{x}_{y}"),
        HeightTiles(size=40, name=""),
    ],
)
def test_settings_that_cannot_work_are_refused(make, tmp_path, settings):
    with pytest.raises(TerrainError):
        make(settings)
    assert list((tmp_path / "tiles").iterdir()) == []


@pytest.mark.parametrize(
    "settings", [{"step": 0.001}, {"step": 0.005, "size": 32_768}, {"size": 30_000, "tiles": (20, 9)}]
)
def test_an_export_of_too_many_samples_is_refused(land, tmp_path, settings, monkeypatch):
    """The land has 2970 x 1480 m; 2^36 samples are 68,719,476,736."""
    _, field = land(False)
    monkeypatch.setattr(height_tiles, "heights_on_grid", None)  # no sample is computed
    monkeypatch.setattr(exported_rows, "heights_on_grid", None)
    with pytest.raises(TerrainError) as caught:
        export_height_tiles(field, tmp_path, HeightTiles("r32", **settings))
    what, _, expected, fix, _ = caught.value.args
    count = int(what.split()[4].replace(",", ""))
    if settings == {"step": 0.001}:
        assert count == 2_970_001 * 1_480_001 and what.endswith(f"{count * 4e-9:,.0f} GB")
    assert count > 2**36 and expected == "68,719,476,736 samples at most"
    fitting = float(fix.split()[2])
    assert 2**36 * 0.98 < (2970 / fitting + 1) * (1480 / fitting + 1) <= 2**36
    sizes = [(int(length / fitting + 1e-9) + 1) for length in (2970, 1480)]
    for axis, size in zip(grid_axes(field.lattice, fitting), sizes, strict=True):
        assert axis.inside == size
    check_grid_size(grid_axes(field.lattice, fitting), 4)  # is not refused
    assert not list(tmp_path.iterdir())
    if "step" in settings:
        with pytest.raises(TerrainError, match="The export would have"):
            export_raster(field.path, tmp_path / "a.tif", step=settings["step"])


def test_a_folder_that_cannot_exist_is_refused(land, tmp_path):
    with pytest.raises(TerrainError, match="There is no folder"):
        export_height_tiles(land(False)[1], tmp_path / ("n" * 300), HeightTiles())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit to lower")
@pytest.mark.parametrize("form", ["png", pytest.param("r16", marks=pytest.mark.thorough)])
def test_a_row_may_have_more_tiles_than_open_files(make, tmp_path, form):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (200, limits[1]))
    try:
        heights, index = make(HeightTiles(form, size=2, tiles=(240, 1)))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    scale = index["heights"]
    found = scale["offset"] + scale["scale"] * joined(tmp_path / "tiles", index)
    along = np.linspace(0, 99, 241)
    for row, line in ((0, heights[0]), (-1, heights[-1])):
        assert abs(found[row] - np.interp(along, np.arange(100), line)).max() <= scale["max_error"] + 1e-9


def test_the_width_of_a_group_of_tiles_changes_no_byte(make, tmp_path, monkeypatch):
    def written(name):
        make(HeightTiles("exr", size=12), holes=True, masks=("slope",))
        return (tmp_path / "tiles").rename(tmp_path / name)

    whole = written("whole")
    monkeypatch.setattr(height_tiles, "MAX_COLUMNS", 30)
    parts = written("parts")
    files = sorted(whole.iterdir())
    assert len(files) > 100 and [file.name for file in files] == sorted(file.name for file in parts.iterdir())
    assert all(file.read_bytes() == (parts / file.name).read_bytes() for file in files)


def test_tiles_do_not_replace_the_description_of_a_store(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", hills(20, 20)))
    before = (field.path / "store.json").read_bytes()
    with pytest.raises(TerrainError, match="belongs to a terrain store"):
        export_height_tiles(field, field.path, HeightTiles("r16", name="store"))
    assert (field.path / "store.json").read_bytes() == before


def test_a_second_export_of_one_name_is_refused(land, tmp_path):
    """The JSON file would describe the tiles of one export, and some tiles would be the other's."""
    field, refused = land(holes=False)[1], []
    settings = HeightTiles(size=33)

    def while_writing(_done):
        with pytest.raises(TerrainError, match="terrain.json and the files with it are being written") as caught:
            export_height_tiles(field, tmp_path, HeightTiles(size=65))
        refused.append(caught.value.fix)

    export_height_tiles(field, tmp_path, settings, on_progress=while_writing)
    assert len(refused) > 2 and {*refused} == {"wait for its end, or choose another name or folder"}
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "alone").mkdir()
    export_height_tiles(field, tmp_path / "alone", settings)
    assert written == {path.name: path.read_bytes() for path in (tmp_path / "alone").iterdir()}
