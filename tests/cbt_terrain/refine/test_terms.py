# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bound is made of: geometry, float32, the source's rounding."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.refine.terms import position_rounding, rounding
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough


def largest(found):
    return found.height + found.max_lean


def test_rounding_is_half_the_spacing_at_the_highest_height():
    field = from_array(np.full((17, 33), 5000.0, np.float32), 30.0)
    assert largest(rounding(field, 17, 1.0, 0.0)) == pytest.approx(2.0**-12, rel=1e-5)
    assert largest(rounding(field, 17, 1.0, 12000.0)) == pytest.approx(2.0**-10, rel=1e-5)
    assert largest(rounding(field, 17, -2.0, 0.0)) == pytest.approx(2.0**-11, rel=1e-5)


def test_rounding_of_plane_coordinates_counts_by_the_slope():
    y, x = np.indices((33, 33))
    for step, off in ((1.0, 0.0), (1e6 / 3, 0.25)):  # 5.3e6 m from the middle: half a step of float32 is 0.25 m
        field = from_array((0.5 * step * x).astype(np.float32), step)
        assert (field.steepest_x, field.steepest_y) == (pytest.approx(0.5, rel=1e-5), 0.0)
        high = 0.5 * float(np.spacing(np.float32(field.max_height)))
        # a facet may lean across x and y by as much as the surface does along x
        assert largest(rounding(field, 11, 1.0, 0.0)) == pytest.approx(high + 2 * 0.5 * off, rel=1e-4)
        assert largest(rounding(field, 11, 3.0, 0.0)) == pytest.approx(
            0.5 * float(np.spacing(np.float32(3 * field.max_height))) + 2 * 1.5 * off, rel=1e-4
        )


@pytest.mark.parametrize(
    ("along_x", "interpolation"),
    [
        *zip((True, False), INTERPOLATIONS, strict=True),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in zip((False, True), INTERPOLATIONS, strict=True)),
    ],
)
def test_rounding_counts_facets_steeper_than_the_surface(along_x, interpolation):
    """Ridges and valleys in turn: a triangle from one to the other rises along them, and the surface does not."""
    violated = 0
    for rows, columns, depth in ((33, 3, 2), (17, 5, 4), (5, 17, 4), (33, 9, 6)):
        z = np.arange(rows)[:, None] % 2 * np.full((1, columns), 1e4, np.float32)
        for step in ((0.1, 0.1), (1.0, 27.3), (0.1, 1000.1), (1000.1, 1.0)):
            field = interpolated(from_array(np.ascontiguousarray(z.T if along_x else z), *step), interpolation)
            found = Terrain(field, 1).update(Criterion(error_px=0, error_m=1e-3, max_depth=depth))
            violated += measure(field, found.surface, random_points=100, threads=1).vertical_max_m > found.bound_m
    assert violated == 0


def test_a_bicubic_surface_rounds_by_its_own_slopes_and_heights():
    """Between the two samples of a step it climbs a quarter more steeply than bilinear, and it overshoots."""
    z = np.tile(np.float32([0, 0, 3000, 3000, 0, 0]), (6, 1))[:5, :5]
    field = from_array(np.ascontiguousarray(z), 10.0)
    cubic = interpolated(field, "bicubic")
    assert cubic.steepest_x >= 1.25 * field.steepest_x > 0 and cubic.steepest_y == field.steepest_y == 0.0
    assert 3000 * 1.125 <= cubic.max_height <= 3000 * 1.2 and -3000 * 0.2 <= cubic.min_height <= -3000 * 0.07
    assert largest(rounding(cubic, 5, 1.0, 0.0)) == pytest.approx(2.0**-13 * 1.0, rel=1e-3)


def test_rounding_counts_lattice_lines_that_only_deep_leaves_use():
    field = from_array(np.arange(25.0, dtype=np.float32).reshape(5, 5), 1.0)
    assert rounding(field, 5, 1.0, 0.0) == rounding(field, 40, 1.0, 0.0)
    assert rounding(field, 40, 1.0, 0.0).max_lean == 0 < rounding(field, 60, 1.0, 0.0).max_lean


def test_terms_add_up_to_the_bound():
    rng = np.random.default_rng(2)
    raster = np.cumsum(np.cumsum(rng.standard_normal((48, 61)), axis=0), axis=1).astype(np.float32)
    view = View.look((0, -500, 300), (0, 0, 0))
    for field, rounded in ((rough(33, 33), False), (from_array(raster, 10.0, source_max=0.1), True)):
        for threads in (1, 2):
            update = Terrain(field, threads).update(Criterion(error_px=0.5, error_m=2.0), [view])
            for terms, bound in ((update.terms_px, update.bound_px), (update.terms_m, update.bound_m)):
                parts = terms.geometric, terms.precision, terms.source
                assert sum(parts) == pytest.approx(bound, rel=1e-12) and (terms.source > 0) == rounded
                assert terms.geometric > 100 * terms.precision > 0
    assert Terrain(field, 1).update(Criterion(error_px=0, error_m=2.0)).terms_px is None


def test_rounding_is_reported_as_precision_and_not_refined():
    z = (8000 + 0.01 * np.random.default_rng(0).standard_normal((9, 9))).astype(np.float32)
    terrain = Terrain(from_array(z, 10.0), 1)
    lost = terrain.update(Criterion(error_px=0, error_m=10.0)).terms_m.precision
    update = terrain.update(Criterion(error_px=0, error_m=0.8 * lost))
    assert update.limited == "precision" and lost < update.bound_m <= 1.25 * lost * (1 + 1e-9)
    # four thirds of the rounding can be met; a smaller request costs at most a few times more, however small it is
    none = terrain.update(Criterion(error_px=0, error_m=1e-9 * lost))
    assert (none.triangles, none.bound_m) == (update.triangles, update.bound_m)
    other = terrain.update(Criterion(error_px=0, error_m=1.5 * lost))
    assert other.limited == "" and other.bound_m <= 1.5 * lost
    assert other.triangles < update.triangles < 8 * other.triangles


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_no_facet_leans_by_more_than_the_heights_around_it_say(interpolation):
    """Compare each triangle's slope times the error of coordinates with the bound from the cells around it."""
    rng = np.random.default_rng(4)
    for rows, columns, depth in ((9, 9, 3), (17, 5, 6), (9, 17, 8), (5, 5, 13)):
        z = rng.standard_normal((rows, columns)).cumsum(axis=rng.integers(2)) * 100.0
        field = interpolated(from_array(z.astype(np.float32), 0.1, 27.3), interpolation)
        lost, off = (f(field, depth, -2.0, 0.0) for f in (rounding, position_rounding))
        surface = Terrain(field, 1).update(Criterion(error_px=0, error_m=1e-9, max_depth=depth), (), None, -2.0).surface
        p = surface.positions.astype(np.float64)[surface.triangles]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        leans = (np.abs(normal[:, :2]) @ off[:2]) / normal[:, 2]
        places = p[:, :, :2] / [0.1, 27.3] + [(columns - 1) / 2, (rows - 1) / 2]
        low = np.maximum(np.floor(places.min(axis=1) - 0.01).astype(int) - 1, 0)
        high = np.ceil(places.max(axis=1) + 0.01).astype(int) + 2
        for lean, (i, j), (k, n) in zip(leans, low, high, strict=True):
            assert lean <= min(lost.lean * 2.0 * np.ptp(z[j:n, i:k]), lost.max_lean)
        assert 0 < leans.max() and lost.lean > 0


def test_a_cliff_far_away_does_not_count_at_the_camera():
    """What plane coordinates lose is that of the ground in view, not of the raster's steepest."""
    z = 100.0 + np.random.default_rng(0).standard_normal((65, 65)).astype(np.float32)
    cliff = z.copy()
    cliff[:, 60:] += 30_000.0
    view = View.look((-8000.0, 0.0, 105.0), (-9000.0, 0.0, 100.0), clip=(0.1, 5000.0))
    steep, level = (from_array(heights, 300.1) for heights in (cliff, z))
    assert rounding(steep, 20, 1.0, 0.0).max_lean > 1e3 * rounding(level, 20, 1.0, 0.0).max_lean
    found = [Terrain(field, 1).update(Criterion(), [view]).terms_px for field in (steep, level)]
    # Heights themselves are rounded more: by half a step at 30 km, not at 100 m.
    rounded = [rounding(field, 20, 1.0, 0.0).height for field in (steep, level)]
    assert found[0].precision < 1.1 * rounded[0] / rounded[1] * found[1].precision
