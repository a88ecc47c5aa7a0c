# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces cut to the inside of an outline, against areas and borders worked out by hand."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.cut import cut
from adaptive_terrain.cbt_terrain.mesh.outline import inside
from cut_surfaces import areas, assert_welded, surface_of
from invariants import arrays


def cut_to(surface, triangles):
    for side in inside(np.array(triangles, np.float64), surface):
        surface, _ = cut(surface, [side])
    return surface


def fan(*corners) -> list:
    """Return the triangles of a convex polygon."""
    return [(corners[0], b, c) for b, c in zip(corners[1:], corners[2:], strict=False)]


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    angle = np.deg2rad(degrees)
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


SQUARE = [(-70.0, -50.0), (80.0, -50.0), (80.0, 90.0), (-70.0, 90.0)]


@pytest.mark.parametrize("degrees", [0.0, 30.0, 200.0])
@pytest.mark.parametrize("error_m", [500.0, 5.0])
def test_a_convex_outline_is_cut_exactly_however_coarse_the_mesh(error_m, degrees):
    result = cut_to(surface_of(1, error_m, 0), turned(np.array(fan(*SQUARE)), degrees))
    border = assert_welded(result)
    assert abs(areas(result).sum() / (150 * 140) - 1) < 1e-3
    place = turned(result.positions[:, :2].astype(np.float64), -degrees)[border]
    low, high = SQUARE[0], SQUARE[2]
    # Of float32 and of a vertex that is nearer to the line than some steps of it.
    assert (np.minimum(np.abs(place - low), np.abs(place - high)).min(axis=2) < 4e-4).all()
    assert len(result.positions) - len(result.edges) + len(result.level) == 1


@pytest.mark.parametrize("inside", [1.0, 0.1, 0.01, 0.001])
def test_a_side_close_to_the_border_is_cut_at_its_position(inside):
    """A viewer at the border sees the distance, however small a fraction of a long edge it is."""
    west, south, east, north = -320.0 + inside, -160.0 + inside, 320.0 - inside, 160.0 - inside
    result = cut_to(surface_of(1, 500.0, 0), fan((west, south), (east, south), (east, north), (west, north)))
    assert_welded(result)
    found = result.positions[:, :2].astype(np.float64)
    assert np.abs(found.min(axis=0) - (west, south)).max() < 4e-4
    assert np.abs(found.max(axis=0) - (east, north)).max() < 4e-4


def test_a_closed_box_seen_from_above_is_its_rectangle():
    rectangle = fan(*SQUARE)
    upright = [(SQUARE[k - 1], SQUARE[k], SQUARE[k]) for k in range(4)]  # no area in plan
    surface = surface_of(2, 5.0, 1)
    box, plane = cut_to(surface, rectangle + [t[::-1] for t in rectangle] + upright), cut_to(surface, rectangle)
    assert arrays(box) == arrays(plane)


def test_any_other_outline_is_followed_to_less_than_a_triangle():
    low, high = fan((-200, -100), (200, -100), (200, 0), (-200, 0)), fan((-200, 0), (0, 0), (0, 100), (-200, 100))
    surface = surface_of(3, 0.05, 0)
    result = cut_to(surface, low + high)
    border = assert_welded(result)
    place = result.positions[:, :2].astype(np.float64)[border]
    corners = np.array([(-200, -100), (200, -100), (200, 0), (0, 0), (0, 100), (-200, 100)], np.float64)
    away = np.full(place.shape[:2], np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        t = np.clip(((place - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        away = np.minimum(away, np.linalg.norm(place - a - t[..., None] * (b - a), axis=-1))
    assert np.quantile(away, 0.9) < 0.02 and away.max() < 10.0, "samples are 10 m apart"
    assert abs(areas(result).sum() / 60_000 - 1) < 2e-3


def test_the_hole_of_a_ring_stays_empty():
    quarter = np.array([(40.0, 0.0), (120.0, 0.0), (120.0, 120.0), (0.0, 120.0), (0.0, 40.0), (40.0, 40.0)])
    ring = np.concatenate(
        [turned(np.array(fan(*quarter[[5, 0, 1, 2]]) + fan(*quarter[[5, 2, 3, 4]])), 90 * k) for k in range(4)]
    )
    result = cut_to(surface_of(4, 0.05, 0), ring)
    assert_welded(result)
    middle = result.positions[:, :2][result.triangles].mean(axis=1)
    assert np.abs(middle).max(axis=1).min() > 39.0 and np.abs(middle).max() < 121.0
    assert len(result.positions) - len(result.edges) + len(result.level) == 0
    assert abs(areas(result).sum() / (240**2 - 80**2) - 1) < 5e-3


@pytest.mark.parametrize(
    "triangles",
    [[((900, 900), (901, 900), (900, 901))], [((0, 0), (5, 5), (9, 9))], [((0, 0), (100, 0), (100, 1e-9))]],
    ids=["beside", "a line", "a line but for rounding"],
)
def test_an_outline_off_the_surface_or_flat_leaves_nothing(triangles):
    assert not len(cut_to(surface_of(5, 5.0, 0), triangles).level)
