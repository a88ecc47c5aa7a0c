# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise below the raster's cells: its bound, its meshes against numpy in float64, and terrains without it."""

import math
from itertools import product

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import detail as details
from adaptive_terrain.cbt_terrain.field import detail_bounds as bounds
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.depths import depth_limit, usual_depth
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS, with_detail
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from detail_scenes import WEIGHTS, assert_measured, check, ground_view, places_in
from detail_surface import bilinear, detail_heights, value_noise
from fields import bezier, extent, project, reference_heights, rough
from invariants import arrays, assert_invariants

DETAILS = {
    "soft": Detail(0.1),
    "short": Detail(0.3, 0.7, 0.5, 3),
    "rough": Detail(0.05, 8.0, 0.8, 4),
    "long": Detail(20.0, 300.0, 0.4, 5),
    "one octave": Detail(1.0, 5.0, 0.0, 6),
}


def field_of(kind="padded", detail=DETAILS["soft"], interpolation="bilinear"):
    shape = {"square": (33, 33), "padded": (27, 40), "strip": (9, 65), "flat": (17, 17)}[kind]
    rng = np.random.default_rng(len(kind))
    z = np.cumsum(np.cumsum(rng.standard_normal(shape), 0), 1) * (0.0 if kind == "flat" else 0.1)
    return with_detail(interpolated(from_array(z.astype(np.float32), 2.0, 3.0), interpolation), detail)


def test_the_noise_bends_and_climbs_no_more_than_its_constants():
    """Branch and bound with intervals: no cell, no direction has a larger second derivative or slope; and the
    checkerboard has nearly as much. Linear in the lattice values, they are largest where these are 1 or -1."""

    def fade(u):
        return u**3 * (10 + u * (6 * u - 15)), 30 * u * u * (u - 1) ** 2, 60 * u * (2 * u - 1) * (u - 1)

    turns = np.sort([0.0, 1.0, 0.5, 0.5 - math.sqrt(3) / 6, 0.5 + math.sqrt(3) / 6])

    def ranges(low, high):
        """Least and most of the fade, its slope and its bend over [low, high]: at the ends or where they turn."""
        at = np.stack([low, high, *(np.clip(t, low, high) for t in turns)])
        return [(values.min(0) - 1e-12, values.max(0) + 1e-12) for values in fade(at)]

    def times(a, b):
        each = np.stack([a[i] * b[j] for i in range(2) for j in range(2)])
        return each.min(0), each.max(0)

    def plus(a, b):
        return a[0] + b[0], a[1] + b[1]

    def by(k, a):
        return (k * a[0], k * a[1]) if k >= 0 else (k * a[1], k * a[0])

    def most(value):
        return np.maximum(np.abs(value[0]), np.abs(value[1]))

    largest = 0.0
    for a, b, c, d in product((-1, 1), repeat=4):
        boxes = np.array([[0.0, 1.0, 0.0, 1.0]])
        for _ in range(16):
            (f, f1, f2), (g, g1, g2) = ranges(boxes[:, 0], boxes[:, 1]), ranges(boxes[:, 2], boxes[:, 3])
            across = plus((b - a, b - a), by(a + d - b - c, g))
            up = plus((c - a, c - a), by(a + d - b - c, f))
            xx, yy, xy = times(f2, across), times(g2, up), by(a + d - b - c, times(f1, g1))
            apart = most(plus(xx, by(-1, yy)))
            bound = 0.5 * most(plus(xx, yy)) + np.sqrt(0.25 * apart**2 + most(xy) ** 2)
            steep = np.hypot(most(times(f1, across)), most(times(g1, up)))
            open_ = (bound > details.CURVATURE) | (steep > details.SLOPE)
            if not open_.any():
                break
            low_x, high_x, low_y, high_y = boxes[open_].T
            mid_x, mid_y = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y)
            halves = product([(low_x, mid_x), (mid_x, high_x)], [(low_y, mid_y), (mid_y, high_y)])
            boxes = np.concatenate([np.stack([*x, *y], 1) for x, y in halves])
        else:
            raise AssertionError(f"{len(boxes)} boxes of {a, b, c, d} may bend or climb more")
        _, slope, _ = fade(np.array(0.5))
        largest = max(largest, abs(a + d - b - c) * slope**2)
    assert largest == 225 / 16 <= details.CURVATURE < 1.02 * largest
    assert math.sqrt(largest) <= details.SLOPE < 1.02 * math.sqrt(largest)


def test_the_noise_is_seen_to_climb_and_bend_as_much():
    rng, h = np.random.default_rng(1), 1e-3
    x, y = rng.uniform(-100, 100, (2, 50_000))
    angle = rng.uniform(0, 2 * np.pi, len(x))
    here, ahead, behind = (value_noise(x + k * np.cos(angle), y + k * np.sin(angle), 1) for k in (0.0, h, -h))
    assert 0.8 * details.SLOPE < np.abs(ahead - here).max() / h <= details.SLOPE
    assert 0.6 * details.CURVATURE < np.abs(ahead - 2 * here + behind).max() / h**2 <= details.CURVATURE


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "steps"), [*zip(DETAILS, [(2.0, 2.0), (2.0, 3.0)] * 3, strict=False)])
def test_bounds_of_details_hold_and_are_tight(name, steps):
    """Triangles of both kinds, of all sizes, where a search finds the detail furthest from them: their distance from
    it against the table's."""
    detail, levels, rng = DETAILS[name], 5, np.random.default_rng(59)
    waves = detail.waves(1e-4)
    table, ratios = bounds.tables(detail.parts(1e-4), steps, levels, 0), []
    at = [int(np.flatnonzero((WEIGHTS == corner).all(1))[0]) for corner in np.eye(3)]
    for depth in range(1, 30, 3):
        half = np.array(steps) * 2.0 ** (levels - (depth - 1) // 2) / 2
        corners = {1: [(-1, -1), (1, -1), (-1, 1)], 0: [(-1, -1), (1, -1), (0, 0)]}[depth % 2]
        largest = 0.0
        for shape in (np.array(corners) * half, np.array(corners)[:, ::-1] * half):
            middle = rng.uniform(-500, 500, (150, 1, 2)) * detail.wavelength
            for k in range(10):
                places = np.einsum("wc,cx->wx", WEIGHTS, shape)[None] + middle
                heights = detail_heights(detail, len(waves), places.reshape(-1, 2)).reshape(len(middle), -1)
                off = np.abs(heights - heights[:, at] @ WEIGHTS.T).max(1)
                assert off.max() <= table[depth, 0]
                assert np.ptp(heights[:, at], axis=1).max() <= table[depth, 1]
                largest = max(largest, off.max())
                best = middle[np.argsort(off)[-10:]]
                nearby = rng.normal(size=(14, 10, 1, 2)) * detail.wavelength * 0.5**k
                middle = np.concatenate([best, (best[None] + nearby).reshape(-1, 1, 2)])
        ratios.append(table[depth, 0] / largest)
    assert (np.diff(table, axis=0) <= 0).all(), "it falls with the depth, so sums are nested"
    print(name, steps, f"bound / largest seen: {min(ratios):.2f} .. {max(ratios):.2f}, mean {np.mean(ratios):.2f}")
    assert np.mean(ratios) < 3.0


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "kind"), [*enumerate(["square", "padded", "strip", "flat"])])
def test_no_error_is_above_its_bound(number, kind):
    rng, parts = np.random.default_rng(len(kind)), []
    for detail in DETAILS.values():
        number += 1
        field = field_of(kind, detail, INTERPOLATIONS[number % 2])
        scale, offset = float(rng.choice([1.0, -2.0, 0.3])), float(rng.choice([0.0, 700.0]))
        turn = rng.uniform(0, 2 * np.pi)
        placement = np.eye(4)
        placement[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        placement[:3, :3] *= rng.choice([1.0, 0.01])
        placement[:3, 3] = rng.uniform(-50, 50, 3)
        size = extent(field)
        views = []
        for seen in (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)[: rng.integers(1, 4)]:
            eye = np.array([*(rng.uniform(-0.4, 0.4, 2) * size[:2]), 0.0])
            above = 1.7 + 2 * detail.amplitude * abs(scale)
            eye[2] = reference_heights(field, eye[None, :2])[0] * scale + offset + above
            world = [placement[:3, :3] @ p + placement[:3, 3] for p in (eye, -eye * [1, 1, 0] + [0, 0, offset])]
            fov, wide = (360.0 if seen == PANORAMIC else 50.0), 20.0 * placement[2, 2]
            view = View.look(*world, kind=seen, fov_deg=fov, ortho_width=wide, resolution=(320, 180), clip=(5e-3, 1e6))
            views.append(view)
        meshlet = int(rng.integers(3))
        for asked in (
            {"error_px": 1.0, "meshlet": meshlet},
            {"error_px": 0.0, "error_m": 0.3 * bounds.highest(field.parts) * abs(scale)},
            {"error_px": 2.0, "max_depth": 12},
            {"error_px": 0.0, "error_m": 0.01, "max_depth": 9},
        ):
            found = Terrain(field, 1).update(Criterion(**asked, max_triangles=2000), views, placement, scale, offset)
            assert_invariants(found.surface, field.lattice, asked.get("meshlet", 0))
            parts.append(check(found, field, views, placement, scale, offset))
    print(kind, f"largest seen / bound: mean {np.mean(parts):.2f}, most {max(parts):.2f}")
    assert np.mean(parts) > 0.15


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_numbers_of_a_source_give_the_mesh_of_their_heights(interpolation):
    steps = Steps(-300, 0.25, 10.0)
    numbers = np.cumsum(np.random.default_rng(3).integers(-6, 7, (27, 40)), 1).astype(np.uint16) + np.uint16(500)
    floats = from_array(steps.heights(numbers), 2.0, 3.0)
    coded = floats.with_raster(samples=numbers, steps=steps)
    one, two = (with_detail(interpolated(field, interpolation), DETAILS["rough"]) for field in (floats, coded))
    view = ground_view(one)
    found = [Terrain(field, 1).update(Criterion(error_px=1.0, max_triangles=6000), [view]) for field in (one, two)]
    assert two.samples.dtype == np.uint16 and arrays(found[0].surface) == arrays(found[1].surface)
    assert found[0].bound_px == found[1].bound_px
    check(found[1], two, [view])


def test_ground_may_be_cut_out():
    field = field_of("padded", None)
    valid = np.ones(field.samples.shape, np.uint8)
    valid[8:12, 20:30] = 0
    holed = with_detail(field.with_raster(valid=valid), DETAILS["rough"])
    view = ground_view(holed)
    found = Terrain(holed, 1).update(Criterion(error_px=1.0, max_triangles=6000), [view])
    check(found, holed, [view])
    assert found.bound_px is not None and found.triangles > 1000


def test_the_edges_that_are_asked_for_hold_on_a_detail():
    field = field_of("flat", DETAILS["short"])
    view = ground_view(field)
    found = Terrain(field, 1).update(Criterion(error_px=0.0, edge_px=60.0), [view])
    assert found.bound_edge_px == 60.0
    a, seen = project(view, found.surface.positions.astype(np.float64))
    edges = found.surface.edges[seen[found.surface.edges].all(1)]
    longest = np.linalg.norm(a[edges[:, 0]] - a[edges[:, 1]], axis=1).max()
    assert 20.0 < longest <= 60.0


def test_vertices_are_on_the_surface_and_normals_are_its_own():
    for interpolation in ("bilinear", "bicubic"):
        field = field_of("square", DETAILS["soft"], interpolation)
        surface = Terrain(field, 1).update(Criterion(error_px=0.5), [ground_view(field)]).surface
        p = surface.positions.astype(np.float64)
        assert np.abs(p[:, 2] - reference_heights(field, p[:, :2])).max() < 2e-6
        p, normals = (a[(np.abs(p[:, :2]) < extent(field)[:2] / 2 - 0.1).all(1)] for a in (p, surface.normals))
        slopes, h = -normals[:, :2].astype(np.float64) / normals[:, 2:], 1e-4
        ahead, behind = (
            np.stack([detail_heights(field.detail, len(field.parts), p[:, :2] + s * h * axis) for axis in np.eye(2)], 1)
            for s in (1, -1)
        )
        assert np.abs(slopes - (ahead - behind) / (2 * h) - raster_slopes(field, p[:, :2])).max() < 1e-3


def raster_slopes(field, plane):
    """Return slopes of the surface without detail as its mesh has them."""
    if field.interpolation == "bicubic":
        return bezier(with_detail(field, None), plane)[1]
    h, lattice = field.heights().astype(np.float64), field.lattice
    gy, gx = np.gradient(h, lattice.step_y, lattice.step_x)
    return np.stack([bilinear(lattice, g, plane) for g in (gx, gy)], 1)


def test_no_amplitude_is_no_detail():
    field = field_of("padded", None)
    assert with_detail(field, Detail(0.0)) is field and with_detail(field, None) is field
    detailed = with_detail(field, DETAILS["soft"])
    assert with_detail(field, Detail(0.1)) is detailed, "the same detail is the same field again"
    assert with_detail(detailed, None) is field
    assert detailed.raster.digest == field.raster.digest and detailed.key != field.key
    assert interpolated(detailed, "bicubic").detail == detailed.detail
    assert interpolated(interpolated(detailed, "bicubic"), "bilinear") is detailed
    assert usual_depth(field) == field.lattice.cell_depth + 8 < usual_depth(detailed) <= depth_limit(detailed)


def test_bytes_depend_on_neither_threads_nor_history(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 500)
    field = field_of("padded", DETAILS["rough"])
    a, b = ground_view(field), ground_view(field, above=2.1, at=(0.11, -0.19))
    criterion = Criterion(error_px=1.0, max_triangles=6000)
    wanted = arrays(Terrain(field, 1).update(criterion, [a]).surface)
    for threads in (1, 2, 16):
        terrain = Terrain(field, threads)
        for view in (a, b, a, b, a):
            surface = terrain.update(criterion, [view]).surface
        assert arrays(surface) == wanted


def test_a_saved_tree_gives_the_same_mesh_again():
    field = field_of("padded", DETAILS["soft"])
    terrain = Terrain(field, 1)
    wanted = terrain.update(Criterion(error_px=2.0, meshlet=1), [ground_view(field)])
    bytes_, how = terrain.saved()
    found = Terrain(field, 1).restore(bytes_, **how)
    assert arrays(found.surface) == arrays(wanted.surface)
    check(found, field, [])


@pytest.mark.parametrize("interpolation", ["bilinear", pytest.param("bicubic", marks=pytest.mark.thorough)])
def test_the_measurement_sees_what_numpy_sees(interpolation):
    field = field_of("padded", DETAILS["soft"], interpolation)
    assert_measured(field, Criterion(error_px=4.0, error_m=0.15))


def test_a_detail_that_cannot_be_is_refused():
    for wrong in ({"amplitude": math.nan}, {"amplitude": -1.0}, {"wavelength": 0.0}, {"roughness": 1.5}, {"seed": -1}):
        with pytest.raises(TerrainError, match=f"The detail's {next(iter(wrong))} is .*; expected"):
            Detail(**({"amplitude": 0.1} | wrong))
    with pytest.raises(TerrainError, match="set the amplitude of the terrain's detail to 0"):
        fit(field_of(), 1.0)


def test_a_vast_field_is_as_exact_far_from_its_middle():
    """40 km away a hand's breadth of detail has its places in float64; what float32 takes is in the bound."""
    field = with_detail(from_array(np.zeros((1025, 1025), np.float32), 80.0, 80.0), Detail(0.2, 2.0))
    eye = np.array([40_000.0, 40_000.0, 1.7])
    view = View.look(eye, eye + [6, 9, -1.0], fov_deg=50.0, resolution=(480, 270), clip=(0.1, 1e6))
    found = Terrain(field, 1).update(Criterion(error_px=1.0, max_triangles=6000), [view])
    near = places_in(found.surface)
    near = near[np.linalg.norm(near[:, :2] - eye[:2], axis=1) < 50.0]
    off = np.abs(near[:, 2] - reference_heights(field, near[:, :2]))
    assert len(near) > 1000 and off.max() < 0.5
    check(found, field, [view])


def test_rough_ground_keeps_its_detail_small():
    """Where the raster's own error asks for as much, a detail takes few more triangles."""
    field = rough(65, 65, relief=300.0)
    view = ground_view(field, above=40.0)
    plain, detailed = (
        Terrain(f, 1).update(Criterion(error_px=1.0), [view]).triangles
        for f in (field, with_detail(field, Detail(0.02)))
    )
    assert plain <= detailed < 1.6 * plain
