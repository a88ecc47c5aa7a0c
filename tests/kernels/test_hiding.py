# SPDX-License-Identifier: GPL-3.0-or-later
"""What is hidden is nested: a box inside a hidden box is hidden, to the last bit; and by degrees it goes on evenly."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.refine.horizon import ring_of
from adaptive_terrain.cbt_terrain.run.buffers import shared
from adaptive_terrain.kernels.refine.hiding import BINS, RING_BITS, ROW, Rings
from twins import load

RINGS = 60
RAMP = 0.05
FLOOR, NONE = -0.3, 1e30


@pytest.fixture(scope="module")
def kernels():
    return load("refine.hidden_boxes", Path(__file__).with_name("hidden_boxes.py"))


@pytest.fixture(scope="module")
def kernel(kernels):
    return kernels.hidden_of_boxes


def a_map(rng) -> tuple[Rings, np.ndarray]:
    """Return rings from one metre on, and random slopes that rise with the ring, mostly smooth along it."""
    rings = Rings()
    rings.first, rings.count, rings.at = ring_of(1.0), RINGS, 0
    steps = rng.exponential(0.02, (RINGS, int(ROW))) * (rng.random((RINGS, int(ROW))) < 0.2)
    slopes = np.cumsum(np.vstack([rng.normal(-0.2, 0.05, int(ROW)), steps[1:]]), axis=0)
    floors = np.where(rng.random(int(ROW)) < 0.02, NONE, FLOOR)
    return rings, np.concatenate([floors, slopes.reshape(-1)]).astype(np.float32)


def nested_boxes(rng, count: int) -> np.ndarray:
    """float64 [count, 4 generations, 2, 3]: each in the one before, some of their faces are the same."""
    size = 10.0 ** rng.uniform(0.3, 2, (count, 1))
    centre = rng.normal(size=(count, 3)) * size * [1, 1, 0.1]
    half = size * 10.0 ** rng.uniform(-2.5, -0.5, (count, 1)) * rng.random((count, 3)) * [1, 1, 0.2]
    boxes = [np.stack([centre - half, centre + half], axis=1)]
    for _ in range(3):
        low, high = boxes[-1][:, 0], boxes[-1][:, 1]
        a, b = np.sort(np.where(rng.random((2, count, 3)) < 0.3, [[[0.0]], [[1.0]]], rng.random((2, count, 3))), axis=0)
        boxes.append(
            np.stack([np.clip(low + a * (high - low), low, high), np.clip(low + b * (high - low), low, high)], 1)
        )
    return np.stack(boxes, axis=1)


def are_hidden(kernel, rings: Rings, slopes: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """bool [...]."""
    corners = np.ascontiguousarray(boxes.reshape(-1, 3))
    found = np.empty(len(corners) // 2, np.int32)
    arrays = shared(slopes, wp.float32), shared(corners, wp.vec3d), shared(found, wp.int32)
    wp.launch(kernel, 1, inputs=[rings, *arrays], device="cpu")
    return found.reshape(boxes.shape[:-2]) > 0


def covers(kernels, rings: Rings, slopes: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """float64 [...]: how far boxes are covered."""
    corners = np.ascontiguousarray(boxes.reshape(-1, 3))
    found = np.empty(len(corners) // 2)
    arrays = shared(slopes, wp.float32), shared(corners, wp.vec3d), shared(found, wp.float64)
    wp.launch(kernels.covers_of_boxes, 1, inputs=[rings, RAMP, *arrays], device="cpu")
    return found.reshape(boxes.shape[:-2])


def test_what_is_hidden_is_nested(kernel):
    rng = np.random.default_rng(0)
    hidden_below = 0
    for _ in range(5):
        rings, slopes = a_map(rng)
        hidden = are_hidden(kernel, rings, slopes, nested_boxes(rng, 5000))
        for child in range(1, 4):
            assert not (hidden[:, :child] & ~hidden[:, child, None]).any()
        hidden_below += (~hidden[:, 0] & hidden[:, 3]).sum()
    assert hidden_below > 300


def test_a_hidden_box_is_below_every_ray_drawn_to_it(kernel):
    """By angles and circles nothing is shared: of random points of a box each is below its own bin's entry."""
    rng = np.random.default_rng(1)
    rings, slopes = a_map(rng)
    boxes = nested_boxes(rng, 5000)[:, 0]
    hidden = np.flatnonzero(are_hidden(kernel, rings, slopes, boxes))
    assert len(hidden) > 100
    radii = (np.arange(rings.first, rings.first + RINGS).astype(np.int64) << int(RING_BITS)).view(np.float64)
    table = slopes.reshape(RINGS + 1, 4, int(BINS))
    for low, high in boxes[hidden]:
        x, y, z = rng.uniform(low, high, (200, 3)).T
        quarter = np.round(np.degrees(np.arctan2(y, x)) / 90).astype(int) % 4
        far = np.maximum(np.abs(x), np.abs(y))
        t = np.where(quarter % 2 == 0, y, x) / far
        bins = np.minimum(((t + 1) * int(BINS) / 2).astype(int), int(BINS) - 1)
        bins = np.where((quarter == 1) | (quarter == 2), int(BINS) - 1 - bins, bins)  # once around the eye
        nearest = np.max([low[0], -high[0], low[1], -high[1]])
        ring = np.searchsorted(radii, nearest, side="right") - 1
        assert ring >= 0 and (z / far < table[ring + 1, quarter, bins]).all()
        assert (z / far >= table[0, quarter, bins]).all()


def test_what_is_covered_is_hidden_and_nested(kernels):
    """To the last bit: a box inside another is covered no less, and none that is not hidden is."""
    rng = np.random.default_rng(2)
    partly = wholly = 0
    for _ in range(5):
        rings, slopes = a_map(rng)
        boxes = nested_boxes(rng, 5000)
        found = covers(kernels, rings, slopes, boxes)
        assert (np.diff(found, axis=1) >= 0).all() and 0 <= found.min() and found.max() <= 1
        assert not (found[~are_hidden(kernels.hidden_of_boxes, rings, slopes, boxes)] > 0).any()
        partly, wholly = partly + ((found > 0) & (found < 1)).sum(), wholly + (found == 1).sum()
    assert partly > 1000 and wholly > 100, (partly, wholly)


def test_what_covers_goes_on_evenly_with_the_eye(kernels):
    """Of a small step of the eye no cover changes by more than crossing a ring's gap (a 64th of the distance at least),
    a bin (a 128th) and the ramp's slope allow, also across the diagonals; hidden at once it does."""
    rng = np.random.default_rng(3)
    rings, slopes = a_map(rng)
    boxes, step = nested_boxes(rng, 40_000)[:, 1:].reshape(-1, 2, 3), 1e-4  # of the distance
    boxes[::3, :, 1] += (boxes[::3, 0, 0] - boxes[::3, 1, 1])[:, None]  # just at the north-eastern diagonal
    near = np.maximum(boxes[:, 0, :2], -boxes[:, 1, :2]).max(axis=1)
    boxes, near = boxes[near > 0], near[near > 0]
    ring = (near[1::3].view(np.int64) >> int(RING_BITS) << int(RING_BITS)).view(np.float64)
    boxes[1::3] *= (ring / near[1::3])[:, None, None]  # just at a ring
    near[1::3] = ring
    moved = boxes + (step * near * rng.uniform(-1, 1, (3, len(boxes)))).T[:, None]
    at_once = np.abs(
        np.diff(are_hidden(kernels.hidden_of_boxes, rings, slopes, np.stack([boxes, moved])).astype(int), axis=0)
    )
    found = covers(kernels, rings, slopes, np.stack([boxes, moved]))
    steep = 1 + np.abs(boxes[..., 2]).max(axis=1) / near
    assert (np.abs(found[1] - found[0]) < 2 * step * (64 + 128 + 2 * steep / RAMP)).all()
    assert at_once.sum() > 0 and ((found > 0) & (found < 1)).sum() > 500
