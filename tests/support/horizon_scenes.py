# SPDX-License-Identifier: GPL-3.0-or-later
"""Fields, views and criteria in which nearer ground hides something."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, PERSPECTIVE, View
from fields import extent, reference_heights, rough

SHAPES = (129, 129), (129, 257), (200, 90), (100, 300), (65, 65)


def a_field(rng):
    """Rough, or boxes on a plain; padded or not; floats or 16-bit numbers; bilinear or bicubic."""
    height, width = SHAPES[rng.integers(len(SHAPES))]
    relief = float(rng.choice([100.0, 500.0, 1000.0]))
    if rng.random() < 0.7:
        field = rough(height, width, int(rng.integers(1 << 30)), relief=relief)
    else:
        blocks = (rng.random((height // 8 + 1, width // 8 + 1)) > 0.8).repeat(8, 0).repeat(8, 1)[:height, :width]
        field = from_array(blocks.astype(np.float32) * relief, 10.0, 8.0)
    return interpolated(field, INTERPOLATIONS[rng.integers(2)])


def a_place(rng) -> np.ndarray:
    """Half of them turned, stretched and sheared."""
    placement = np.eye(4)
    if rng.random() < 0.5:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        shear = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
        placement[:3, :3] = turn @ np.diag(10.0 ** rng.uniform(-0.4, 0.4, 3)) @ shear
        placement[:3, 3] = rng.normal(size=3) * 1000
    return placement


def a_view(rng, field, placement: np.ndarray, scale: float, offset: float) -> View:
    """Return a view from low above the ground, below it or beyond the border."""
    size = extent(field) * [1, 1, abs(scale)]
    eye = rng.uniform(-0.5, 0.5, 3) * size
    if rng.random() < 0.2:
        eye *= [2.5, 2.5, 1.0]
    ground = reference_heights(field, eye[None, :2])[0] * scale + offset
    eye[2] = ground + size[2] * 10.0 ** rng.uniform(-2.5, -0.3) * (1 if rng.random() < 0.9 else -0.3)
    target = rng.uniform(-0.2, 0.2, 3) * size
    target[2] = eye[2] - rng.uniform(-0.1, 0.2) * size[2]
    ends = [placement[:3, :3] @ p + placement[:3, 3] for p in (eye, target)]
    kind = PANORAMIC if rng.random() < 0.2 else PERSPECTIVE
    clip = (float(rng.choice([0.1, 0.1, 5.0, 60.0])), 1e6)
    fov = 360.0 if kind == PANORAMIC else float(rng.uniform(20, 100))
    return View.look(*ends, fov_deg=fov, resolution=(640, 360), kind=kind, clip=clip)


def a_criterion(rng) -> Criterion:
    return Criterion(
        error_px=float(rng.choice([0.7, 1.5, 3.0])),
        edge_px=float(rng.choice([0.0] * 7 + [60.0])),
        error_m=float(rng.choice([0.0, 0.0, 2.0])),
        off_screen_factor=float(rng.choice([1.0, 1.0, 16.0, 1e6])),
        guard_deg=float(rng.choice([0.0, 5.0])),
        max_depth=(11, 15, 16, 16)[rng.integers(4)],
        meshlet=int(rng.choice([0, 0, 0, 1])),
    )


def scenes(seed: int, count: int, views: int = 1):
    """Random fields, criteria, views, places and heights."""
    rng = np.random.default_rng(seed)
    fields = [a_field(rng) for _ in range((count + 4) // 5)]
    for k in range(count):
        field = fields[k // 5]
        scale, offset = float(rng.choice([1.0, 1.0, -1.5])), float(rng.choice([0.0, 250.0]))
        placement = a_place(rng)
        seen = [a_view(rng, field, placement, scale, offset) for _ in range(views)]
        yield field, a_criterion(rng), seen, placement, (scale, offset)


def updated(terrain: Terrain, criterion: Criterion, views, placement, heights):
    return terrain.update(criterion, views, placement, vertical_scale=heights[0], vertical_offset=heights[1])


def behind_a_ridge(side: int = 257) -> tuple:
    """Rough ground with a wall across it, and a view from before the wall."""
    rng = np.random.default_rng(1)
    z = np.cumsum(rng.standard_normal((side, side)), axis=0).astype(np.float32)
    z[side // 3 : side // 3 + 6] += 200.0
    return z, View.look((0, -8.0 * side / 2, 60.0), (0, 0, 60.0), resolution=(960, 540))
