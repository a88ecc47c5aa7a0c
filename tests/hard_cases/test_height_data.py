# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 5, 6 and 8 to 19: unusual height data."""

import math
import struct

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from diamond_entries import root_entries
from fields import errors_of, mesh_heights, reference_heights, sample_position
from invariants import arrays, assert_invariants
from rasters import hills, imported, write_exr, write_raster


def mesh_within(field, metres):
    """Return an update within `metres` of the surface; assert its invariants and its bound."""
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=metres))
    assert_invariants(update.surface, field.lattice)
    assert update.bound_m <= metres + update.terms_m.precision + field.source_max
    return update


def test_case_05_half_floats_warn_and_16_bits_keep_their_steps(tmp_path):
    """Heights of 8 km in float16 give a warning with their step, 4 m; uint16 over 8,848 m keeps every code to 1 mm."""
    heights = np.linspace(0.0, 8000.0, 33 * 33).reshape(33, 33)
    field, report = imported(tmp_path, write_exr(tmp_path / "a.exr", Y=heights.astype(np.float16)))
    assert mesh_within(field, 100.0).terms_m.source == pytest.approx(2.0)
    assert "16-bit floats" in report["warnings"][0] and "steps of 4 m" in report["warnings"][0]

    step = 8848.0 / 65535
    codes = np.random.default_rng(1).integers(0, 65536, (257, 257)).astype(np.uint16)
    codes[0, :2] = 0, 65535
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.png", codes), height_scale=step)
    assert np.array_equal(np.rint(field.heights()[::-1].astype(np.float64) / step), codes)
    assert np.abs(field.heights()[::-1].astype(np.float64) - codes * step).max() < 1e-3
    assert len(np.unique(field.heights())) == len(np.unique(codes))
    assert mesh_within(field, 500.0).terms_m.source == pytest.approx(step / 2, rel=0.01)


def test_case_06_denormal_heights(tmp_path):
    """Heights below the smallest normal float32 keep their bits and have an error of at most that number."""
    heights = (hills(33, 33) * 1e-43).astype(np.float32)
    assert 0.0 < heights.max() < np.finfo(np.float32).tiny
    field = from_array(heights)
    assert np.array_equal(field.samples, heights)
    assert 0.0 < errors_of(field).max() <= np.finfo(np.float32).tiny
    assert_invariants(Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e-38)).surface, field.lattice)


def test_case_06_heights_beyond_float32_are_refused(tmp_path):
    """Heights beyond float32, and its largest number, are refused unless they are the no-data value."""
    heights = hills(33, 33).astype(np.float64)
    for height, text in ((-1.7e308, "-1.7e.308"), (1e39, "1e.39"), (-3.4028234663852886e38, "-3.4028235e.38")):
        heights[4, 4:6] = height, np.nan
        np.save(tmp_path / "a.npy", heights)
        with pytest.raises(TerrainError, match=f"a.npy holds a height of {text} m.*give it as the no-data value"):
            imported(tmp_path, tmp_path / "a.npy")
        with pytest.raises(TerrainError, match=f"The raster holds a height of {text} m"):
            from_array(heights)
        field, report = imported(tmp_path, tmp_path / "a.npy", no_data=height)
        assert report["filled"] == 2 and field.min_height > 0.0 and field.max_height < 1e5
    heights[4, 4:6] = 3e38, np.inf  # beyond it only in metres
    np.save(tmp_path / "a.npy", heights)
    with pytest.raises(TerrainError, match="a.npy holds a height of 3e.41 m"):
        imported(tmp_path, tmp_path / "a.npy", height_scale=1000.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_case_06_the_error_about_a_height_names_the_limit(dtype):
    """1e30 m is refused, because float32 holds slightly more; the largest float32 below is a height."""
    heights = np.full((3, 3), 1e30, dtype)
    with pytest.raises(TerrainError, match=r"holds a height of 1e.30 m; expected less than 1e30 m above or below 0"):
        from_array(heights)
    heights[:] = np.nextafter(np.float32(1e30), np.float32(0.0))
    assert from_array(heights).max_height == heights[0, 0] < 1e30


@pytest.mark.parametrize("kind", ["tif", "exr", "npy"])
def test_case_08_missing_samples_are_filled_and_counted(tmp_path, kind):
    """NaN, infinities and no-data in TIFF, EXR and NPY are filled and counted; all other samples keep their bits."""
    heights = hills(65, 33)
    heights[3, 5], heights[4, 5], heights[5, 5], heights[20:, 60:] = np.nan, np.inf, -np.inf, -9999.0
    source = tmp_path / f"a.{kind}"
    if kind == "tif":
        write_raster(source, heights)
    elif kind == "exr":
        write_exr(source, Y=heights)
    else:
        np.save(source, heights)
    field, report = imported(tmp_path, source, no_data=-9999.0)
    assert report["filled"] == field.filled == 3 + 13 * 5
    valid = np.isfinite(heights) & (heights > 0.0)
    assert np.array_equal(field.heights()[::-1][valid], heights[valid])
    assert np.isfinite(field.heights()).all() and field.min_height == heights[valid].min()
    mesh_within(field, 5.0)


def test_case_09_a_raster_without_data_is_refused(tmp_path):
    """A raster with only no-data is one clear error, and the existing store stays."""
    imported(tmp_path, "island", size=65)
    key = open_store(tmp_path / "store").key
    source = write_raster(tmp_path / "a.tif", np.full((33, 33), -9999, np.int16), nodata=-9999)
    with pytest.raises(TerrainError, match="a.tif has only missing samples") as refused:
        imported(tmp_path, source)
    assert "choose another file or band" in refused.value.fix
    with pytest.raises(TerrainError, match="only missing samples"):
        from_array(np.full((1, 1), np.nan))
    assert open_store(tmp_path / "store").key == key and len(list((tmp_path / "store").glob("data-*"))) == 1


@pytest.mark.parametrize("shape", [(65, 65), (33, 97), (20, 31)])
def test_case_10_a_constant_map_is_two_triangles_a_root_square(shape):
    """A constant map has two triangles per root square, normals (0, 0, 1) and a bound below a float32 step."""
    field = from_array(np.full(shape, -123.456, np.float32), 10.0)
    assert not field.error.any()
    update = mesh_within(field, 1e-5)
    assert update.leaves == 2 * field.lattice.squares and update.triangles <= 2 * update.leaves
    assert np.array_equal(update.surface.normals, np.tile([0.0, 0.0, 1.0], (len(update.surface.normals), 1)))
    assert update.terms_m.geometric == 0.0
    assert update.bound_m < 1.0001 * np.spacing(np.float32(123.456))  # a corner at the border is rounded twice


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (1, 33), (77, 1), (2, 2), (2, 3), (3, 2)])
def test_case_11_the_smallest_rasters(tmp_path, shape):
    """Rasters of 1 x 1 to 3 x 2 samples keep their lowest and highest heights and give a mesh within 0.1 m."""
    heights = hills(*shape[::-1])
    np.save(tmp_path / "a.npy", heights)
    field, report = imported(tmp_path, tmp_path / "a.npy", extent=(100.0, 50.0))
    assert report["raster"] == [shape[1], shape[0]]
    # A single row or column is a profile: the terrain is constant across it.
    assert np.ptp(field.samples, axis=0 if shape[0] == 1 else 1).max() == 0.0 or min(shape) > 1
    assert {heights.min(), heights.max()} == {field.min_height, field.max_height}
    mesh_within(field, 0.1)
    steps = (length / max(count - 1, 1) for length, count in zip(report["extent_m"], report["raster"], strict=True))
    same = from_array(heights[::-1], *steps, source_max=report["source_step_m"])
    assert same.key == field.key


@pytest.mark.parametrize("shape", [(5, 4997), (3000, 4), (100, 257), (257, 50)])
def test_case_12_no_sliver_worse_than_its_cells_aspect(shape):
    """For 5 x 4,997 and other shapes, every triangle is half a square of raster cells or is cut at the border."""
    field = from_array(hills(*shape[::-1]), 7.0, 3.0)
    update = mesh_within(field, 40.0)
    cells = update.surface.positions[:, :2].astype(np.float64) / (field.lattice.step_x, field.lattice.step_y)
    a, b, c = (cells[update.surface.triangles[:, k]] for k in range(3))
    sides = np.sort([np.hypot(*(p - q).T) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    half = np.isclose(sides[0], sides[1], rtol=1e-4) & np.isclose(sides[2], sides[0] * math.sqrt(2), rtol=1e-4)
    corners = np.stack([a, b, c], axis=1) + np.array([field.lattice.cells_x, field.lattice.cells_y]) / 2
    at_border = (np.abs(corners - [field.lattice.cells_x, field.lattice.cells_y]) < 1e-3).any(axis=(1, 2))
    assert half[~at_border].all() and (half.all() or field.lattice.is_padded)
    assert (sides[2, ~half] < 2.0**field.lattice.levels * math.sqrt(2) + 1e-3).all()
    assert (field.lattice.step_x, field.lattice.step_y) == (7.0, 3.0)


@pytest.mark.parametrize("shape", [(65, 65), (50, 61)])
def test_case_13_a_cliff_of_gradient_a_million(shape):
    """A cliff of gradient 1e6 keeps its lowest and highest heights, and the bound holds at 2,000 points."""
    x = np.arange(shape[1])
    heights = np.where(x + 2 * np.arange(shape[0])[:, None] > 70, 1e6, 0.0).astype(np.float32)
    field = from_array(heights, 1.0)
    assert (field.min_height, field.max_height) == (0.0, 1e6)  # no overshoot
    for metres in (1e5, 1e4, 1e3):
        update = mesh_within(field, metres)
        plane = points(field, 2000)
        off = np.abs(mesh_heights(update.surface, plane) - reference_heights(field, plane))
        assert off.max() <= update.bound_m


def points(field, count, seed=0):
    """Return random positions in the plane of a terrain, float64 [count, 2]."""
    lattice = field.lattice
    size = np.array([(lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y])
    return (np.random.default_rng(seed).random((count, 2)) - 0.5) * size * 0.9999


def test_case_14_all_heights_negative():
    """Heights below -4,000 m have the errors of the same terrain above 0, and no vertex is above 0."""
    below, above = from_array(hills(65, 65) - 5000.0), from_array(hills(65, 65) + 0.0)
    assert below.max_height < 0.0
    assert np.allclose(errors_of(below), errors_of(above), atol=1e-2, rtol=0.03)
    update = mesh_within(below, 20.0)
    assert update.surface.positions[:, 2].max() < 0.0


def test_case_15_a_spike_of_one_sample_is_found_wherever_it_is():
    """A one-sample spike at each of 28 positions is in the roots' error and within 40, 5 and 0.2 m of the mesh."""
    random = np.random.default_rng(5)
    size = 65
    positions = [(0, 0), (0, 64), (64, 0), (64, 64), (32, 32), (0, 31), (33, 64), (1, 1)]
    positions += [tuple(p) for p in random.integers(0, size, (20, 2))]
    for j, i in positions:
        heights = np.zeros((size, size), np.float32)
        heights[j, i] = 100.0
        field = from_array(heights, 10.0)
        roots = errors_of(field)[root_entries(field.lattice)]
        # The triangles contain a spike in a corner of the root square; half of it is left two corners away.
        assert roots.min() >= (24.9 if (j % 64, i % 64) == (0, 0) else 99.0)
        for metres in (40.0, 5.0, 0.2):
            update = mesh_within(field, metres)
            spike = sample_position(field, i, j)
            assert abs(mesh_heights(update.surface, spike[None, :2])[0] - 100.0) <= metres + 1e-3
            assert update.triangles < 4000


@pytest.mark.parametrize(
    "shape", [(5, 9), *(pytest.param(shape, marks=pytest.mark.thorough) for shape in ((9, 9), (5, 17)))]
)
def test_case_15_every_sample_as_a_spike_at_every_depth_limit(shape):
    """With a spike at each sample in turn, the reported bound holds at every depth limit."""
    for j in range(shape[0]):
        for i in range(shape[1]):
            heights = np.zeros(shape, np.float32)
            heights[j, i] = 100.0
            field = from_array(heights, 10.0)
            spike, terrain = sample_position(field, i, j)[None, :2], Terrain(field, 1)
            for depth in range(1, field.lattice.cell_depth + 1):
                update = terrain.update(Criterion(error_px=0.0, error_m=0.1, max_depth=depth))
                assert_invariants(update.surface, field.lattice)
                off = abs(float(mesh_heights(update.surface, spike)[0]) - 100.0)
                assert off <= update.bound_m + 1e-4
            assert off <= 0.1 + 1e-4


def test_case_16_a_checkerboard_does_not_alias_to_a_plane():
    """Every diamond of a checkerboard has its full error, and a criterion below it needs the finest mesh."""
    y, x = np.indices((65, 129))
    field = from_array(((x + y) % 2 * 10.0).astype(np.float32))
    used = errors_of(field)[field.error > 0]
    roots = errors_of(field)[root_entries(field.lattice)]
    assert used.min() >= 5.0 and roots.min() >= 5.0
    assert len(used) == 65 * 129 - 2 * 3 + 64 * 128  # every diamond
    assert mesh_within(field, 4.9).triangles >= 64 * 128 * 2


def test_case_17_signed_zeros_are_the_same_terrain(tmp_path):
    """Heights of -0.0 and +0.0 have the same key and the same mesh bytes."""
    heights = hills(33, 65) - 500.0
    heights[::3] = 0.0
    negative = heights.copy()
    negative[::3] = -0.0
    keys, fields = set(), []
    for values in (heights, negative):
        np.save(tmp_path / "a.npy", values)
        field = imported(tmp_path, tmp_path / "a.npy")[0]
        fields += [from_array(values[::-1], source_max=field.source_max), field]
    keys = {field.key for field in fields}
    meshes = [arrays(mesh_within(field, 5.0).surface) for field in fields]
    assert all(mesh == meshes[0] for mesh in meshes)
    assert len(keys) == 1 and not np.signbit(fields[1].samples[fields[1].samples == 0.0]).any()


def test_case_18_the_lowest_int16_as_no_data_and_as_a_height(tmp_path):
    """The value -32768 is a height by default and is filled if the file or the user declares it no-data."""
    heights = hills(33, 33).astype(np.int16)
    heights[7, 9] = -32768
    plain = write_raster(tmp_path / "a.tif", heights)
    tagged = write_raster(tmp_path / "b.tif", heights, nodata=-32768)
    field = imported(tmp_path, plain)[0]
    assert field.min_height == -32768.0
    mesh_within(field, 50.0)
    assert imported(tmp_path, tagged)[1]["filled"] == 1
    field = imported(tmp_path, tagged)[0]
    assert field.min_height > 0.0
    mesh_within(field, 50.0)
    assert imported(tmp_path, plain, no_data=-32768.0)[1]["filled"] == 1
    assert imported(tmp_path, tagged, no_data=math.nan)[0].min_height == -32768.0


def test_case_19_point_and_area_differ_by_half_a_cell_exactly(tmp_path):
    """One tie point as pixel-is-point and pixel-is-area gives origins half a cell apart and equal heights."""
    from rasterio.transform import from_origin

    place = {"crs": "EPSG:32616", "transform": from_origin(500000.0, 4000000.0, 30.0, 20.0)}
    area = write_raster(tmp_path / "area.tif", hills(65, 33), **place)
    # Equal tie point and scale, but declared for the sample instead of the corner of its cell.
    raster_type = struct.pack("<4H", 1025, 0, 1, 1)
    content = area.read_bytes()
    assert content.count(raster_type) == 1
    (tmp_path / "point.tif").write_bytes(content.replace(raster_type, struct.pack("<4H", 1025, 0, 1, 2)))
    by_area, report = imported(tmp_path, area)
    by_point, report_of_point = imported(tmp_path, tmp_path / "point.tif")
    assert (by_area.origin - by_point.origin).tolist() == [15.0, -10.0, 0.0]
    assert by_point.origin.tolist() == [500000.0 + 32 * 30.0, 4000000.0 - 16 * 20.0, 0.0]
    mesh_within(by_point, 20.0)
    assert by_area.key == by_point.key and report["extent_m"] == report_of_point["extent_m"]
