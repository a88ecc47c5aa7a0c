# SPDX-License-Identifier: GPL-3.0-or-later
"""Criteria are nested in rounded arithmetic: no diamond has a finer pixel or a larger error than its parent.

ADAPTIVE_TERRAIN_FUZZ is the number of random views.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.domain import box_of, make_domain
from adaptive_terrain.cbt_terrain.refine.request import pack
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.local_view import localise
from adaptive_terrain.cbt_terrain.view.spans import PlanUnits, spans_of
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import extent, rough
from finer_fields import finer_field
from twins import load

VIEWS = max(80, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")))
WAYS = 40  # down the diamonds, of each view


@pytest.fixture(scope="module")
def kernels():
    return load("refine.nested_paths", Path(__file__).with_name("nested_paths.py"))


@pytest.fixture(scope="module")
def grounds():
    y, x = np.mgrid[0:60, 0:45]
    cliffs = np.where(x + 0.3 * y > 30, 700.0, 0.0) + np.where(y > 40, 301.0, 0.0)
    fields = [rough(33, 65, 4, relief=300.0), from_array(cliffs.astype(np.float32), 2.0)]
    tiled = finer_field(33, 40, 3, ((0, 0), (1, 1)), 3, 60.0), finer_field(12, 12, 6, ((2, 2),), 5)
    fields += tiled
    return [*fields, *(interpolated(field, "bicubic") for field in fields[:3])]


def a_placement(rng: np.random.Generator) -> np.ndarray:
    """Return one turned, mirrored, sheared, scaled along each axis, and far away; or none of it."""
    placement = np.eye(4)
    if rng.random() < 0.8:
        placement[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag(10 ** rng.uniform(-1, 1, 3))
        placement[:3, :3] += rng.integers(2) * 0.2 * rng.normal(size=(3, 3))
        placement[:3, 3] = rng.normal(size=3) * 10 ** rng.uniform(0, 6)
    return placement


def a_view(rng: np.random.Generator, size: np.ndarray, placement: np.ndarray) -> View:
    """Return a view from anywhere, also from the surface and from far away, with a shifted lens and oblong pixels."""
    eye = rng.uniform(-1, 1, 3) * size * 10 ** rng.uniform(-3, 1)
    eye, target = (placement[:3, :3] @ p + placement[:3, 3] for p in (eye, rng.uniform(-0.5, 0.5, 3) * size))
    kind = str(rng.choice([PERSPECTIVE] * 6 + [ORTHOGRAPHIC, PANORAMIC]))
    fov = float(rng.choice([rng.uniform(1, 170), 50.0]))
    view = View.look(eye, target, kind=kind, fov_deg=fov, ortho_width=float(size[0]), roll_deg=float(rng.normal() * 90))
    if kind == PERSPECTIVE:
        projection = view.projection.copy()
        projection[:2, 2] = rng.integers(2) * rng.normal(size=2)
        projection[1, 1] *= float(rng.choice([1.0, 2.0]))
        view = replace(view, projection=projection)
    return view


def a_criterion(rng: np.random.Generator) -> Criterion:
    edge_px = float(rng.choice([0.0, 0.0, 0.0, 20.0]))
    return Criterion(
        error_px=float(10 ** rng.uniform(-1, 2)),
        edge_px=edge_px,
        shading_floor=float(rng.choice([0.0, 0.2, 0.5, 1.0])),
        guard_deg=float(rng.choice([0.0, 5.0])),
        off_screen_factor=float(rng.choice([1.0, 16.0])),
        morph=float(rng.choice([1.0, 1.5])),
    )


def test_no_diamond_exceeds_its_parent_in_any_view(kernels, grounds):
    rng = np.random.default_rng(32)
    found = wp.zeros(5, dtype=wp.int32, device="cpu")
    uneven = 0
    for _ in range(VIEWS):
        field, placement, criterion = grounds[rng.integers(len(grounds))], a_placement(rng), a_criterion(rng)
        domain = make_domain(field, int(rng.integers(2)), float(rng.choice([1.0, -2.0])), 0.0)
        view = a_view(rng, extent(field), placement)
        plan = PlanUnits((domain.unit_x, domain.unit_y), domain.unit_bits, 30, (0.0, 0.0, 0.0))
        spans = spans_of(criterion, [view], placement, plan)
        local = localise(view, placement, box_of(field, 1.0, 0.0), criterion, spans.scales[0])
        ways = wp.array(rng.integers(0, 2**63, WAYS, np.uint64), dtype=wp.uint64, device="cpu")
        inputs = [domain, pack(criterion, [local], spans, 0.0), ways, found]
        wp.launch(kernels.nested_paths, 1, inputs=inputs, device="cpu")
        uneven += local.max_gain2 > 1.0
    diamonds, *wrong = found.numpy().tolist()
    assert wrong == [0, 0, 0, 0] and diamonds > 20 * WAYS * VIEWS and uneven > 0.4 * VIEWS
