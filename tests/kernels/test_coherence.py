# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame coherence: leaves that a walk reuses from the last frame are those that it would find without a cache."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.history.drift import move
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.local_view import localise
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from adaptive_terrain.kernels.refine.coherence import FADED, Motion, Subtree
from adaptive_terrain.kernels.refine.local_view import CLEAR, LocalView
from adaptive_terrain.kernels.refine.pixels import CriterionArrays
from fields import extent, rough
from invariants import arrays, reused_leaves
from twins import load

FRAMES = 8
MANY_LEAVES = 100_000  # a flight with more has two frames


def a_field(rng):
    height, width = ((129, 129), (129, 257), (200, 90), (65, 65))[rng.integers(4)]
    if rng.random() < 0.7:
        field = rough(height, width, int(rng.integers(1 << 30)), relief=float(rng.choice([2.0, 30.0, 200.0])))
    else:
        field = from_array((rng.random((height, width)) > 0.97).astype(np.float32) * 20.0, 1.0, 2.0)
    return interpolated(field, INTERPOLATIONS[rng.integers(2)])


def flight(field, rng) -> list[View]:
    """Return views that move, turn, roll and zoom a little each frame, and sometimes jump.

    Half of them have float32 matrices, as Blender's cameras have.
    """
    size = extent(field)
    eye = rng.uniform(-0.5, 0.5, 3) * size + [0, 0, (0.02 + rng.random() ** 3) * size[:2].max()]
    look = np.append(rng.uniform(-1, 1, 2), rng.uniform(-0.6, 0.1))
    kind = (PERSPECTIVE, PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)[rng.integers(4)]
    step = rng.normal(size=3) * size[:2].max() * 10.0 ** rng.uniform(-5, -2)
    turn = rng.normal(size=3) * 10.0 ** rng.uniform(-5, -2) * rng.integers(2)
    zoom = 1.0 + 0.01 * rng.integers(2) * rng.random()
    roll = 0.5 * rng.integers(2)
    blenders = rng.random() < 0.5
    fov, width = 50.0, 0.5 * size[0]
    views = []
    for frame in range(FRAMES):
        if rng.random() < 0.05:
            eye = eye + 0.2 * size * rng.normal(size=3)
        eye, look = eye + step, look + turn
        fov, width = fov * zoom, width * zoom
        view = View.look(eye, eye + look, fov_deg=fov, resolution=(960, 540), kind=kind, ortho_width=width,
                         clip=(0.1, 1e5), roll_deg=roll * frame)  # fmt: skip
        if blenders:
            view = replace(view, world_to_camera=view.world_to_camera.astype(np.float32).astype(np.float64))
        views.append(view)
    return views


def a_criterion(rng) -> Criterion:
    return Criterion(
        error_px=float(rng.choice([1.0, 2.0, 6.0])),
        edge_px=float(rng.choice([0.0, 0.0, 12.0])),
        error_m=float(rng.choice([0.0, 0.0, 0.2])),
        off_screen_factor=float(rng.choice([1.0, 16.0])),
        guard_deg=float(rng.choice([0.0, 5.0])),
        max_depth=(13, 17, 17, None)[rng.integers(4)],
        max_triangles=rng.choice([None, None, None, 3000]),
        meshlet=int(rng.choice([0, 0, 1])),
        hidden_factor=float(rng.choice([1.0, 1.0, 8.0])),
        morph=float(rng.choice([1.0, SMOOTH])),
    )


def result(terrain: Terrain, criterion: Criterion, view: View, scale: float, offset: float):
    update = terrain.update(criterion, [view], vertical_scale=scale, vertical_offset=offset)
    bounds = (update.bound_px, update.bound_m, update.bound_edge_px, update.bound_area_px)
    parts = (update.terms_px, update.terms_m, update.relaxed, update.limited)
    return update.leaves, bounds, parts, terrain.tree.cells().tobytes(), arrays(update.surface)


@pytest.mark.thorough
def test_each_frame_of_a_flight_is_what_a_new_terrain_gives(eager_threads):
    """30 random flights: mesh, tree, bounds and what they are made of, to the bit, from one thread and from two."""
    leaves = from_last = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        field, criterion = a_field(rng), a_criterion(rng)
        scale, offset = float(rng.choice([1.0, -2.0, 0.5])), float(rng.choice([0.0, 100.0]))
        flown = Terrain(field, int(rng.integers(1, 3)))
        for frame, view in enumerate(flight(field, rng)):
            found = result(flown, criterion, view, scale, offset)
            assert found == result(Terrain(field, 1), criterion, view, scale, offset), seed
            if criterion.hidden_factor == 1:  # else each frame has another map
                leaves += found[0]
                from_last += reused_leaves(flown)
            if found[0] > MANY_LEAVES and frame == 1:
                break
    assert from_last > 0.2 * leaves, (from_last, leaves)


def test_what_was_kept_does_not_outlive_what_was_asked():
    """Another criterion, height scale, depth or lens between two frames: nothing of the old mesh stays."""
    field = rough(129, 129, 3, relief=20.0)
    flown, rng = Terrain(field, 1), np.random.default_rng(5)
    changes = [
        {"criterion": Criterion(error_px=0.7)},
        {"criterion": Criterion(error_px=0.7, max_depth=11)},
        {"scale": 1.5},
        {"offset": 30.0},
        {"criterion": Criterion(error_px=1.0, edge_px=9.0)},
        {"fov_deg": 30.0},
        {"criterion": Criterion(error_px=0.7, error_m=0.1)},
    ]
    eye, asked = np.array([0.0, -100.0, 40.0]), {"criterion": Criterion(error_px=1.0), "scale": 1.0, "offset": 0.0}
    for change in changes:
        asked |= change
        eye = eye + rng.normal(size=3) * 0.01
        view = View.look(eye, (0, 0, 0), fov_deg=asked.get("fov_deg", 50.0), resolution=(640, 360))
        args = asked["criterion"], view, asked["scale"], asked["offset"]
        assert result(flown, *args) == result(Terrain(field, 1), *args), change


def test_a_kept_subtree_bounds_what_its_band_leaves_in_doubt():
    """Edges beside an error: of leaves that depths alone decide, of one depth or another, no error is read."""
    field = rough(193, 65, 723175170, relief=20.0)
    criterion = Criterion(error_px=3.0, edge_px=10.0, max_depth=16)
    world_to_camera = [
        [-0.262655742907219, -0.9648896106383656, 0.0, 418.7928],
        [0.8570916667597162, -0.23331171357873948, 0.4593032974821801, -168.8673],
        [-0.44317697987249816, 0.12063864881991741, 0.8882795060801505, -1254.5498],
        [0.0, 0.0, 0.0, 1.0],
    ]
    flown, fresh = Terrain(field, 1), Terrain(field, 1)
    for zoom in (1.0, 1.0011073):
        scale = np.diag([0.002067294784540973 * zoom, 0.003675190728072841 * zoom, -2e-7, 1.0])
        view = View(world_to_camera, scale, (960, 540), ORTHOGRAPHIC, (0.1, 1e7))
        found = result(flown, criterion, view, 1.0, 0.0)
    assert reused_leaves(flown) > 0 and found == result(fresh, criterion, view, 1.0, 0.0)


def test_ground_entering_the_frame_is_refined_after_a_turn():
    """The camera only turns: footprints of ground behind it stay, and only the frustum makes it visible."""
    criterion = Criterion(error_px=1.0, guard_deg=0.0, max_depth=17, shading_floor=1.0)
    field = rough(129, 129, 8, relief=20.0)
    flown, from_last = Terrain(field, 1), 0
    for angle in np.radians(np.arange(0.0, 24.0, 2.0)):
        view = View.look((0, 0, 60), (np.cos(angle), np.sin(angle), 59.7), fov_deg=30, resolution=(960, 540))
        found = result(flown, criterion, view, 1.0, 0.0)
        assert found == result(Terrain(field, 1), criterion, view, 1.0, 0.0), angle
        from_last += reused_leaves(flown)
    assert from_last > 0


@pytest.fixture
def spans_kernel():
    return load("refine.spans_of_boxes", Path(__file__).with_name("spans_of_boxes.py"))


@pytest.mark.thorough
@pytest.mark.parametrize("frustum_class", [CLEAR, FADED])
@pytest.mark.parametrize("kind", [PERSPECTIVE, PANORAMIC, ORTHOGRAPHIC])
@pytest.mark.parametrize("measures_edges", [0, 1])
def test_footprints_in_a_box_change_within_the_bound(kind, frustum_class, measures_edges, spans_kernel):
    """Check the finest footprint on 2,000 boxes inside each of 300 after the camera has moved, turned and zoomed, in
    the frame and across its fringe."""
    criterion = Criterion(morph=SMOOTH)
    rng = np.random.default_rng(11)
    narrow = []
    for _ in range(300):
        size = 10.0 ** rng.uniform(0, 4)
        low = rng.uniform(-1, 1, 3) * size
        high = low + size * 10.0 ** rng.uniform(-3, 0) * rng.random(3)
        eye = rng.uniform(-2, 2, 3) * size
        look = (low + high) / 2 + rng.normal(size=3) * 0.3 * size - eye
        step = rng.normal(size=3) * size * 10.0 ** rng.uniform(-5, -1.5)
        turn = rng.normal(size=3) * np.linalg.norm(look) * 10.0 ** rng.uniform(-5, -2)
        placement = np.diag([*(10.0 ** rng.uniform(-0.5, 0.5, 3)), 1.0])
        local = []
        for frame in range(2):
            at = eye + frame * step
            target = at + look + frame * turn
            view = View.look(at, target, kind=kind, resolution=(960, 540), fov_deg=60, ortho_width=size)
            box = np.array([[-3.0 * size] * 3, [3.0 * size] * 3])
            local.append(localise(view, placement, box, criterion, 1.0 + 0.01 * frame))
        asked, motion, subtree = CriterionArrays(), Motion(), Subtree()
        asked.view, asked.view_count, asked.views = local[1], 1, wp.array(local[1:], dtype=LocalView, device="cpu")
        asked.measures_edges = measures_edges
        move(motion, *local, drift=0.0)
        subtree.low, subtree.high, subtree.frustum_class = low, high, frustum_class
        inner = np.sort(rng.uniform(low, high, (2_000, 2, 3)), axis=1)
        inner[0] = low, high
        boxes = wp.array(inner.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        spans = wp.zeros((2_000, 4), dtype=wp.float64, device="cpu")
        change = wp.zeros(3, dtype=wp.float64, device="cpu")
        inputs = [asked, local[0], motion, subtree, boxes, spans, change]
        wp.launch(spans_kernel.spans_of_boxes, 1, inputs=inputs, device="cpu")
        least, most, valid = change.numpy()
        heights_before, heights_now, edges_before, edges_now = spans.numpy().T
        before, now = heights_before, heights_now
        if measures_edges:
            before, now = np.append(before, edges_before), np.append(now, edges_now)
        if valid and before.max() < np.inf:
            rounded = 1e-8 * before.max()
            assert (now - before).min() >= least - rounded and (now - before).max() <= most + rounded
            narrow.append((most - least) / max(np.ptp(now - before), 1e-3 * before.min()))
    assert len(narrow) > 200 and (frustum_class == FADED or np.median(narrow) < 5.0)


def test_subtrees_in_the_fringe_are_reused():
    """Reuse 83 % of the leaves in a slow flight with geomorphing: 64 % are outside the fringe."""
    field, criterion = rough(257, 257, 4, relief=20.0), Criterion(error_px=0.04, morph=SMOOTH, guard_deg=0.0)
    flown = Terrain(field, 1)
    for frame in range(3):
        view = View.look((0.01 * frame, -60.0, 40.0), (0.0, 0.0, 0.0), fov_deg=50.0, resolution=(960, 540))
        found = result(flown, criterion, view, 1.0, 0.0)
    assert found == result(Terrain(field, 1), criterion, view, 1.0, 0.0)
    assert reused_leaves(flown) > 0.75 * found[0], (reused_leaves(flown), found[0])
