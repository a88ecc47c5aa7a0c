# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut surfaces against polygons that are clipped one by one in float64."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.mesh.attributes import EDGE, Attribute
from adaptive_terrain.cbt_terrain.mesh.cut import TOLERANCE, Side, above_line, border_side, cut, drop_triangles, swap
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from cut_surfaces import areas, assert_welded, surface_of
from fields import rough, sample_position

ARRAYS = ("positions", "normals", "uv", "corner_verts", "corner_edges", "edges", "level")


def moments(polygon: np.ndarray) -> np.ndarray:
    """Area and volume below a flat polygon, float64 [n, 3]."""
    total = np.zeros(2)
    for b, c in zip(polygon[1:], polygon[2:], strict=False):
        u, v = b - polygon[0], c - polygon[0]
        area = 0.5 * (u[0] * v[1] - u[1] * v[0])
        total += area, area * (polygon[0, 2] + b[2] + c[2]) / 3
    return total


def clipped(polygon: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Clip a polygon to its non-negative part (Sutherland, Hodgman 1974)."""
    out = []
    for k in range(len(polygon)):
        p, q, a, b = polygon[k - 1], polygon[k], value[k - 1], value[k]
        if a * b < 0:
            out.append(p + a / (a - b) * (q - p))
        if b >= 0:
            out.append(q)
    return np.array(out).reshape(-1, 3)


@pytest.mark.parametrize("meshlet", [0, 2])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(2, 6))])
def test_what_stays_is_what_clipping_every_triangle_leaves(seed, meshlet):
    surface = surface_of(seed, 8.0, meshlet)
    rng = np.random.default_rng(seed)
    count = len(surface.positions)
    # Far from 0, so that no new vertex is at an old one's place; a third of them on the line.
    values = rng.choice([-1.0, 0.0, 1.0], count) * rng.uniform(0.5, 2.0, count)
    result, _ = cut(surface, [Side(lambda _: values, tolerance=0.0)])
    border = assert_welded(result)
    expected = np.zeros(2)
    for corners in surface.triangles:
        expected += moments(clipped(surface.positions[corners].astype(np.float64), values[corners]))
    found = sum(moments(result.positions[corners].astype(np.float64)) for corners in result.triangles)
    assert np.allclose(found, expected, rtol=0, atol=2e-6 * expected[0] * (1 + np.abs(surface.positions[:, 2]).max()))
    # No border but the old one and the line.
    kept = {p.tobytes(): v for p, v in zip(surface.positions, values, strict=True)}
    on_line = np.array([kept.get(p.tobytes(), 0.0) == 0.0 for p in result.positions])
    low, high = surface.positions[:, :2].min(axis=0), surface.positions[:, :2].max(axis=0)
    place = result.positions[border][:, :, :2]
    old = ((place == low) | (place == high)).all(axis=1).any(axis=1)
    assert (on_line[border].all(axis=1) | old).all()
    assert set(map(bytes, surface.positions[values > 0])) <= set(map(bytes, result.positions))


@pytest.mark.parametrize(("error_m", "meshlet"), [(100.0, 0), (5.0, 0), (5.0, 2), (0.5, 1)])
@pytest.mark.parametrize(
    ("east", "north"), [(170.0, 90.0), (320.0, 90.0), (310.0, 160.0), (-310.0, -150.0), (0.0, 0.0)]
)
def test_two_rims_leave_exactly_the_rectangle(error_m, meshlet, east, north):
    surface = surface_of(1, error_m, meshlet)
    result, _ = cut(surface, [border_side(0, east, 1e-3), border_side(1, north, 1e-3)])
    place = result.positions[assert_welded(result)][:, :, :2]
    low, high = np.array([-320.0, -160.0], np.float32), np.array([east, north], np.float32)
    assert ((place == low) | (place == high)).all(axis=1).any(axis=1).all()
    assert areas(result).sum() == (east + 320) * (north + 160)
    assert len(result.positions) - len(result.edges) + len(result.level) == 1
    for corner in ((-320, -160), (east, -160), (east, north), (-320, north)):
        assert (result.positions[:, :2] == np.array(corner, np.float32)).all(axis=1).sum() == 1
    new = ~np.isin(result.positions.view("V12"), surface.positions.view("V12")).ravel()
    assert (result.uv[new] == 1).any(axis=1).all()


@pytest.mark.parametrize(
    ("rows", "columns", "step_x", "step_y", "meshlet"),
    [
        (7, 843, 1.924554874891616, 1.924554874891616, 0),
        (4, 596, 45.25638762482929, 45.25638762482929, 0),
        (15, 851, 254.28671362829053, 348.3727976707581, 0),
        (30, 762, 22.91920739376341, 31.399314129455878, 2),
    ],
)
def test_an_edge_through_the_corner_of_a_raster_is_cut_once(rows, columns, step_x, step_y, meshlet):
    """Where the steps are no numbers of float32 both rims meet it in places a rounding apart."""
    heights = np.random.default_rng(4).standard_normal((rows, columns)).astype(np.float32)
    terrain = Terrain(from_array(heights, step_x, step_y), 1)
    for error_m in (100.0, 1.0):
        surface = terrain.update(Criterion(error_px=0.0, error_m=error_m, meshlet=meshlet)).surface
        place = surface.positions[assert_welded(surface)][:, :, :2]
        low, high = surface.positions[:, :2].min(axis=0), surface.positions[:, :2].max(axis=0)
        assert ((place == low) | (place == high)).all(axis=1).any(axis=1).all()
        corner = (surface.positions[:, :2] == high).all(axis=1)
        assert corner.sum() == 1 and (surface.uv[corner] == 1).all()


def test_where_nothing_is_negative_the_surface_stays_as_it_is():
    surface = surface_of(2, 5.0, 0)
    assert cut(surface, [border_side(0, 320.5, 1e-3), border_side(1, 160.5, 1e-3)])[0] is surface
    on_rim, swapped = cut(surface, [border_side(0, 320.0, 1e-3), border_side(1, 160.0, 1e-3)])
    assert not swapped.size and all(np.array_equal(getattr(on_rim, n), getattr(surface, n)) for n in ARRAYS)


def test_nothing_is_left_where_all_is_negative():
    result, _ = cut(surface_of(2, 5.0, 0), [border_side(0, -400.0, 1e-3)])
    assert not any(getattr(result, name).size for name in ARRAYS)


def test_a_coast_is_on_its_level_to_a_few_steps_of_float32():
    surface = surface_of(3, 2.0, 1)
    level = float(np.median(surface.positions[:, 2]))
    near = np.arange(0, len(surface.positions), 3)
    surface.positions[near, 2] = np.float32(level) + np.linspace(-1e-4, 1e-4, len(near), dtype=np.float32)
    result, _ = cut(surface, [above_line(2, level)])
    border = assert_welded(result)
    inner = (np.abs(result.positions[border][:, :, :2]) < (319, 159)).all(axis=(1, 2))
    ends = surface.positions[surface.edges].astype(np.float64)
    run, rise = np.linalg.norm(ends[:, 0, :2] - ends[:, 1, :2], axis=1), np.abs(ends[:, 0, 2] - ends[:, 1, 2])
    # A vertex on the line is no further from it than this in plan, along an edge.
    most = TOLERANCE * 320 * (rise / run).max()
    assert np.abs(result.positions[border[inner]][:, :, 2] - level).max() <= most < 5e-3
    new = ~np.isin(result.positions.view("V12"), surface.positions.view("V12")).ravel()
    assert new.sum() > 50 and (result.positions[new, 2] == np.float32(level)).all()


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(2))
def test_cuts_of_the_finest_triangles_leave_none_flat_or_flipped(seed):
    """Their edges have few steps of float32, so a cut point may be rounded onto a vertex."""
    field = rough(65, 129, seed)
    rng = np.random.default_rng(seed)
    x, y, z = eye = sample_position(field, rng.integers(100, 128), rng.integers(1, 64))
    view = View.look(eye + (0.0, 0.0, 0.05), eye + (1.0, 0.4, 0.0), resolution=(640, 480), clip=(1e-3, 1e6))
    surface = Terrain(field, 1).update(Criterion(error_px=0.0, edge_px=60.0, max_depth=40), [view]).surface
    ends = surface.positions[surface.edges].astype(np.float64)
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).min() < 400 * np.spacing(np.float32(x))
    for _ in range(8):
        assert_welded(cut(surface, [above_line(2, z + rng.normal(0.0, 0.01))])[0])
        assert_welded(
            cut(surface, [above_line(0, x + rng.normal(0.0, 0.03)), above_line(1, y + rng.normal(0.0, 0.03))])[0]
        )


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(threads):
    surface = surface_of(4, 0.2, 2)
    assert len(surface.level) > 20_000
    one, _ = cut(surface, [border_side(0, 95.0, 1e-3), above_line(2, 3.0)])
    more, _ = cut(surface, [border_side(0, 95.0, 1e-3), above_line(2, 3.0)], threads=threads)
    assert all(getattr(one, name).tobytes() == getattr(more, name).tobytes() for name in ARRAYS)


def test_elements_keep_their_numbers_and_a_swap_undoes_a_cut():
    surface = surface_of(5, 2.0, 0)
    before = surface.positions.copy()
    held = {}

    def in_place(name, array, count):
        held[name] = np.concatenate([array, np.zeros((count - len(array), *array.shape[1:]), array.dtype)])
        return held[name]

    result, swapped = cut(surface, [above_line(0, -250.0)], room=in_place)
    assert np.array_equal(before, surface.positions) and np.shares_memory(result.positions, held["positions"])
    same = (result.positions[: len(before)] == before[: len(result.positions)]).all(axis=1)
    assert same[~np.isin(np.arange(len(same)), swapped)].all() and same.mean() > 0.5
    swap(held["positions"], swapped)
    assert np.array_equal(held["positions"][: len(before)], before)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_triangles_that_are_dropped_leave_the_others_as_they_are(share):
    surface = surface_of(6, 5.0, 1)
    gone = np.random.default_rng(6).random(len(surface.level)) < share
    result, _ = drop_triangles(surface, gone)
    if share < 1:
        assert_welded(result)

    def triangles(of, chosen):
        rows = np.concatenate([of.positions[of.triangles].reshape(-1, 9), of.level[:, None]], axis=1)[chosen]
        return rows[np.lexsort(rows.T)]

    assert np.array_equal(triangles(result, slice(None)), triangles(surface, ~gone))


def test_edges_keep_what_they_carry_and_new_ones_have_none():
    surface = surface_of(7, 5.0, 0)
    carried = np.arange(1, len(surface.edges) + 1, dtype=np.int32)
    surface = surface.with_attributes({"number": Attribute(carried, EDGE)})
    result, _ = cut(surface, [border_side(0, 95.0, 1e-3)])
    number = result.attributes["number"].array
    old, new = surface.positions[surface.edges[number - 1]], result.positions[result.edges]
    kept = (number > 0) & (new[:, :, 0] < 95.0).all(axis=1)
    assert len(number) == len(result.edges) and kept.sum() > 100 and np.array_equal(old[kept], new[kept])
    assert np.isin(number[(new[:, :, 0] == 95.0).all(axis=1)], 0).all()
