# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasters whose samples or entries 31 bits cannot number, in sparse files that take little space."""

import json
import mmap
import sys
import tracemalloc
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import cleaning, codes, store
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.cleaning import fill_rows
from adaptive_terrain.cbt_terrain.field.depths import depth_limit
from adaptive_terrain.cbt_terrain.field.hierarchy import ranges_at, stored_at
from adaptive_terrain.cbt_terrain.field.lattice import fit, lattice_for
from adaptive_terrain.cbt_terrain.field.store_arrays import BLOCK_BYTES, PAGE_BYTES, header
from adaptive_terrain.cbt_terrain.field.store_entries import LATTICE
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import flat
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.kernels.field import expand, hierarchy, ranges
from diamond_entries import error_index, range_index
from fields import split_points
from invariants import arrays
from matplotlib.tri import LinearTriInterpolator, Triangulation

if sys.platform != "linux":
    pytest.skip("files are surely sparse on Linux only", allow_module_level=True)

SIDE, SMALL, LEVELS_ABOVE = 65_537, 1025, 6
FIRST = SIDE - SMALL  # column and row of the small raster's first sample in the large one
STEPS = codes.Steps(0, 0.01, 0.0)


def hills() -> np.ndarray:
    """Return numbers of heights, uint16 [1025, 1025]: hills in the north-eastern quarter, 0 elsewhere."""
    y, x = np.mgrid[0:SMALL, 0:SMALL]
    inside = np.clip((np.minimum(x, y) - 640) / 100.0, 0.0, 1.0)
    waves = np.sin(x / 7.0) * np.cos(y / 9.0) + 0.5 * np.sin(x / 1.7 + y / 2.3)
    ridges = 300 + 2000 * np.sin(x / 90.0) ** 2 * np.cos(y / 110.0) ** 2
    return np.rint(inside * (ridges + 150 * waves)).astype(np.uint16)


def sparse(path, shape, dtype) -> np.ndarray:
    """Return an array of zeros in a sparse file, mapped without reading ahead."""
    array = np.memmap(path, dtype, "w+", shape=shape)
    array._mmap.madvise(mmap.MADV_RANDOM)
    return array


def write_sparse(file, shape, dtype, writes) -> None:
    """Write the file of a store's array of zeros but for some entries. writes: pairs of flat indices and values."""
    nbytes = int(np.prod(shape, dtype=object)) * np.dtype(dtype).itemsize
    with open(file, "wb") as handle:
        handle.write(header(shape, dtype))
        handle.truncate(PAGE_BYTES + nbytes)
    array = np.memmap(file, dtype, "r+", PAGE_BYTES, (nbytes // np.dtype(dtype).itemsize,))
    sums = np.full(-(-nbytes // BLOCK_BYTES), zlib.crc32(bytes(BLOCK_BYTES)), "<u4")
    changed = {len(sums) - 1}  # the last block may be shorter
    for index, values in writes:
        array[index] = values
        changed |= set(np.unique(index * array.itemsize // BLOCK_BYTES).tolist())
    for block in changed:
        sums[block] = zlib.crc32(array.view(np.uint8)[block * BLOCK_BYTES : (block + 1) * BLOCK_BYTES].data)
    array.flush()
    with open(file, "ab") as handle:
        handle.write(sums.tobytes())


def same_diamonds(lattice, depth):
    """Return the samples (i, j) that split the diamonds of a depth, or the cells at the last one."""
    if depth < lattice.cell_depth:
        return split_points(lattice, depth)
    j, i = np.indices((lattice.cells_y, lattice.cells_x)).reshape(2, -1)
    return i, j


@pytest.fixture(scope="module")
def large_store(tmp_path_factory):
    """Write a store of 65,537 x 65,537 samples, flat but for hills in its north-eastern corner; return its path."""
    small, lattice = from_array(STEPS.heights(hills()), 1.0), fit(SIDE, SIDE)
    near = small.lattice
    assert (lattice.levels, lattice.levels - near.levels) == (16, LEVELS_ABOVE) and lattice.node_count > 2**33
    errors, spans = [], []
    for depth in range(1, near.cell_depth + 1):
        (i, j), below = same_diamonds(near, depth), depth + 2 * LEVELS_ABOVE
        codes_here = small.error[error_index(near, depth, i, j)]
        errors.append((error_index(lattice, below, FIRST + i, FIRST + j), codes_here))
        if depth <= near.range_depth:
            span = small.ranges[range_index(near, depth, i, j)]
            at = 2 * range_index(lattice, below, FIRST + i, FIRST + j)
            spans += [(at, span[:, 0]), (at + 1, span[:, 1])]
    for depth in range(1, 2 * LEVELS_ABOVE + 2):  # in the small raster's square, around it, and above
        errors.append((error_index(lattice, depth, *split_points(lattice, depth)), 255))
        spans.append((2 * range_index(lattice, depth, *split_points(lattice, depth)) + 1, 65535))
    path = tmp_path_factory.mktemp("large") / "store"
    folder = path / f"data-{'0' * 32}"
    folder.mkdir(parents=True)
    j, i = np.mgrid[0:SMALL, 0:SMALL].reshape(2, -1) + FIRST
    write_sparse(folder / "samples.npy", (SIDE, SIDE), np.uint16, [(j * SIDE + i, hills().ravel())])
    write_sparse(folder / "error.npy", (lattice.node_count,), np.uint8, errors)
    write_sparse(folder / "ranges.npy", (lattice.range_count, 2), np.uint16, spans)
    coarsest = [small.exponents[near.groups - 1]] * (lattice.groups - near.groups)
    content = {
        "version": store.VERSION,
        "data": folder.name,
        "lattice": {name: getattr(lattice, name) for name in LATTICE},
        "steps": [STEPS.first, STEPS.scale, STEPS.offset],
        **{name: getattr(small, name) for name in store._NUMBERS},
        "exponents": [*small.exponents[:-1], *coarsest, small.exponents[-1]],
        **{"digest": "", "key": "large", "holes": False, "origin": [0.0, 0.0, 0.0], "crs": ""},
        **{"provenance": {}, "report": {}},
    }
    (path / "store.json").write_text(json.dumps(content | {"sum": store._sum_of(content)}))
    return path


@pytest.mark.thorough
def test_hills_behind_2_to_the_32_samples_meet_their_bound(large_store):
    """Heights of the mesh are compared with all samples of the hills by matplotlib's interpolation."""
    field = store.open_store(large_store)
    update = Terrain(field, 2).update(Criterion(error_px=0, error_m=0.25))
    assert update.bound_m <= 0.25
    points = update.surface.positions.astype(np.float64)
    x, y = points[:, 0] + 0.5 * (SIDE - 1) - FIRST, points[:, 1] + 0.5 * (SIDE - 1) - FIRST
    triangles = update.surface.corner_verts.reshape(-1, 3)
    triangles = triangles[((x >= 500) & (y >= 500))[triangles].all(axis=1)]
    assert len(triangles) > 20_000
    j, i = np.mgrid[640:SMALL, 640:SMALL]
    mesh = LinearTriInterpolator(Triangulation(x, y, triangles), points[:, 2])(i, j)
    assert mesh.count() == mesh.size
    worst = np.abs(mesh - STEPS.heights(hills()[640:, 640:])).max()
    assert 0.1 < worst <= update.bound_m


def test_large_meshes_do_not_depend_on_threads_or_history(large_store):
    field = store.open_store(large_store)
    corner = np.array([0.5 * (SIDE - 1) - 100.0] * 2)
    views = [View.look((*(corner - away), 60.0), (*corner, 20.0)) for away in (200.0, 180.0, 30_000.0)]
    terrain = Terrain(field, 1)
    for view in (*views, views[0]):
        before = arrays(terrain.update(Criterion(), [view]).surface)
    first = Terrain(field, 3).update(Criterion(), [views[0]])
    assert arrays(first.surface) == before and first.triangles > 10_000
    assert first.bound_px <= 1.0 and first.surface.level.max() > 30


@pytest.mark.thorough
def test_a_strip_of_70_000_samples_is_built_and_refined():
    y, x = np.mgrid[0:40, 0:70_000]
    heights = (20.0 * np.sin(x / 50.0) * np.cos(y / 11.0) + 2.0 * np.sin(x / 3.1 + y)).astype(np.float32)
    update = Terrain(from_array(heights, 1.0), 2).update(Criterion(error_px=0, error_m=0.5))
    points = update.surface.positions.astype(np.float64)
    triangles = update.surface.corner_verts.reshape(-1, 3)
    worst = 0.0
    for west in (0, 46_300, 69_000):  # the second one is where squares of 46,341 exceed 31 bits
        x, y = points[:, 0] + 34_999.5, points[:, 1] + 19.5
        near = (x >= west - 100) & (x <= west + 1100)
        there = Triangulation(x, y, triangles[near[triangles].any(axis=1)])
        j, i = np.mgrid[0:40, west : west + 1000]
        mesh = LinearTriInterpolator(there, points[:, 2])(i, j)
        assert mesh.count() == mesh.size
        worst = max(worst, np.abs(mesh - heights[:, west : west + 1000]).max())
    assert 0.2 < worst <= update.bound_m <= 0.5


def launch_last(kernel, count, offset, inputs):
    """Launch a kernel over `count` items from `offset` on."""
    launch._load(kernel)
    wp.launch(kernel, count, inputs=[offset, *inputs], device="cpu")


def test_kernels_write_the_last_entries_of_a_large_hierarchy(tmp_path):
    """The errors and ranges of the last rows and diamonds are those of a raster that ends the same way."""
    rng = np.random.default_rng(1)
    lattice, near = fit(SIDE, SIDE), fit(33, 33)
    heights = rng.random((33, 33)).astype(np.float32)
    large = sparse(tmp_path / "samples", (SIDE, SIDE), np.float32)
    large[-33:, -33:] = heights
    small, last = np.zeros(near.node_count, np.float32), np.zeros(near.range_count * 2, np.uint16)
    errors = sparse(tmp_path / "errors", (lattice.node_count,), np.float32)
    found = sparse(tmp_path / "ranges", (2 * lattice.range_count,), np.uint16)
    shift, rows = 2 * (lattice.levels - near.levels), 4
    for one, samples, out, spans, down in ((near, heights, small, last, 0), (lattice, large, errors, found, shift)):
        raster, target = codes.pack_samples(samples, None), flat(out, wp.float32)
        cells = stored_at(one, one.cell_depth)
        launch_last(hierarchy.twists, rows, cells.rows - rows, [raster, cells, target])
        depths = [stored_at(one, down + depth) for depth in (near.cell_depth, near.cell_depth - 1, near.cell_depth - 2)]
        stride = depths[1].columns // 2 + 1
        # The last row of middles of sides is the raster's border; the one before has middles of western sides.
        patches = hierarchy.PatchDistances()  # which only larger triangles read
        inputs = [raster, raster, patches, 1, *depths[:2], target]
        launch_last(hierarchy.side_errors, 15, stride * depths[1].rows - 15, inputs)
        inputs = [raster, raster, patches, 2, 0, *depths[1:], target]
        launch_last(hierarchy.centre_errors, 10, depths[2].columns * depths[2].rows - 10, inputs)
        finest = ranges_at(one, down + near.range_depth)
        inputs = [raster, 0, 0, wp.float64(0.0), wp.float64(2.0**-16), finest, flat(spans, wp.uint16)]
        launch_last(ranges.finest_ranges, 1, finest.rows, inputs)
    assert lattice.cells_x * lattice.cells_y > 2**31
    for depth in range(near.cell_depth - 2, near.cell_depth + 1):
        i, j = same_diamonds(near, depth)
        kept = (i > 20) & (j >= 28)
        i, j, off = i[kept], j[kept], SIDE - 33
        expected = small[error_index(near, depth, i, j)]
        assert np.array_equal(errors[error_index(lattice, depth + shift, off + i, off + j)], expected)
        assert np.count_nonzero(expected) > 5
    i, j = split_points(near, near.range_depth)
    i, j, off = i[j == 32], j[j == 32], SIDE - 33
    expected = last.reshape(-1, 2)[range_index(near, near.range_depth, i, j)]
    at = range_index(lattice, near.range_depth + shift, off + i, off + j)
    assert np.array_equal(found.reshape(-1, 2)[at][1:], expected[1:]) and expected[1:, 1].all()


def test_codes_of_the_last_cells_of_a_large_raster_are_raised(tmp_path):
    lattice, near = fit(SIDE, SIDE), fit(33, 33)
    j, i = np.mgrid[0:32, 0:32].reshape(2, -1)
    values = np.random.default_rng(2).integers(0, 200, i.size).astype(np.uint8)
    translated, results = flat(np.arange(256, dtype=np.uint8), wp.uint8), []
    for one, off in ((near, 0), (lattice, SIDE - 33)):
        old, new = (sparse(tmp_path / f"{name}{off}", (one.node_count,), np.uint8) for name in ("old", "new"))
        at, cells = error_index(one, one.cell_depth, off + i, off + j), stored_at(one, one.cell_depth)
        old[at] = values
        inputs = [wp.int64(0), cells, flat(old, wp.uint8), cells, translated, flat(new, wp.uint8)]
        launch_last(expand.raise_cells, 20, cells.columns * cells.rows - 20, inputs)
        results.append(new[at].reshape(32, 32)[-1, 12:])
    assert np.array_equal(*results) and (results[0] >= values.reshape(32, 32)[-1, 12:]).all() and results[0].any()


def test_missing_samples_behind_2_to_the_31_are_filled(tmp_path):
    width, height = 1 << 12, 525_000
    heights = sparse(tmp_path / "heights", (height, width), np.float32)
    heights[-2:, -40:] = 9.0
    heights[-3, -20] = 7.0

    def missing_in(rows):
        """Return the missing samples of some rows: the last 40 of the last two rows."""
        missing = np.zeros((rows.stop - rows.start, width), bool)
        if rows.stop == height:
            missing[-2:, -40:] = True
        return missing

    fill_rows(lambda: heights, missing_in, heights.shape, 1)
    expected = np.zeros(50)
    expected[-20] = 7.0
    assert heights.size > 2**31 and np.array_equal(heights[-1, -50:], expected)


def test_filling_takes_memory_by_the_width_of_a_raster(monkeypatch):
    """Before, it held 4 bytes a column for every 128 rows: 3 GB of a raster of 300,000 samples a side."""
    width, height = 5000, 1600
    monkeypatch.setattr(cleaning, "FILLED_ROWS", 4)
    heights = np.arange(height, dtype=np.float32)[:, None].repeat(width, axis=1)
    missing = np.zeros((height, width), bool)
    missing[700:900] = True
    tracemalloc.start()
    cleaning.fill_rows(lambda: heights, lambda rows: missing[rows], heights.shape, 1)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (heights[699:903, 7] == np.r_[[699.0] * 101, [900.0] * 101, 901.0, 902.0]).all()
    assert peak < 200 * 4 * width, "rows of 400 chunks are not held"


def test_deeper_trees_are_for_rasters_that_had_no_meshes_before():
    """One square's plane coordinates allow 46 bisections, and of a row of five 40; cells are reached in any case."""
    sizes = (2, 2), (28_673, 28_673), (SIDE, SIDE), (5 * 65_536, SIDE), ((1 << 30) + 1,) * 2, ((1 << 30) + 1, 65)
    expected_by_bits = {0: [34, 34, 46, 40, 59, 13], 4: [40, 40, 46, 41, 59, 13], 8: [40, 47, 49, 49, 59, 13]}
    for bits, expected in expected_by_bits.items():
        raster = SimpleNamespace(finer=SimpleNamespace(bits=bits) if bits else None)
        fields = [SimpleNamespace(lattice=fit(*size), detail=None, raster=raster) for size in sizes]
        assert [depth_limit(field) for field in fields] == expected


def test_coordinates_number_2_to_the_30_cells_a_side():
    side = (1 << 30) + 1
    assert lattice_for(side, side).span == (1 << 30, 1 << 30) and lattice_for(side, 3).columns == 1 << 29
    for size in ((side + 1, side + 1), (side + 1, 2)):
        with pytest.raises(TerrainError, match=rf"has {side + 1} x .* samples; expected at most 2\^30 in a row"):
            lattice_for(*size)
