# SPDX-License-Identifier: GPL-3.0-or-later
"""What a height field keeps of its floats: errors in bytes without a crack, heights as the source's own numbers."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field import codes
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.domain import make_domain
from adaptive_terrain.cbt_terrain.field.hierarchy import build_errors
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.kernels.field.domain import Domain
from adaptive_terrain.kernels.refine.diamond import range_at
from diamond_entries import error_index
from fields import errors_of, extent, random_view, ranges_of, split_points
from invariants import assert_invariants
from rasters import imported, write_raster

SHAPES = [(33, 33), (17, 65), (97, 33), (3, 5), (29, 50)]
KINDS = ["rough", "spike", "deep spike", "cliffs", "fractal"]


def heights_of(kind: str, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(len(kind))
    y, x = np.indices(shape)
    noise = rng.standard_normal(shape)
    if kind == "rough":
        return (60 * np.sin(x / 7) * np.cos(y / 9) + noise).astype(np.float32)
    if kind == "fractal":
        return sum(2.0**-k * np.sin(x * 1.7**k + k) * np.cos(y * 1.9**k - k) for k in range(8)).astype(np.float32) * 90
    if kind == "cliffs":
        return (np.where(rng.random(shape) < 0.1, 800.0, 0.0) + 0.01 * noise).astype(np.float32)
    spike = np.where((x == shape[1] // 2) & (y == shape[0] // 3), 300.0 if kind == "spike" else -32768.0, 0.0)
    return (spike + 1e-3 * np.sin(x / 5) + 1e-5 * noise).astype(np.float32)


def assert_nested(field, meshlet: int) -> None:
    """Assert that no diamond's error is above its parents' at any depth, in cells too."""
    lattice, errors = field.lattice, errors_of(field, meshlet)
    across, up = lattice.span
    dense = np.zeros((up + 1, across + 1))
    for depth in range(1, lattice.cell_depth):
        i, j = split_points(lattice, depth)
        dense[j, i] = errors[error_index(lattice, depth, i, j)]
    for depth in range(1, lattice.cell_depth - 1):
        i, j = split_points(lattice, depth)
        half = 1 << (lattice.levels - 1 - (depth - 1) // 2)
        steps = [(half, 0), (-half, 0), (0, half), (0, -half)]
        if depth % 2 == 0:
            steps = [(a * half // 2, b * half // 2) for a in (-1, 1) for b in (-1, 1)]
        for dx, dy in steps:
            x, y = i + dx, j + dy
            inside = (x >= 0) & (y >= 0) & (x <= across) & (y <= up)
            assert (dense[y[inside], x[inside]] <= dense[j[inside], i[inside]]).all(), depth
    wide, high = lattice.extent(lattice.cell_depth)
    rows, columns = np.indices((high, wide))
    cell = errors[error_index(lattice, lattice.cell_depth, columns, rows)]
    i, j = split_points(lattice, lattice.cell_depth - 1) if lattice.levels else (np.zeros(0, int),) * 2
    for dx, dy in ((0, 0), (-1, 0), (0, -1), (-1, -1)):
        x, y = i + dx, j + dy
        inside = (x >= 0) & (y >= 0) & (x < wide) & (y < high)
        assert (cell[y[inside], x[inside]] <= dense[j[inside], i[inside]]).all()
    # Below: a side has the larger of two cells' bends, halved (bicubic) or their twists, in quarters.
    below, part = cell, 4
    if field.interpolation == "bicubic":
        below, part = (
            errors[error_index(lattice, lattice.cell_depth, columns, rows) + lattice.node_count - lattice.cell_base],
            2,
        )
        assert (below <= part * cell).all()
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        for one, two in ((a, b), (b, a)):
            assert (cell[one] >= below[two] / part).all() and (below[one] >= below[two] / part).all()


# Every kind and every shape twice in every run.
PAIRS = [(i, j) for i in range(len(KINDS)) for j in range(len(SHAPES))]
CASES = [
    pytest.param(KINDS[i], SHAPES[j], marks=[] if (j - i) % 5 in (0, 2) else pytest.mark.thorough) for i, j in PAIRS
]


@pytest.mark.parametrize(("kind", "shape"), CASES)
def test_errors_in_bytes_are_nested_at_every_depth(kind, shape):
    field = from_array(heights_of(kind, shape), 10.0)
    for surface in (field, interpolated(field, "bicubic")):
        for meshlet in (0, 1, 3):
            assert_nested(surface, meshlet)


def test_a_plain_geometric_table_would_crack(monkeypatch):
    """The check fails for a table with entries whose doubles are no entries."""
    table = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 255)]).astype(np.float32)
    monkeypatch.setattr(codes, "SHAPE", table)
    with pytest.raises(AssertionError):
        for kind in KINDS:
            assert_nested(from_array(heights_of(kind, (97, 33)), 10.0), 0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_byte_is_never_less_than_the_error_and_little_more(kind):
    heights = heights_of(kind, (97, 33))
    field = from_array(heights, 10.0)
    exact = np.zeros(field.lattice.node_count, np.float32)
    build_errors(heights, field.lattice, exact, 1)
    errors = errors_of(field)
    assert (errors >= exact).all() and np.array_equal(errors == 0, exact == 0)
    largest = errors.max()
    some = exact > 0
    assert (errors[some] <= np.maximum(2.0 * exact[some], largest * 2.0**-33)).all()
    ends = field.lattice.layout()[0].tolist()
    for first, end in zip(ends, ends[1:], strict=False):
        part = exact[first:end]
        near = part > part.max() / 64  # where meshes are decided
        assert (errors[first:end][near] <= part[near] * 2 ** (1 / 28) * (1 + 1e-6)).all()


@pytest.mark.parametrize("exponent", [codes.MIN_EXPONENT, 3, codes.MAX_EXPONENT])
@pytest.mark.parametrize("shape", ["used", "even steps"])
def test_each_error_gets_the_first_code_not_below_it(exponent, shape):
    """The codes are those of a binary search, at the table's entries and beside them, too."""
    table = codes.tables([exponent])[0]
    table = table if shape == "used" else np.ldexp(np.linspace(0.0, 1.0, 256), exponent).astype(np.float32)
    beside = [np.nextafter(table, np.float32(end)) for end in (0.0, np.inf)]
    spread = np.float32(2.0) ** np.random.default_rng(1).uniform(-149, 127, 20_000).astype(np.float32)
    errors = np.concatenate([table, *beside, spread, np.float32([np.inf, 3e38])])
    found = np.zeros(len(errors), np.uint8)
    codes.encode_part(errors, table, found, 1)
    assert np.array_equal(found, np.minimum(np.searchsorted(table, errors), 255))


def test_the_table_holds_twice_every_entry():
    assert codes.SHAPE[0] == 0 and codes.SHAPE[-1] == 1 and codes.SHAPE.shape == (256,)
    assert (np.diff(codes.SHAPE) > 0).all()
    assert set((2 * codes.SHAPE[codes.SHAPE <= 0.5]).tolist()) <= set(codes.SHAPE.tolist())
    for exponent in (codes.MIN_EXPONENT, 0, codes.MAX_EXPONENT):
        table = codes.tables([exponent])[0]
        assert np.isfinite(table).all() and (np.diff(table) > 0).all() and table[1] >= np.finfo(np.float32).tiny
    for largest in (1.0, 0.75, 1e-3, 2.0**-80, 1e30):
        exponent = codes.exponent_of(largest)
        assert 2.0 ** (exponent - 1) < largest <= 2.0**exponent


@pytest.mark.parametrize(
    ("kind", "surface"),
    [
        *((kind, "bilinear") for kind in KINDS),
        *((kind, "bicubic") for kind in KINDS[-2:]),
        *(pytest.param(kind, "bicubic", marks=pytest.mark.thorough) for kind in KINDS[:-2]),
    ],
)
def test_meshes_of_random_views_have_no_crack(kind, surface):
    rng = np.random.default_rng(7)
    field = interpolated(from_array(heights_of(kind, (17, 65)), 10.0), surface)
    terrain = Terrain(field, 1)
    for meshlet in (0, 0, 0, 0, 1):
        view = random_view(rng, field)
        asked = Criterion(error_px=float(10 ** rng.uniform(-1, 1)), max_triangles=10_000, meshlet=meshlet)
        assert_invariants(terrain.update(asked, [view]).surface, field.lattice, meshlet)
    metres = float(extent(field)[2]) * 1e-4 + 1e-4  # far below the cells, everywhere
    asked = Criterion(error_px=0.0, error_m=metres, max_depth=field.lattice.cell_depth + 4, max_triangles=20_000)
    assert_invariants(terrain.update(asked).surface, field.lattice)


wp.set_module_options({"enable_backward": False})


@wp.kernel
def ranges_in_kernel(domain: Domain, points: wp.array(dtype=wp.vec3i), out: wp.array(dtype=wp.vec2i)):
    p = points[wp.tid()]
    out[wp.tid()] = range_at(domain, p[0], p[1], p[2], domain.levels, wp.bool(False))


@pytest.mark.parametrize("shape", [*SHAPES, (2, 4)])
def test_a_walk_reads_the_ranges_of_every_diamond(shape):
    field = from_array(heights_of("rough", shape), 10.0)
    lattice, domain = field.lattice, make_domain(field, 0, 1.0, 0.0)
    low, high = ranges_of(field)
    for depth in range(1, lattice.cell_depth):
        i, j = split_points(lattice, depth)
        inside = (i < lattice.width) & (j < lattice.height)
        i, j = i[inside], j[inside]
        points = np.stack([i, j, np.full_like(i, depth)], axis=1) << (domain.unit_bits - lattice.levels)
        points[:, 2] = depth
        out = wp.zeros(len(i), dtype=wp.vec2i, device="cpu")
        points = wp.array(points.astype(np.int32), dtype=wp.vec3i, device="cpu")
        wp.launch(ranges_in_kernel, len(i), inputs=[domain, points, out], device="cpu")
        assert np.array_equal(out.numpy(), np.stack([low[j, i], high[j, i]], axis=1)), depth


SOURCES = {
    "int16": {},
    "uint16 scaled": {"height_scale": 8848.0 / 65535, "height_offset": -100.25},
    "uint8": {"height_scale": -0.3},
}


@pytest.mark.parametrize("name", SOURCES)
def test_16_bit_integers_give_the_mesh_of_their_heights(tmp_path, name):
    rng, dtype = np.random.default_rng(3), np.dtype(name.split()[0])
    about = np.iinfo(dtype)
    walk = np.cumsum(rng.integers(-40, 41, (65, 129)), axis=1) + (about.min + about.max) // 2
    stored = np.clip(walk, about.min, about.max).astype(dtype)
    stored[0, :2] = about.min, about.max
    scale, offset = (SOURCES[name].get(key, other) for key, other in (("height_scale", 1.0), ("height_offset", 0.0)))
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", stored), **SOURCES[name])
    heights = (stored.astype(np.float64)[::-1] * scale + offset).astype(np.float32)
    assert field.samples.dtype == np.uint16 and np.array_equal(field.heights(), heights)
    assert np.array_equal(field.heights(3, slice(5, 9)), heights[3, 5:9])
    step = field.lattice.step_x
    floats = from_array(heights, step, source_max=field.source_max)
    assert floats.samples.dtype == np.float32 and floats.key == field.key
    rng = np.random.default_rng(5)
    for surface in ("bilinear", "bicubic"):
        both = [Terrain(interpolated(f, surface), 1) for f in (field, floats)]
        for _ in range(3):
            view = random_view(rng, field)
            one, two = (t.update(Criterion(error_px=2.0, max_triangles=20_000), [view]).surface for t in both)
            assert one.positions.tobytes() == two.positions.tobytes()
            assert one.normals.tobytes() == two.normals.tobytes()
            assert one.corner_verts.tobytes() == two.corner_verts.tobytes()


@pytest.mark.parametrize("changed", [False, True])
def test_heights_that_no_number_stands_for_stay_floats(tmp_path, changed):
    """Filled samples are copies of others, and so are numbers; of floats and of 32 bits nothing is made."""
    stored = np.arange(33 * 33, dtype=np.int16).reshape(33, 33)
    if changed:
        stored = stored.astype(np.int32) * 100_000 + 1
    np.save(tmp_path / "a.npy", stored)
    run_import(ImportSettings(source=str(tmp_path / "a.npy"), no_data=5.0), tmp_path / "store")
    field = open_store(tmp_path / "store")
    assert field.samples.dtype == (np.float32 if changed else np.uint16) and field.filled == (not changed)
    numbers = np.zeros((4, 4), np.uint16)
    steps = codes.Steps(0, 0.5, 1.0)
    assert codes.number(np.full((4, 4), 3.5, np.float32), steps, numbers) and (numbers == 5).all()
    for height in (3.25, 0.5, 40000.0):
        assert not codes.number(np.full((4, 4), height, np.float32), steps, numbers)


@pytest.mark.parametrize("steps", [codes.Steps(-500, 1.0, 0.0), codes.Steps(7, -0.1, 3.3)])
@pytest.mark.parametrize("shape", [(1_300, 900), (1_200_000,), (3, 600_000)])
def test_heights_of_many_numbers_are_those_of_one_by_one(steps, shape):
    numbers = (np.arange(np.prod(shape)) * 40_503 % 65_536).astype(np.uint16).reshape(shape)
    expected = np.multiply(numbers.astype(np.float64) + steps.first, steps.scale) + steps.offset
    heights = steps.heights(numbers)
    assert heights.dtype == np.float32 and np.array_equal(heights, expected.astype(np.float32))
