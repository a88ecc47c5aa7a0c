# SPDX-License-Identifier: GPL-3.0-or-later
"""Horizon culling: hidden ground is coarser, what any view sees is not, and nothing depends on history or threads."""

import os
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.domain import box_of
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.refine import refinement
from adaptive_terrain.cbt_terrain.refine.horizon import RAMP, fill_horizons, place_rings
from adaptive_terrain.cbt_terrain.refine.request import pack, refinable_domain
from adaptive_terrain.cbt_terrain.refine.terms import rounding
from adaptive_terrain.cbt_terrain.run.buffers import Buffers
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.local_view import localise
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.spans import PlanUnits, spans_of
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from adaptive_terrain.kernels.refine.hiding import BINS, RING_BITS, ROW
from fields import extent, reference_heights, rough
from first_hits import as_keys, first_hits
from horizon_scenes import behind_a_ridge, scenes, updated
from invariants import arrays

VIEWS = max(16, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 50)
FEW = 8  # one of this many entries is checked


def check_what_is_seen(scene) -> tuple[int, int]:
    """Check that visible triangles are the same if hidden ground may be 50 times coarser, corner by corner.

    With several views they are at least as fine as for each view alone. Returns the triangle counts of both meshes.
    """
    field, criterion, *rest = scene
    alone = Terrain(field, 1)
    whole = updated(alone, criterion, *rest)
    culled = updated(Terrain(field, 1), replace(criterion, hidden_factor=50.0), *rest)
    known = as_keys(whole.surface, np.arange(whole.triangles))
    for view in rest[0]:
        seen = first_hits(culled.surface, view, rest[1])
        if len(rest[0]) == 1:
            assert as_keys(culled.surface, seen) <= known, criterion
            levels = whole.surface.level
        else:
            alone = Terrain(field, 1)
            levels = updated(alone, criterion, [view], *rest[1:]).surface.level
        middles = culled.surface.positions[culled.surface.triangles[seen]].astype(np.float64).mean(axis=1)
        assert (culled.surface.level[seen] >= levels[alone.triangles_at(middles[:, :2])]).all(), criterion
    assert culled.triangles <= whole.triangles and culled.bound_px <= whole.bound_px
    return culled.triangles, whole.triangles


def test_nothing_that_a_view_sees_is_hidden():
    """Case 71. 16 random views, 200 where ADAPTIVE_TERRAIN_FUZZ is 10,000: perspective and panoramic, also from inside
    and below the ground and from beyond the rim, of terrains that are turned, stretched and sheared."""
    counts = [check_what_is_seen(scene) for scene in scenes(71, VIEWS)]
    fewer = [a < 0.9 * b for a, b in counts]
    assert sum(fewer) > VIEWS // 20 and min(a / b for a, b in counts) < 0.7, (sum(fewer), counts)


def test_ground_seen_through_gaps_of_displacement_is_not_hidden():
    """Case 71, with detail below the raster's cells: it cuts gaps into walls, and raises ground above them."""
    view = View.look((0, -480, 30), (0, 600, 0), resolution=(640, 360), clip=(0.1, 1e6))
    fewer = 0
    for seed, wall in product((6, 9, 10), (36.0, 100.0)):
        z = np.zeros((129, 129), np.float32)
        z[40:44] = wall
        field = with_detail(from_array(z, 10.0), Detail(25.0, 100.0, 0.0, seed))
        scene = field, Criterion(error_px=2.0, max_depth=15), [view], np.eye(4), (1.0, 0.0)
        culled, whole = check_what_is_seen(scene)
        fewer += culled < 0.9 * whole
    assert fewer > 0


@pytest.mark.thorough
def test_what_one_of_several_views_sees_is_not_hidden():
    """Case 71, with two and three views."""
    counts = [check_what_is_seen(scene) for views in (2, 3) for scene in scenes(views, 15, views)]
    assert sum(a < b for a, b in counts) > 5


def test_nothing_that_a_view_sees_is_covered_where_points_rise():
    """Case 71 with occlusion fade: visible ground has the same heights as without occlusion."""
    z, view = behind_a_ridge()
    ridge = from_array(z, 8.0), Criterion(error_px=1.0), [view], np.eye(4), (1.0, 0.0)
    for scene in (ridge, *scenes(71, 5)):
        culled, whole = check_what_is_seen((scene[0], replace(scene[1], morph=SMOOTH), *scene[2:]))
        assert culled < 0.9 * whole or scene is not ridge


@pytest.mark.parametrize(("interpolation", "depth"), [("bilinear", 20), ("bilinear", 12), ("bicubic", 20)])
def test_horizons_go_on_evenly_with_the_eye_where_points_rise(interpolation, depth):
    """No entry is above the lowest ground on its arc, or on a nearer one; and heights there change by a quarter for a
    quarter of a step. By cells and, of so coarse leaves, by blocks of them."""
    z = np.cumsum(np.random.default_rng(5).normal(size=(200, 180)), axis=1).astype(np.float32)
    field, eye = interpolated(from_array(z * 4, 10.0), interpolation), np.array([210.0, -330.0, 180.0])
    steps = [0, 0, 0], [0.05, 0.03, 0], [0.2, 0.12, 0]
    (radii, slopes), *others = (horizon_map(field, eye + step, depth) for step in steps)
    assert (slopes[:, ::FEW] <= highest_arcs(field, eye, radii) + 1e-6).all()
    known = slopes > -10
    small, large = (np.abs((moved - slopes) * radii[:, None])[known].max() for _, moved in others)
    assert known.sum() > 10_000 and small < 0.3 * large, (small, large)


def horizon_map(field, eye: np.ndarray, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the ring radii and slopes, float32 [rings, entries], of an eye's map with occlusion fade.

    The terrain is upside down.
    """
    view = View.look(eye, eye + [1.0, 1.0, -0.3], resolution=(960, 540))
    criterion, placed, buffers = Criterion(error_px=1.0, hidden_factor=8.0), (-1.0, 300.0), Buffers()
    domain = refinable_domain(field, 0, *placed, rounding(field, depth, *placed))
    spans = spans_of(
        criterion, [view], np.eye(4), PlanUnits((domain.unit_x, domain.unit_y), domain.unit_bits, depth, 0.0)
    )
    local = localise(view, np.eye(4), box_of(field, *placed), criterion, spans.scales[0])
    place_rings(domain, [local], 8.0, RAMP)
    fill_horizons(field, domain, asked := pack(criterion, [local], spans, 0.0), depth, 1.0, buffers, 1)
    rings = np.arange(local.rings.first, local.rings.first + local.rings.count).astype(np.int64)
    slopes = buffers.numpy("horizons")[int(ROW) : (len(rings) + 1) * int(ROW)]
    assert asked.view_count == 1
    return (rings << int(RING_BITS)).view(np.float64), slopes.reshape(-1, int(ROW)).copy()


def highest_arcs(field, eye: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """float64 [rings, entries / FEW]: the highest slope of the lowest of five points on an arc, of all up to each."""
    t = -1 + (np.arange(int(BINS))[:, None] + np.linspace(0, 1, 5)) / (int(BINS) / 2)
    one = np.ones_like(t)
    around = np.concatenate([np.stack(side, -1) for side in ((one, t), (-t, one), (-one, -t), (t, -one))])[::FEW]
    plane = eye[:2] + radii[:, None, None, None] * around
    z = 300.0 - reference_heights(field, plane.reshape(-1, 2)).reshape(plane.shape[:-1])
    z[(np.abs(plane) >= extent(field)[:2] / 2).any(axis=-1)] = -np.inf
    return np.maximum.accumulate((z.min(axis=-1) - eye[2]) / radii[:, None], axis=0)


def test_orthographic_views_hide_nothing():
    """Case 71: they have no eye."""
    field = rough(129, 129, 3, relief=200.0)
    view = View.look((0, -900, 300), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=900)
    plain, hiding = (Terrain(field, 1).update(Criterion(hidden_factor=f), [view]) for f in (1.0, 50.0))
    assert arrays(plain.surface) == arrays(hiding.surface)


def test_ground_behind_a_ridge_is_coarser_by_the_factor():
    z, view = behind_a_ridge()
    field = from_array(z, 8.0)
    found = [Terrain(field, 1).update(Criterion(error_px=1.0, hidden_factor=f), [view]) for f in (1, 2, 8, 1e30)]
    assert [u.triangles for u in found] == sorted((u.triangles for u in found), reverse=True)
    assert found[2].triangles < 0.8 * found[0].triangles
    assert {u.bound_px for u in found} == {1.0}


def test_without_an_error_or_with_holes_nothing_is_hidden():
    """Edges alone do not bound the mesh in front from below; ground behind holes is visible through them."""
    z, view = behind_a_ridge(129)
    holes = z.copy()
    holes[60:64, 60:64] = np.nan
    for field, asked in (
        (from_array(z, 8.0), {"error_px": 0.0, "edge_px": 20.0}),
        (from_array(holes, 8.0, holes=True), {"error_px": 1.0}),
    ):
        plain, hiding = (Terrain(field, 1).update(Criterion(**asked, hidden_factor=f), [view]) for f in (1.0, 50.0))
        assert arrays(plain.surface) == arrays(hiding.surface)


@pytest.mark.thorough
def test_a_hidden_mesh_is_a_function_of_the_view_alone(eager_threads):
    """There and back, from one thread and from three: the same bytes; with a triangle limit, too."""
    for number, (field, criterion, views, placement, heights) in enumerate(scenes(5, 24, 2)):
        asked = replace(criterion, hidden_factor=8.0, max_triangles=(None, 2000, 300)[number % 3])
        first, second = [views[0]], [views[1]]
        flown, fresh = Terrain(field, 3), Terrain(field, 1)
        before = arrays(updated(flown, asked, first, placement, heights).surface)
        updated(flown, asked, second, placement, heights)
        assert arrays(updated(flown, asked, first, placement, heights).surface) == before
        assert arrays(updated(fresh, asked, first, placement, heights).surface) == before


def test_counts_of_a_triangle_limit_know_what_is_hidden(monkeypatch):
    """The search counts the leaves that the walk makes, however much the limit relaxes the criterion."""
    counted = []
    walk = refinement._walk

    def noted(field, request, history, threads, most, expected=0):
        slices = walk(field, request, history, threads, most, expected)
        if expected and slices is not None:  # step 0 need not be counted
            counted.append((expected, int(slices.counts[:, 0].sum()), request.criterion.limit))
        return slices

    monkeypatch.setattr(refinement, "_walk", noted)
    for limit in (100, 1000, 5000):
        for field, criterion, *rest in scenes(limit, 6):
            found = updated(
                Terrain(field, 1), replace(criterion, meshlet=0, hidden_factor=8.0, max_triangles=limit), *rest
            )
            assert found.triangles <= max(limit, 4 * field.lattice.squares)
    assert all(expected == leaves for expected, leaves, limit in counted if limit > 1)
    relaxed = [limit**0.5 for *_, limit in counted]
    assert 1 <= min(relaxed) < 4 and max(relaxed) > 64, relaxed


def test_a_factor_below_one_is_an_error():
    with pytest.raises(TerrainError, match="hidden_factor is 0.5; expected a number, 1 or more"):
        Criterion(hidden_factor=0.5)
