# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios: a terrain, a view and a criterion as plain numbers, for property tests and the regression corpus.

A scenario is a dict that JSON holds: `field` {"kind", "shape", "seed", "relief", "base", "steps"} and, if it is not
bilinear, "interpolation", and, if the source has rounded its heights, "rounded_to", metres; `views` a list of {"kind",
"eye", "look", ...}, `criterion` the fields of Criterion that differ from its defaults, `placement` 16 numbers or None,
`scale` the vertical scale.
"""

import json
from contextlib import contextmanager

import numpy as np
from adaptive_terrain.cbt_terrain.accuracy.measure import triangle_errors
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import extent, least_triangles, rough
from invariants import arrays, assert_invariants

KINDS = ("rough", "noise", "spike", "cliff", "plane", "checkerboard", "constant", "twist")
VIEW_KINDS = (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)


def make_field(asked: dict) -> HeightField:
    """Return the height field of a scenario; `relief` metres around `base`."""
    height, width = asked["shape"]
    rng = np.random.default_rng(asked["seed"])
    y, x = np.indices((height, width))
    kind, relief = asked["kind"], asked["relief"]
    if kind == "rough":
        z = rough(height, width, asked["seed"], relief=1.0).samples[:height, :width]
    elif kind == "noise":
        z = rng.uniform(-1, 1, (height, width))
    elif kind == "spike":
        z = np.zeros((height, width))
        z[rng.integers(height), rng.integers(width)] = 1.0
    elif kind == "cliff":
        across, along = rng.uniform(-1, 1, 2)
        z = (across * (x - width / 2) + along * (y - height / 2) > 0).astype(float)
    elif kind == "plane":
        z = rng.uniform(-1, 1) * x / width + rng.uniform(-1, 1) * y / height
    elif kind == "checkerboard":
        z = (x + y) % 2 * 1.0
    elif kind == "constant":
        z = np.ones((height, width))
    else:
        z = (x / width - rng.random()) * (y / height - rng.random())
    heights = (relief * np.asarray(z, np.float64) + asked["base"]).astype(np.float32)
    stored, step = heights, asked.get("rounded_to")
    if step:
        stored = (np.round(heights / np.float64(step)) * step).astype(np.float32)
    off = float(np.abs(stored.astype(np.float64) - heights).max())
    field = from_array(stored, *asked["steps"], source_max=off)
    return interpolated(field, asked.get("interpolation", "bilinear"))


def make_view(asked: dict, field: HeightField) -> View:
    """Return the view of a scenario; its eye is in units of the terrain's extent, or on the sample `on`."""
    size = extent(field)
    middle = np.array([0.0, 0.0, (field.min_height + field.max_height) / 2])
    eye = middle + np.array(asked["eye"]) * size
    if asked.get("on") is not None:
        lattice = field.lattice
        i, j = (
            int(share * (count - 1)) for share, count in zip(asked["on"], (lattice.width, lattice.height), strict=True)
        )
        eye[:2] = (i - (lattice.width - 1) / 2) * lattice.step_x, (j - (lattice.height - 1) / 2) * lattice.step_y
        eye[2] = field.samples[j, i]
    return View.look(
        eye,
        eye + np.array(asked["look"]) * size[:2].max(),
        fov_deg=asked["fov_deg"],
        resolution=tuple(asked["resolution"]),
        kind=asked["kind"],
        ortho_width=asked["ortho"] * float(size[0]),
        clip=tuple(asked["clip"]),
        roll_deg=asked["roll_deg"],
    )


def make(scenario: dict) -> tuple[HeightField, list[View], Criterion, dict]:
    """Field, views, criterion, and how the terrain is placed, as `Terrain.update` takes them."""
    field = make_field(scenario["field"])
    placement = scenario.get("placement")
    placed = {
        "placement": np.eye(4) if placement is None else np.array(placement, np.float64).reshape(4, 4),
        "vertical_scale": scenario.get("scale", 1.0),
    }
    return field, [make_view(view, field) for view in scenario["views"]], Criterion(**scenario["criterion"]), placed


def assert_sound(scenario: dict) -> None:
    """Assert the invariants, the same bytes from two threads, the budget, and that no measured error passes its bound.

    A failure says which line the regression corpus needs.
    """
    with to_remember(scenario):
        field, views, criterion, placed = make(scenario)
        update = Terrain(field, 1).update(criterion, views, **placed)
        assert_invariants(update.surface, field.lattice, criterion.meshlet)
        with eager_threads():
            two = Terrain(field, 2).update(criterion, views, **placed)
        assert arrays(two.surface) == arrays(update.surface)
        assert (two.bound_px, two.bound_m, two.leaves) == (update.bound_px, update.bound_m, update.leaves)
        least = least_triangles(field, criterion.meshlet)
        assert update.triangles <= max(criterion.max_triangles or update.triangles, least)
        assert_bounds(field, views, update, placed)
        if "rounded_to" in scenario["field"]:
            unrounded = make_field({**scenario["field"], "rounded_to": None})
            assert_bounds(unrounded, [], update, placed)


def assert_bounds(field: HeightField, views: list[View], update, placed: dict) -> None:
    """Assert that the largest error in metres and, in each view, errors in pixels are within the bounds of those that
    were asked for."""
    scale = placed["vertical_scale"]
    # Triangle errors are float32: so is what they are compared with, for rounding keeps the order.
    if update.bound_m is not None:
        metres = triangle_errors(field, update.surface, [], vertical_scale=scale).max()
        assert metres <= np.float32(update.bound_m), f"{metres} m of {update.bound_m} m"
    for view in views if update.bound_px is not None else ():
        pixels = triangle_errors(field, update.surface, [view], **placed).max()
        assert pixels <= np.float32(update.bound_px), f"{pixels} px of {update.bound_px} px"


@contextmanager
def eager_threads():
    """Cut even the smallest job into slices."""
    before, launch.SLICE_ITEMS = launch.SLICE_ITEMS, 2
    try:
        yield
    finally:
        launch.SLICE_ITEMS = before


@contextmanager
def to_remember(scenario: dict):
    """Add to a failure inside the block how to keep its scenario."""
    try:
        yield
    except Exception as error:
        entry = json.dumps({"broke": "WHAT IT BROKE", **scenario})
        error.add_note(f"Add this entry to tests/regressions/corpus.json:\n{entry}")
        raise
