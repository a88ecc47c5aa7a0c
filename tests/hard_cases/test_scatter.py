# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 73: scatter points do not move during a flight, and appear and vanish at size 0."""

import numpy as np
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from scattered_frames import ScatteredFrames

FRAMES = 200
SCATTER = Scatter(spacing=6.0, full_until=120.0, variation=0.0, where=Layer("Low", (Rule("height", high=60, edge=80),)))
# Rotated about z, tilted, and scaled differently along each axis.
PLACEMENT = np.array([[0.96, -0.45, 0.1, 10.0], [0.55, 0.78, 0.0, -20.0], [0.05, 0.02, 1.4, 3.0], [0, 0, 0, 1.0]])


def view(frame: int) -> View:
    return View.look(
        (-380.0 + frame, -330.0 + 0.5 * frame, 150.0), (0.4 * frame, 40.0, 0.0), resolution=(640, 360), clip=(1, 5e3)
    )


def in_frame(frame: int, positions: np.ndarray) -> np.ndarray:
    """Return which positions the camera of a frame shows, except within 1 % of the frame's border."""
    at = np.column_stack([positions, np.ones(len(positions))]) @ (view(frame).world_to_camera @ PLACEMENT).T
    clip = at @ view(frame).projection.T
    return (clip[:, 3] > 1) & (np.abs(clip[:, :2]) < 0.99 * clip[:, 3:]).all(axis=1)


def test_case_73_no_scatter_point_moves_or_pops():
    """Over 200 frames no point moves by a bit, and sizes change, start and end by less than 0.15."""
    scatterer, last = ScatteredFrames(rough(90, 123, step=8.0), SCATTER), None
    every, appeared, largest = [], 0, 0.0
    for frame in range(FRAMES):
        points = scatterer.points([view(frame)], PLACEMENT)
        order = np.argsort(points.id)
        ids, positions, size = points.id[order], points.positions[order].copy(), points.size[order].copy()
        every.append((ids, positions))
        if last is not None:
            before, last_positions, sizes = last
            seen = in_frame(frame, positions) & in_frame(frame - 1, positions)
            new = seen & ~np.isin(ids, before)
            gone = ~np.isin(before, ids) & in_frame(frame, last_positions) & in_frame(frame - 1, last_positions)
            both, here, there = np.intersect1d(ids, before, return_indices=True)
            change = np.abs(size[here] - sizes[there])[in_frame(frame, positions[here])]
            largest = max(largest, change.max(), size[new].max(initial=0.0), sizes[gone].max(initial=0.0))
            appeared += int(new.sum())
            assert len(both) > 0.9 * len(ids)
        last = ids, positions, size
    ids, positions = map(np.concatenate, zip(*every, strict=True))
    _, first, number = np.unique(ids, return_index=True, return_inverse=True)
    assert (positions == positions[first][number]).all()
    assert appeared > 300 and largest < 0.15


def test_case_73_a_frame_alone_equals_the_frame_of_a_flight():
    """Single frames have the same bytes alone as after other frames, on one thread and on three."""
    field = rough(90, 123, step=8.0)
    flying = [ScatteredFrames(field, SCATTER, threads=threads) for threads in (1, 3)]
    for frame in (0, 199, 30, 57, 0):
        alone = scatter_points(field, SCATTER, [view(frame)], placement=PLACEMENT)
        for scatterer in flying:
            points = scatterer.points([view(frame)], PLACEMENT)
            for name in ("positions", "normals", "size", "id", "variant", "rotation"):
                assert getattr(points, name).tobytes() == getattr(alone, name).tobytes()
