# SPDX-License-Identifier: GPL-3.0-or-later
"""The bound of an update is never below the error measured on its float32 positions.

No comparison has a tolerance. A fifth of ADAPTIVE_TERRAIN_FUZZ is the number of random scenes.
"""

import math
import os
from dataclasses import dataclass

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS, HeightField
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from adaptive_terrain.cbt_terrain.terrain import Terrain, Update
from adaptive_terrain.cbt_terrain.view.criterion import LARGEST, Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import extent, reference_heights, rough, sample_position
from matplotlib.tri import Triangulation
from rasters import jacksboro

ROUNDS = max(36, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 5)
KINDS = (
    *("rough", "noise", "spike", "cliff", "checkerboard", "plane", "constant", "strip", "real", "vast"),
    *("padded", "padded noise"),
)


@dataclass
class Ground:
    """A height field with the points at which it is measured, and its true heights there."""

    field: HeightField
    plane: np.ndarray
    heights: np.ndarray


def ground(kind: str, interpolation: str, rng: np.random.Generator) -> Ground:
    n, m = (int(2 ** rng.integers(1, 6)) + 1 for _ in range(2))
    y, x = np.indices((n, m))
    step = tuple(rng.choice([1.0, 30.0, 0.1, 10 ** rng.uniform(-1, 2)], 2))
    noise = rng.standard_normal((n, m))
    if kind == "rough":
        field = rough(n, m, int(rng.integers(1000)), relief=10 ** rng.uniform(0, 3), step=step[0])
        return on_lattice(interpolated(field, interpolation), rng)
    if kind == "real":
        j, i = rng.integers(0, 344 - 65), rng.integers(0, 403 - 129)
        field = from_array(jacksboro()[j : j + 65, i : i + 129], *step)
        return on_lattice(interpolated(field, interpolation), rng)
    if kind.startswith("padded"):
        n, m = rng.integers(33, 60, 2)
        raster = rng.standard_normal((n, m)) * 10 ** rng.uniform(-1, 2)
        if kind == "padded":
            raster = np.cumsum(np.cumsum(raster, 0), 1) * 0.1
        raster[rng.integers(n), rng.integers(m)] += 10 ** rng.uniform(0, 3)
        return on_lattice(interpolated(from_array(raster.astype(np.float32), *step), interpolation), rng)
    z = {
        "noise": noise * 10 ** rng.uniform(-3, 3),
        "spike": np.where((x == rng.integers(m)) & (y == rng.integers(n)), 10 ** rng.uniform(0, 5), 0.0),
        "cliff": np.where(x * 0.3 + y > rng.uniform(0, n), 1e6 * step[0], 0.0) + noise,
        "checkerboard": (x + y) % 2 * 10.0 + rng.uniform(0, 1000),
        "plane": 0.1 * x - 3.7 * y + 1000.3,
        "constant": np.full((n, m), rng.uniform(-1e4, 1e4)),
        "strip": np.cumsum(rng.standard_normal((2, 1001)), axis=1),
        "vast": 8000 + 800 * np.cumsum(noise, axis=1) / math.sqrt(m),
    }[kind]
    if kind == "vast":
        step = (500e3 / (m - 1) * rng.uniform(0.5, 1), 500e3 / (n - 1))
    return on_lattice(interpolated(from_array(z.astype(np.float32), *step), interpolation), rng)


def on_lattice(field: HeightField, rng: np.random.Generator) -> Ground:
    """Up to 1200 samples, points on the lattice lines between them, on the border and anywhere."""
    lattice = field.lattice
    cells = np.array([lattice.width - 1, lattice.height - 1])
    samples = rng.permutation(np.indices((lattice.width, lattice.height)).reshape(2, -1).T)[:1200]
    dyadic = rng.integers(0, cells * 16 + 1, (400, 2)) / 16
    free = rng.random((600, 2)) * cells
    rim = rng.random((100, 2)) * cells
    rim[:50, 0], rim[50:, 1] = cells[0] * rng.integers(0, 2, 50), cells[1] * rng.integers(0, 2, 50)
    plane = (np.concatenate([samples, dyadic, free, rim]) - cells / 2) * [lattice.step_x, lattice.step_y]
    return Ground(field, plane, reference_heights(field, plane))


def mesh_heights(surface: Surface, plane: np.ndarray) -> np.ndarray:
    """Height of the mesh, float64 of its float32 positions, at points [n, 2]; NaN where rounding left none."""
    corners, p = surface.triangles, surface.positions.astype(np.float64)
    size = np.ptp(p[:, :2], axis=0)  # the finder has absolute tolerances
    tri = Triangulation(p[:, 0] / size[0], p[:, 1] / size[1], corners)
    find = tri.get_trifinder()
    owner = find(*(plane / size).T)
    # It misses points on the border and on some edges: look a little further inside for those.
    owner = np.where(owner < 0, find(*(plane / size * (1 - 1e-6)).T), owner)
    a = p[corners[:, 0], :2]
    u, v = p[corners[:, 1], :2] - a, p[corners[:, 2], :2] - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    def weights(owner, points):
        d = points - a[owner]
        s = (d[..., 0] * v[owner, 1] - d[..., 1] * v[owner, 0]) / area[owner]
        t = (u[owner, 0] * d[..., 1] - u[owner, 1] * d[..., 0]) / area[owner]
        return np.stack([1 - s - t, s, t], axis=-1)

    w = weights(owner, plane)
    heights = (w * p[corners[owner], 2]).sum(axis=1)
    return np.where((owner >= 0) & (w.min(axis=1) > -1e-9), heights, np.nan)


def pixels_off(view: View, truth: np.ndarray, below: np.ndarray, placement: np.ndarray) -> float:
    """Largest distance in pixels between a point [n, 3] of the true surface in the frame and the mesh's below it."""
    matrix = view.world_to_camera @ placement
    a, b = (p @ matrix[:3, :3].T + matrix[:3, 3] for p in (truth, below))
    if view.kind == PANORAMIC:
        seen = np.linalg.norm(a, axis=1) > view.clip[0]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        return float(angle[seen].max(initial=0.0)) / view.radians_per_pixel
    half = np.array(view.resolution) / 2
    scale = np.diag(view.projection)[:2] * half
    if view.kind == PERSPECTIVE:
        with np.errstate(all="ignore"):
            pa, pb = (scale * p[:, :2] / -p[:, 2:] for p in (a, b))
            off = np.where(b[:, 2] < 0, np.linalg.norm(pa - pb, axis=1), LARGEST)  # behind the eye
    else:
        pa, pb = scale * a[:, :2], scale * b[:, :2]
        off = np.linalg.norm(pa - pb, axis=1)
    seen = (np.abs(pa) <= half).all(axis=1) & (-a[:, 2] > view.clip[0]) & (-a[:, 2] < view.clip[1])
    return float(off[seen].max(initial=0.0))


def sizes_seen(view: View, surface: Surface, placement: np.ndarray) -> tuple[float, float]:
    """Return pixels of the longest edge and square pixels of the largest triangle wholly in the frame.

    In a panorama, lengths are angles, and areas half the product of two sides.
    """
    matrix = view.world_to_camera @ placement
    p = surface.positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    if view.kind == PANORAMIC:
        away = np.linalg.norm(p, axis=1)
        seen, pixels = away > view.clip[0], p / away[:, None] / view.radians_per_pixel
    else:
        ahead = -p[:, 2:] if view.kind == PERSPECTIVE else 1.0
        with np.errstate(all="ignore"):
            pixels = np.diag(view.projection)[:2] * np.array(view.resolution) / 2 * p[:, :2] / ahead
        seen = (np.abs(pixels) <= np.array(view.resolution) / 2).all(axis=1)
        seen &= (-p[:, 2] > view.clip[0]) & (-p[:, 2] < view.clip[1])
    corners = pixels[surface.triangles[seen[surface.triangles].all(axis=1)]]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    edges = np.linalg.norm(np.concatenate([u, v, u - v]), axis=1)
    areas = 0.5 * np.sqrt(np.maximum((u * u).sum(1) * (v * v).sum(1) - (u * v).sum(1) ** 2, 0.0))
    return float(edges.max(initial=0.0)), float(areas.max(initial=0.0))


def a_placement(rng: np.random.Generator) -> np.ndarray:
    placement = np.eye(4)
    how = rng.integers(5)
    if how == 1:
        placement[:3, 3] = rng.uniform(-1e6, 1e6, 3)
    elif how == 2:  # sheared, turned, stretched
        placement[:3, :3] += rng.uniform(-0.5, 0.5, (3, 3))
    elif how == 3:  # mirrored
        placement[0, 0] = -1.0
    return placement


def a_view(where: str, field: HeightField, placement: np.ndarray, rng: np.random.Generator) -> View:
    """Return a random view of the kind `where`, in terrain space before placement."""
    size = extent(field)
    size[2] = max(size[2], 0.05 * size[:2].max())
    eye = rng.uniform(-0.5, 0.5, 3) * size
    eye[2] += 0.5 * (field.min_height + field.max_height)
    target = rng.uniform(-0.5, 0.5, 3) * size + [0, 0, 0.5 * (field.min_height + field.max_height)]
    if where == "above":
        eye[2] = field.max_height + size[:2].max() * 10 ** rng.uniform(-2, 0.5)
    elif where == "below":
        eye[2] = field.min_height - size[:2].max() * 10 ** rng.uniform(-2, 0.5)
    elif where == "surface":
        eye = sample_position(field, rng.integers(field.lattice.width), rng.integers(field.lattice.height))
        eye[2] += rng.choice([0.0, 1.7])
    elif where == "far":
        eye += rng.standard_normal(3) * size.max() * 10 ** rng.uniform(0.5, 2)
    eye, target = (placement[:3, :3] @ p + placement[:3, 3] for p in (eye, target))
    kind = str(rng.choice([PERSPECTIVE, PERSPECTIVE, PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC]))
    fov = 360.0 if kind == PANORAMIC else float(rng.uniform(1, 160))
    wide = float(size.max() * 10 ** rng.uniform(-2, 0.5))
    resolution = tuple(int(p) for p in rng.integers(16, 4000, 2))
    clip = (float(rng.choice([0.1, 1e-3 * size.max()])), 1e9)
    return View.look(
        eye, target, kind=kind, fov_deg=fov, ortho_width=wide, resolution=resolution, clip=clip, roll_deg=fov
    )


def a_criterion(rng: np.random.Generator, relief: float, with_views: bool, largest_meshlet: int) -> Criterion:
    px = float(10 ** rng.uniform(-0.5, 2.5))
    metres = float(relief * 10 ** rng.uniform(-3, 0))
    asked = [
        {"error_px": px},
        {"error_px": 0.0, "error_m": metres},
        {"error_px": 0.0, "edge_px": 4 * px},
        {"error_px": 0.0, "area_px": 20 * px},
        {"error_px": px, "error_m": metres, "edge_px": 20 * px, "area_px": 200 * px},
    ][rng.choice(5, p=[0.5, 0.2, 0.1, 0.1, 0.1]) if with_views else 1]
    return Criterion(
        **asked,
        guard_deg=float(rng.choice([0.0, 5.0])),
        off_screen_factor=float(rng.choice([1.0, 16.0, 1e6])),
        max_triangles=int(rng.choice([2, 300, 3000])),
        max_depth=[None, None, 3, 9, 40][rng.integers(5)],
        meshlet=int(rng.integers(largest_meshlet + 1)) if rng.random() < 0.4 else 0,
    )


def check(found: Update, truth: Ground, views, placement, scale: float, offset: float) -> None:
    heights = truth.heights * scale + offset
    below = mesh_heights(found.surface, truth.plane)
    covered = np.isfinite(below)
    assert covered.mean() > 0.2
    if found.bound_m is not None:
        assert np.abs(below - heights)[covered].max() <= found.bound_m
    if found.bound_px is not None:
        a, b = (np.c_[truth.plane, z][covered] for z in (heights, below))
        assert max(pixels_off(view, a, b, placement) for view in views) <= found.bound_px
    if found.bound_edge_px is not None or found.bound_area_px is not None:
        edges, areas = zip(*(sizes_seen(view, found.surface, placement) for view in views), strict=True)
        assert found.bound_edge_px is None or max(edges) <= found.bound_edge_px
        assert found.bound_area_px is None or max(areas) <= found.bound_area_px


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_no_error_is_above_its_bound(kind, interpolation):
    rng = np.random.default_rng(sum(map(ord, kind)))
    for _ in range(math.ceil(ROUNDS / len(KINDS))):
        truth = ground(kind, interpolation, rng)
        placement = a_placement(rng)
        scale, offset = float(rng.choice([1.0, 1.0, -2.0, 0.01, 0.0])), float(rng.choice([0.0, 0.0, -1234.5]))
        places = rng.choice(["inside", "above", "below", "surface", "far"], rng.integers(0, 3))
        views = [a_view(str(where), truth.field, placement, rng) for where in places]
        relief = max(truth.field.max_height - truth.field.min_height, 1.0) * max(abs(scale), 1e-3)
        criterion = a_criterion(rng, relief, bool(views), 4 if truth.field.lattice.squares < 100 else 1)
        found = Terrain(truth.field, 1).update(criterion, views, placement, scale, offset)
        check(found, truth, views, placement, scale, offset)


WASTE = {
    "horizon": (lambda w, low, high: View.look((0, -0.55 * w, high), (0, 0, low)), 0.8),
    "oblique": (lambda w, low, high: View.look((0, -0.8 * w, low + 0.5 * w), (0, 0, low)), 0.8),
    "steep": (lambda w, low, high: View.look((0, -0.3 * w, low + 0.8 * w), (0, 0, low)), 0.7),
    "from the top": (lambda w, low, high: View.look((0, -0.001 * w, low + w), (0, 0, low)), 0.75),
    "tele": (lambda w, low, high: View.look((0, -3 * w, low + w), (0, 0, low), fov_deg=10), 0.9),
    "map": (lambda w, low, high: View.look((0, -w, low + 0.5 * w), (0, 0, low), kind=ORTHOGRAPHIC, ortho_width=w), 0.9),
    "panorama": (
        lambda w, low, high: View.look((0, 0, high + 0.05 * w), (1, 0, low), kind=PANORAMIC, fov_deg=360),
        0.88,
    ),
}
USUAL = "horizon", "tele", "map", "panorama"


@pytest.fixture(scope="module")
def crop() -> Ground:
    return on_lattice(from_array(jacksboro()[:129, :193], 30.0), np.random.default_rng(0))


@pytest.mark.parametrize(
    "name", [name if name in USUAL else pytest.param(name, marks=pytest.mark.thorough) for name in WASTE]
)
def test_the_screen_bound_is_not_wasteful(name, crop):
    """On a real elevation model the largest error in view is close to the request, and the bound equals it."""
    make, least = WASTE[name]
    field = crop.field
    view = make(192 * 30.0, field.min_height, field.max_height)
    found = Terrain(field, 1).update(Criterion(error_px=2.0), [view])
    below = mesh_heights(found.surface, crop.plane)
    a, b = (np.c_[crop.plane, z][np.isfinite(below)] for z in (crop.heights, below))
    assert least * 2.0 < pixels_off(view, a, b, np.eye(4)) <= found.bound_px <= 2.0


@pytest.mark.parametrize("asked", [40.0, 10.0, 4.0])
def test_the_vertical_bound_is_not_wasteful(asked, crop):
    found = Terrain(crop.field, 1).update(Criterion(error_px=0.0, error_m=asked))
    off = np.abs(mesh_heights(found.surface, crop.plane) - crop.heights)
    assert 0.9 * asked < np.nanmax(off) <= found.bound_m <= asked


@pytest.mark.parametrize("name", ["horizon", "oblique", "tele", "map", "panorama"])
def test_what_a_depth_limit_leaves_is_found_where_it_is(name, crop):
    """A mesh that is too coarse by far: its bounds are those of the worst triangle in view, and little more."""
    field = crop.field
    view = WASTE[name][0](192 * 30.0, field.min_height, field.max_height)
    for depth in (6, 9, 12):
        criterion = Criterion(error_px=0.01, edge_px=0.01, area_px=0.01, error_m=0.01, max_depth=depth, guard_deg=0.0)
        found = Terrain(field, 1).update(criterion, [view])
        assert found.limited == "max_depth" and len(set(found.surface.level)) == 1
        check(found, crop, [view], np.eye(4), 1.0, 0.0)
        below = mesh_heights(found.surface, crop.plane)
        worst = pixels_off(view, *(np.c_[crop.plane, z] for z in (crop.heights, below)), np.eye(4))
        # A point is judged by its triangle's nearest corner; at depth 6 the triangles in front are half the frame.
        assert found.bound_px < (20.0 if depth == 6 else 4.0) * worst
        assert found.bound_m < 1.5 * np.abs(below - crop.heights).max()
        if name == "map":
            edge, area = sizes_seen(view, found.surface, np.eye(4))
            assert found.bound_edge_px < 2.5 * edge and found.bound_area_px < 16.0 * area


@pytest.mark.parametrize(
    ("kind", "interpolation"),
    [
        (PERSPECTIVE, "bicubic"),
        (PANORAMIC, "bilinear"),
        *(pytest.param(kind, "bicubic", marks=pytest.mark.thorough) for kind in (ORTHOGRAPHIC, PANORAMIC)),
        *(pytest.param(kind, "bilinear", marks=pytest.mark.thorough) for kind in (PERSPECTIVE, ORTHOGRAPHIC)),
    ],
)
def test_bounds_are_finite_where_no_limit_can_be_kept(kind, interpolation):
    rng = np.random.default_rng(7)
    truth = ground("rough", interpolation, rng)
    eye = sample_position(truth.field, 1, 1)
    first = (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC).index(kind)  # limits take turns, each with two of these views
    for row, (up, morph, meshlet) in enumerate(((0.0, 1.0, 0), (1e-3, 1.5, 1), (-30.0, 4.0, 0), (900.0, 1.0, 2))):
        where = eye + [0.0, 0.0, up]
        view = View.look(
            where, where + [0.3, 0.2, -1.0], kind=kind, ortho_width=900.0, fov_deg=1e-5, resolution=(10**6, 9)
        )
        limits = {"max_triangles": 0, "morph": morph, "meshlet": meshlet}
        for tiny in ("error_px", "error_m", "edge_px", "area_px")[(first + row) % 2 :: 2]:
            request = {"error_px": 1.0, "error_m": 1.0, "edge_px": 8.0, "area_px": 50.0} | {tiny: 1e-30}
            scale = 1e30 if tiny.startswith("error") else 1.0
            found = Terrain(truth.field, 1).update(Criterion(**request, **limits), [view], None, scale)
            check(found, truth, [view], np.eye(4), scale, 0.0)
            bounds = [found.bound_px, found.bound_m, found.bound_edge_px, found.bound_area_px, found.relaxed]
            terms = [*vars(found.terms_px).values(), *vars(found.terms_m).values()]
            assert np.isfinite(bounds).all() and np.isfinite(terms).all() and found.limited == "max_triangles"
            assert found.bound_m < 3.0 * scale * (truth.field.max_height - truth.field.min_height)


def test_nothing_in_view_is_a_bound_of_nothing(crop):
    view = View.look((0, 0, 5000.0), (0, 0, 9000.0))
    found = Terrain(crop.field, 1).update(Criterion(), [view])
    assert found.bound_px == 0.0 and found.limited == "" and sum(vars(found.terms_px).values()) == 0.0
    assert len(found.surface.level) == 5, "two triangles a root square, cut at the rim"


def test_a_lower_shading_floor_takes_fewer_triangles(crop):
    view = View.look((0, 0, 9000.0), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=192 * 30.0)
    aside = View.look((0, -3000.0, 900.0), (0, 0, 300.0))
    counts, beside = [], set()
    for floor in (1.0, 0.5, 0.1, 0.0):
        criterion = Criterion(shading_floor=floor)
        found = Terrain(crop.field, 1).update(criterion, [view])
        check(found, crop, [view], np.eye(4), 1.0, 0.0)
        counts.append(found.triangles)
        beside.add(Terrain(crop.field, 1).update(criterion, [aside]).triangles if floor < 1 else 0)
    assert counts[0] > 1.5 * counts[1] > 6 * counts[2] > 6 * counts[3] == 6 * 5
    assert len(beside - {0}) == 1, "where errors show from the side the floor does not count"
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(TerrainError, match="The criterion's shading_floor is .*; expected a number from 0 to 1"):
            Criterion(shading_floor=wrong)
