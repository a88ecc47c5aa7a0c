# SPDX-License-Identifier: GPL-3.0-or-later
"""Horizon culling: hidden ground is coarser, what any view sees is not, and nothing depends on history or threads."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from fields import extent, reference_heights, rough
from first_hits import as_keys, first_hits
from invariants import arrays

SHAPES = (129, 129), (129, 257), (200, 90), (100, 300), (65, 65)


def a_field(rng):
    """Rough, or boxes on a plain; padded or not; floats or 16-bit numbers; bilinear or bicubic."""
    height, width = SHAPES[rng.integers(len(SHAPES))]
    relief = float(rng.choice([20.0, 100.0, 400.0]))
    if rng.random() < 0.7:
        field = rough(height, width, int(rng.integers(1 << 30)), relief=relief)
    else:
        blocks = (rng.random((height // 8 + 1, width // 8 + 1)) > 0.8).repeat(8, 0).repeat(8, 1)[:height, :width]
        field = from_array(blocks.astype(np.float32) * relief, 10.0, 8.0)
    return interpolated(field, INTERPOLATIONS[rng.integers(2)])


def a_view(rng, field, scale: float, offset: float) -> tuple[View, np.ndarray]:
    """A view from low over the ground or from anywhere about it, below it too; and the terrain's place: half of them
    turned, stretched and sheared."""
    size = extent(field) * [1, 1, abs(scale)]
    eye = rng.uniform(-0.5, 0.5, 3) * size
    if rng.random() < 0.3:
        eye *= [2.5, 2.5, 1.0]
    ground = reference_heights(field, eye[None, :2])[0] * scale + offset
    eye[2] = ground + size[2] * (10.0 ** rng.uniform(-2.5, 0.5)) * (1 if rng.random() < 0.9 else -0.3)
    target = rng.uniform(-0.5, 0.5, 3) * size
    target[2] = eye[2] - rng.uniform(-0.2, 0.5) * size[2]
    placement = np.eye(4)
    if rng.random() < 0.5:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        placement[:3, :3] = turn @ np.diag(10.0 ** rng.uniform(-0.4, 0.4, 3)) @ (np.eye(3) + 0.2 * rng.normal(size=(3, 3)))
        placement[:3, 3] = rng.normal(size=3) * 1000
    ends = [placement[:3, :3] @ p + placement[:3, 3] for p in (eye, target)]
    kind = PANORAMIC if rng.random() < 0.2 else PERSPECTIVE
    clip = (float(rng.choice([0.1, 5.0, 60.0])), 1e6)
    fov = 360.0 if kind == PANORAMIC else float(rng.uniform(20, 100))
    return View.look(*ends, fov_deg=fov, resolution=(960, 540), kind=kind, clip=clip), placement


def a_criterion(rng) -> Criterion:
    return Criterion(
        error_px=float(rng.choice([0.7, 2.0, 6.0])),
        edge_px=float(rng.choice([0.0, 0.0, 40.0])),
        error_m=float(rng.choice([0.0, 0.0, 1.0])),
        off_screen_factor=float(rng.choice([1.0, 16.0, 1e6])),
        guard_deg=float(rng.choice([0.0, 5.0])),
        max_depth=(9, 13, None, None)[rng.integers(4)],
        meshlet=int(rng.choice([0, 0, 0, 1])),
    )


def test_nothing_that_a_view_sees_is_hidden():
    """Case 71. 200 random views: whatever is in front in the mesh with hidden ground 50 times coarser is a triangle of
    the mesh without, corner by corner; and there is less of the rest."""
    rng, fewer, all_ = np.random.default_rng(71), 0, 0
    for _ in range(200):
        field, criterion = a_field(rng), a_criterion(rng)
        scale, offset = float(rng.choice([1.0, 1.0, -1.5])), float(rng.choice([0.0, 250.0]))
        view, placement = a_view(rng, field, scale, offset)
        heights = {"vertical_scale": scale, "vertical_offset": offset}
        whole = Terrain(field, 1).update(criterion, [view], placement, **heights)
        culled = Terrain(field, 1).update(replace(criterion, hidden_factor=50.0), [view], placement, **heights)
        seen = first_hits(culled.surface, view, placement)
        known = as_keys(whole.surface, np.arange(whole.triangles))
        bad = as_keys(culled.surface, seen) - known; print(_, len(bad), len(seen), culled.triangles, whole.triangles, view.kind, flush=True)
        assert culled.triangles <= whole.triangles and culled.bound_px <= whole.bound_px
        fewer, all_ = fewer + culled.triangles, all_ + whole.triangles
    assert fewer < 0.9 * all_, (fewer, all_)
