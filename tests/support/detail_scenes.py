# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of a terrain with detail, and what of its bounds is seen in them."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, View
from fields import extent, project, reference_heights


def ground_view(field, above=2.0, at=(0.1, -0.2)):
    """Return a view along the ground from `above` it."""
    eye = np.array([*(extent(field)[:2] * at), 0.0])
    eye[2] = reference_heights(field, eye[None, :2])[0] + above
    return View.look(eye, eye + [6, 9, -2.0], fov_deg=60.0, resolution=(480, 270), clip=(0.1, 1e6))


# Weights of places in a triangle: corners, edges and inside.
WEIGHTS = np.array([(a, b, 4 - a - b) for a in range(5) for b in range(5 - a)]) / 4


def places_in(surface):
    """float64 [n, 3]: places on the delivered triangles."""
    corners = surface.positions.astype(np.float64)[surface.triangles]
    return np.einsum("wc,tcx->twx", WEIGHTS, corners).reshape(-1, 3)


def check(found, field, views, placement=None, scale=1.0, offset=0.0):
    """Check that each point of the mesh is within its bound of the surface; return the largest fraction of a bound."""
    below = places_in(found.surface)
    truth = below.copy()
    truth[:, 2] = reference_heights(field, below[:, :2]) * scale + offset
    parts = [0.0]
    if found.bound_m is not None:
        parts.append(np.abs(below - truth).max() / found.bound_m)
    if found.bound_px is not None:
        for view in views:
            (a, seen), (b, _) = project(view, truth, placement), project(view, below, placement)
            off = np.linalg.norm(a - b, axis=1)[seen]
            if view.kind == PANORAMIC:
                off = 2 * np.arcsin(np.minimum(off / 2, 1)) / view.radians_per_pixel
            parts.append(off.max(initial=0.0) / max(found.bound_px, 1e-30))
    assert max(parts) <= 1.0
    return max(parts)


def assert_measured(field, criterion: Criterion) -> None:
    """Assert that the measurement, by separate code and points, is within the bound and near that of many points."""
    view = replace(ground_view(field, above=5.0), resolution=(160, 90))
    found = Terrain(field, 1).update(criterion, [view])
    measured = measure(field, found.surface, view, random_points=20_000, threads=1)
    below = places_in(found.surface)
    off = np.abs(below[:, 2] - reference_heights(field, below[:, :2])).max()
    assert 0.7 * off < measured.vertical_max_m <= found.bound_m
    assert 0.0 < measured.screen_px.max <= found.bound_px
