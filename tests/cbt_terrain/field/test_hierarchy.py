# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges against a recursive bisection in plain Python."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import codes, hierarchy
from adaptive_terrain.cbt_terrain.field.lattice import Lattice, fit
from adaptive_terrain.cbt_terrain.field.meshlet_errors import expand_codes
from diamond_entries import error_index, range_index
from fields import ranges_of, split_points
from own_surface import bilinear

# Vertices are in half samples: the centres of raster cells then have integer coordinates.
ROOTS = (((0, 1), (0, 0), (1, 0)), ((1, 0), (1, 1), (0, 1)))


@cache
def inside(triangle, width, height, step):
    """Return sample coordinates every `step` inside a triangle and the raster."""
    left, apex, right = corners = np.array(triangle) / 2
    lo, hi = np.floor(corners.min(0)), np.ceil(corners.max(0))
    x, y = np.meshgrid(np.arange(lo[0], hi[0] + step / 2, step), np.arange(lo[1], hi[1] + step / 2, step))
    uv = np.linalg.solve(np.column_stack([left - apex, right - apex]), np.array([x.ravel(), y.ravel()]) - apex[:, None])
    keep = (uv >= -1e-9).all(0) & (uv.sum(0) <= 1 + 1e-9) & (x.ravel() <= width - 1) & (y.ravel() <= height - 1)
    return x.ravel()[keep], y.ravel()[keep]


def triangle_errors(samples, triangle, fine=4):
    """Error of one triangle by what can be an extremum, and by dense sampling; and the heights that it covers.

    A corner beyond the raster has the height of the nearest sample; nothing else counts there.
    """
    left, apex, right = corners = np.array(triangle) / 2
    (height, width), rim = samples.shape, np.array(samples.shape[::-1]) - 1
    plane = np.linalg.solve(np.column_stack([corners, np.ones(3)]), bilinear(samples, *np.minimum(corners, rim).T))

    def above(heights, x, y):
        return heights - (plane[0] * x + plane[1] * y + plane[2])

    def distance(x, y):
        return above(bilinear(samples, x, y), x, y)

    exact = np.abs(distance(*inside(triangle, width, height, 1.0))).max(initial=0.0)
    for a, b in ((left, apex), (apex, right), (right, left)):
        if abs(a[0] - b[0]) == abs(a[1] - b[1]):  # a diagonal: a parabola in each cell
            cells = int(np.ceil(abs(a[0] - b[0])))
            ends = a + (b - a) * np.linspace(0, 1, cells + 1)[:, None]
            middles = (ends[1:] + ends[:-1]) / 2
            within = (np.maximum(ends[1:], ends[:-1]) <= rim).all(1)
            e, m = distance(*ends.T), distance(*middles.T)
            quadratic = 2 * (e[1:] + e[:-1] - 2 * m)
            linear = e[1:] - e[:-1] - quadratic
            with np.errstate(all="ignore"):
                t = np.nan_to_num(np.clip(-linear / (2 * quadratic), 0, 1))
            exact = max(exact, np.abs(e[:-1] + linear * t + quadratic * t * t)[within].max(initial=0.0))
    x, y = inside(triangle, width, height, 1.0 / fine)
    heights = bilinear(samples, x, y)
    dense = np.abs(above(heights, x, y)).max(initial=0.0)
    return exact, dense, heights.min(initial=np.inf), heights.max(initial=-np.inf)


def brute(samples, columns, rows, levels):
    """Return dicts by split vertex (in half samples): errors and range, children, depth."""
    side, samples = 2 << levels, samples.astype(np.float64)
    nodes, children, depth_of = {}, {}, {}

    def walk(triangle, depth):
        left, apex, right = triangle
        middle = ((left[0] + right[0]) // 2, (left[1] + right[1]) // 2)
        found = triangle_errors(samples, triangle)
        known = nodes.get(middle, (0.0, 0.0, np.inf, -np.inf))
        nodes[middle] = (
            max(known[0], found[0]), max(known[1], found[1]), min(known[2], found[2]), max(known[3], found[3])
        )  # fmt: skip
        depth_of[middle] = depth
        children.setdefault(middle, set())
        if depth <= 2 * levels:
            for a, b in ((left, apex), (apex, right)):
                children[middle].add(((a[0] + b[0]) // 2, (a[1] + b[1]) // 2))
            walk((left, middle, apex), depth + 1)
            walk((apex, middle, right), depth + 1)

    for q in range(columns * rows):
        x0, y0 = q % columns * side, q // columns * side
        for root in ROOTS:
            walk(tuple((x0 + x * side, y0 + y * side) for x, y in root), 1)
    return nodes, children, depth_of


def saturated_twists(samples, lattice):
    """T of each cell, padding included: the largest of all cells' twists, divided by four for each step of distance."""
    h = samples.astype(np.float64)
    twist = np.abs(h[1:, 1:] + h[:-1, :-1] - h[1:, :-1] - h[:-1, 1:])
    twist = np.pad(twist, [(0, n - m) for n, m in zip(lattice.span[::-1], twist.shape, strict=True)])
    y, x = np.indices(twist.shape)
    return np.array(
        [
            [(twist * 4.0 ** -(np.abs(x - i) + np.abs(y - j))).max() for i in range(twist.shape[1])]
            for j in range(len(twist))
        ]
    )


def saturate(own, children, cells):
    @cache
    def value(v):
        return max([own[v][0] if v not in cells else cells[v], *(value(c) for c in children[v])])

    return {v: value(v) for v in own}


def is_beyond(lattice, vertex, depth):
    """Return whether a diamond and all vertices below it are outside the raster."""
    side = 2 << (lattice.levels - (depth - 1) // 2)  # half samples: of the cell, or of the side
    reach = 3 * side // 2 if depth % 2 else side
    return vertex[0] - reach >= 2 * lattice.cells_x or vertex[1] - reach >= 2 * lattice.cells_y


def index_of(lattice, vertex, depth):
    """Entry of the diamond of a split vertex in half samples."""
    return int(error_index(lattice, depth, vertex[0] // 2, vertex[1] // 2))


def compute(samples, lattice, threads=1):
    errors = np.zeros(lattice.node_count, np.float32)
    hierarchy.build_errors(samples, lattice, errors, threads)
    base, step = hierarchy.range_scale(float(samples.min()), float(samples.max()))
    ranges = np.zeros((lattice.range_count, 2), np.uint16)
    hierarchy.build_ranges(samples, lattice, base, step, ranges, threads)
    return errors, base, step, ranges


def raster(kind, lattice, seed=1):
    shape = lattice.height, lattice.width
    random = np.random.default_rng(seed)
    y, x = np.indices(shape)
    samples = {
        "random": random.standard_normal(shape) * 100,
        "spike": np.where((x == shape[1] // 3) & (y == shape[0] // 2 + 1), 1000.0, 0.0),
        "checkerboard": (x + y) % 2 * 10.0,
        "cliff": np.where(x > 0.4 * shape[1], 1e6, 0.0) + random.standard_normal(shape),
        "plane": 0.25 * x - 3.5 * y + 100.0,
        "constant": np.full(shape, -431.1),
        "saddle": x * y * 0.5,
        "hill": 500.0 * np.exp(-((x / shape[1] - 0.4) ** 2 + (y / shape[0] - 0.6) ** 2) * 9) - 700.0,
    }[kind]
    return np.ascontiguousarray(samples, np.float32)


LATTICES = [Lattice(1, 1, 3), Lattice(3, 2, 2), Lattice(5, 1, 1), Lattice(2, 3, 0)]
LATTICES += [Lattice(1, 1, 3, cells_x=6, cells_y=5), Lattice(3, 2, 2, cells_x=9, cells_y=8), fit(4, 7)]
KINDS = ["random", "spike", "checkerboard", "cliff", "plane", "constant", "saddle", "hill"]


def name_of(k) -> str:
    """Return a kind, or the squares, levels and cells of a lattice."""
    return k if isinstance(k, str) else f"{k.columns}x{k.rows}x2^{k.levels}-{k.cells_x}x{k.cells_y}"


EVERY = [(kind, lattice) for lattice in LATTICES for kind in KINDS]
SOME = LATTICES[1], LATTICES[3], LATTICES[4]  # of several squares, without levels, and padded
FEW = [(kind, lattice) for kind, lattice in EVERY if lattice == LATTICES[-1] or (kind == "random" and lattice in SOME)]


@pytest.mark.parametrize(
    ("kind", "lattice"),
    [*FEW, *(pytest.param(*case, marks=pytest.mark.thorough) for case in EVERY if case not in FEW)],
    ids=name_of,
)
def test_errors_and_ranges_equal_brute_force(kind, lattice):
    samples = raster(kind, lattice)
    errors, base, step, ranges = compute(samples, lattice)
    low, high = ranges_of(SimpleNamespace(lattice=lattice, ranges=ranges))
    errors = errors.astype(np.float64)
    own, children, depth_of = brute(samples, lattice.columns, lattice.rows, lattice.levels)
    twist = saturated_twists(samples, lattice)
    beyond = {v for v, d in depth_of.items() if is_beyond(lattice, v, d)}
    cells = {v: twist[v[1] // 2, v[0] // 2] / 4 for v, d in depth_of.items() if d == lattice.cell_depth}
    cells |= {v: 0.0 for v in beyond if v in cells}
    wanted = saturate(own, children, cells)
    scale = np.abs(samples).max() * 1e-13
    for vertex, depth in depth_of.items():
        if vertex in beyond:
            assert wanted[vertex] == 0.0 and children[vertex] <= beyond
            continue
        index = index_of(lattice, vertex, depth)
        assert index < lattice.node_count
        assert wanted[vertex] - scale <= errors[index] <= wanted[vertex] * (1 + 2.0**-22) + scale
        assert own[vertex][1] <= errors[index] + scale  # what dense sampling finds is within the bound
        for child in children[vertex] - beyond:
            inner = index_of(lattice, child, depth_of[child])
            assert errors[inner] <= errors[index]
            if depth < lattice.cell_depth - 1:
                (x, y), (a, b) = np.array(vertex) // 2, np.array(child) // 2
                assert low[b, a] >= low[y, x] and high[b, a] <= high[y, x]
        if depth < lattice.cell_depth and own[vertex][2] <= own[vertex][3]:
            x, y = np.array(vertex) // 2
            assert base + low[y, x] * step <= own[vertex][2] and own[vertex][3] <= base + high[y, x] * step
    if kind == "constant" or (kind == "plane" and not lattice.is_padded):  # beyond the rim ground goes on level
        assert not errors.any()


def error_with_holes(samples, measured, triangle):
    """Return the error of a triangle of corners in samples; NaN in `measured` does not count."""
    height, width = samples.shape
    corners = np.array(triangle)
    at = np.minimum(corners, (width - 1, height - 1)).T
    plane = np.linalg.solve(np.column_stack([corners, np.ones(3)]), samples[at[1], at[0]].astype(np.float64))
    distance = np.pad(measured.astype(np.float64), ((0, 1), (0, 1)), constant_values=np.nan)
    distance -= np.add.outer(plane[1] * np.arange(height + 1), plane[0] * np.arange(width + 1)) + plane[2]
    x, y = (item.astype(int) for item in inside(tuple(map(tuple, 2 * corners)), width, height, 1.0))
    found = [distance[y, x]]
    for begin, end in zip(corners, np.roll(corners, 1, axis=0), strict=True):
        if (begin != end).all():  # a side through cells: a parabola in each
            steps = np.linspace(begin, end, abs(begin[0] - end[0]) + 1).astype(int)
            steps = steps[(steps <= (width, height)).all(1)]
            (x, y), (next_x, next_y) = steps[:-1].T, steps[1:].T
            e0, e1 = distance[y, x], distance[next_y, next_x]
            twist = e0 + e1 - distance[y, next_x] - distance[next_y, x]
            t = np.linspace(0.0, 1.0, 257)[:, None]
            found.append(e0 * (1 - t) + e1 * t - twist * t * (1 - t))
    return max(np.nan_to_num(np.abs(part)).max(initial=0.0) for part in found)


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("kind", ["random", "spike", "cliff", "saddle", "hill"])
def test_large_triangles_have_the_largest_distance(kind, holes):
    """Most blocks of a triangle with legs of 16 samples or more are not read: the result must be as if all were."""
    lattice = Lattice(1, 1, 6, cells_x=61, cells_y=43)
    samples, errors = raster(kind, lattice), np.zeros(lattice.node_count, np.float32)
    measured = samples.copy()
    if holes:
        measured[np.random.default_rng(2).random(samples.shape) < 0.1] = np.nan
        measured[::8, ::8] = np.nan  # corners of blocks
    hierarchy.build_errors(samples, lattice, errors, 1, measured=measured)
    own, children, depth_of = {}, {}, {}

    def middle_of(a, b):
        return ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2)

    def walk(left, apex, right, depth):
        middle = middle_of(left, right)
        if middle[0] <= 61 and middle[1] <= 43:
            own[middle] = max(own.get(middle, 0.0), error_with_holes(samples, measured, (left, apex, right)))
            below = {middle_of(left, apex), middle_of(apex, right)}
            children.setdefault(middle, set()).update(c for c in below if c[0] <= 61 and c[1] <= 43)
            depth_of[middle] = depth
        if depth < 5:
            walk(left, middle, apex, depth + 1)
            walk(apex, middle, right, depth + 1)

    walk((0, 64), (0, 0), (64, 0), 1)
    walk((64, 0), (64, 64), (0, 64), 1)
    assert len(own) == 23
    for vertex, error in own.items():
        depth = depth_of[vertex]
        below = [float(errors[error_index(lattice, depth + 1, *child)]) for child in children[vertex]]
        found = float(errors[error_index(lattice, depth, *vertex)])
        assert max(error, *below) * (1 - 1e-12) <= found <= max(error, *below) * (1 + 1e-4), vertex


def expand(errors, lattice, meshlet, threads=1):
    """Return errors rounded to codes, and those of meshlets, float64 metres."""
    found = np.zeros(errors.shape, np.uint8)
    table = codes.tables(codes.encode(lattice, errors, found, threads))
    rounded = codes.decode(lattice, found, table)
    expand_codes(lattice, found, table, meshlet, threads)
    return rounded.astype(np.float64), codes.decode(lattice, found, table).astype(np.float64)


@pytest.mark.thorough
@pytest.mark.parametrize("meshlet", [1, 2])
@pytest.mark.parametrize("kind", ["random", "spike", "hill"])
def test_errors_of_meshlets_are_those_of_the_mesh_that_is_drawn(kind, meshlet):
    lattice = Lattice(3, 2, 1)
    samples = raster(kind, lattice)
    errors, *_ = compute(samples, lattice)
    errors, expanded = expand(errors, lattice, meshlet)

    finer = 1 << meshlet  # the surface itself does not change when it is sampled finer
    fine = Lattice(lattice.columns, lattice.rows, lattice.levels + meshlet)
    y, x = np.indices((fine.height, fine.width)) / finer
    own, children, depth_of = brute(bilinear(samples, x, y), fine.columns, fine.rows, fine.levels)

    @cache
    def drawn(vertex, generations):
        if generations == 0:
            return own[vertex][0]
        return max(drawn(c, generations - 1) for c in children[vertex])

    for vertex, depth in depth_of.items():
        if depth <= lattice.cell_depth:
            coarse = (vertex[0] // finer, vertex[1] // finer)
            index = index_of(lattice, coarse, depth)
            assert drawn(vertex, 2 * meshlet) <= expanded[index] * (1 + 1e-9) + 1e-9
            assert expanded[index] <= errors[index]
            for child in children[vertex]:
                if depth < lattice.cell_depth:
                    inner = index_of(lattice, (child[0] // finer, child[1] // finer), depth + 1)
                    assert expanded[inner] <= expanded[index]


def test_twists_are_saturated_for_the_sides_below_the_raster():
    lattice = Lattice(3, 2, 3)
    errors, *_ = compute(raster("spike", lattice), lattice)
    for meshlet in range(4):
        _, expanded = expand(errors, lattice, meshlet)
        cells = level(expanded, lattice, lattice.cell_depth)
        for a, b in ((cells[1:], cells[:-1]), (cells[:, 1:], cells[:, :-1])):
            assert (a >= b / 4).all() and (b >= a / 4).all()


def test_a_hierarchy_of_real_size_is_nested():
    lattice = Lattice(3, 2, 6)
    errors, _, _, ranges = compute(raster("random", lattice), lattice, threads=2)
    for depth in range(1, lattice.cell_depth):
        check_nested(errors, lattice, depth)
    low, high = ranges_of(SimpleNamespace(lattice=lattice, ranges=ranges))
    for limits in (-low, high):
        values = np.zeros(lattice.node_count, int)
        for depth in range(1, lattice.cell_depth):
            i, j = split_points(lattice, depth)
            values[error_index(lattice, depth, i, j)] = limits[j, i]
        for depth in range(1, lattice.cell_depth - 1):
            check_nested(values, lattice, depth)


def level(values, lattice, depth):
    """Return the diamonds of a depth: [rows, columns] of cells, or of corners of half cells, NaN between."""
    side = 1 << (lattice.levels - (depth - 1) // 2)
    if depth % 2:
        j, i = np.mgrid[side // 2 : lattice.height - 1 : side, side // 2 : lattice.width - 1 : side]
        return values[error_index(lattice, depth, i, j)]
    j, i = np.mgrid[0 : lattice.height : side // 2, 0 : lattice.width : side // 2]
    middle = (i // (side // 2) + j // (side // 2)) % 2 == 1
    found = np.full(i.shape, np.nan)
    found[middle] = values[error_index(lattice, depth, i[middle], j[middle])]
    return found


def check_nested(values, lattice, depth):
    """Assert, by array slices, that no diamond of `depth` is below its children."""
    own, finer = level(values, lattice, depth), level(values, lattice, depth + 1)
    if depth % 2:
        for child in (finer[:-1:2, 1::2], finer[2::2, 1::2], finer[1::2, :-1:2], finer[1::2, 2::2]):
            assert (own >= child).all()
        return
    for corner in (own[:-1, :-1], own[:-1, 1:], own[1:, :-1], own[1:, 1:]):
        assert (np.isnan(corner) | (corner >= finer)).all()


def test_entries_of_no_diamond_are_zero():
    lattice = Lattice(3, 2, 2)
    samples = raster("random", lattice)
    errors, _, _, quantised = compute(samples, lattice)
    used = np.zeros(lattice.node_count, bool)
    for vertex, depth in brute(samples, lattice.columns, lattice.rows, lattice.levels)[2].items():
        used[index_of(lattice, vertex, depth)] = True
    assert (errors[used] > 0.0).all() and not errors[~used].any()
    held = np.zeros(lattice.range_count, bool)
    for depth in range(1, lattice.range_depth + 1):
        held[range_index(lattice, depth, *split_points(lattice, depth))] = True
    assert quantised[held, 1].all() and not quantised[~held].any()
    _, errors = expand(errors, lattice, 1)
    assert (errors[used] > 0.0).all() and not errors[~used].any()


def test_two_threads_give_the_same_bytes_as_one():
    lattice = Lattice(3, 2, 7)
    samples = raster("random", lattice)
    one, two = compute(samples, lattice, 1), compute(samples, lattice, 2)
    assert one[0].tobytes() == two[0].tobytes() and one[3].tobytes() == two[3].tobytes()
    assert expand(one[0], lattice, 2, 1)[1].tobytes() == expand(two[0], lattice, 2, 2)[1].tobytes()


def test_range_scale_covers_both_ends():
    for low, high in ((0.0, 1.0), (-3.3, 1e30), (5.0, 5.0), (1e8, 1e8 + 8), (0.0, 1e-45)):
        base, step = hierarchy.range_scale(low, high)
        assert base <= low and base + 65535 * step >= high and step > 0
