# SPDX-License-Identifier: GPL-3.0-or-later
"""Height fields, views and measurements that the tests share."""

import math
from functools import partial
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.codes import decode
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField, with_detail
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from detail_surface import bilinear, ground_heights
from diamond_entries import range_index
from finer_bicubic import heights_with_tiles
from matplotlib.tri import Triangulation
from rasters import store_heights


def rough(height: int, width: int, seed: int = 0, relief: float = 100.0, step: float = 10.0) -> HeightField:
    """Random terrain with detail at every scale, `height` x `width` samples `step` metres apart."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(0, 3, height), np.linspace(0, 3, width), indexing="ij")
    z = np.zeros((height, width))
    for octave in range(5):
        a, b, c, d = rng.uniform(0, 6, 4)
        f = 2.0**octave
        z += np.sin(f * x + a) * np.cos(f * y + b) / f + 0.3 * np.sin(f * (x + y) + c) * np.sin(f * (x - y) + d) / f
    z += 0.02 * rng.standard_normal((height, width))
    return from_array((relief * z).astype(np.float32), step, step)


def errors_of(field: HeightField, meshlet: int = 0) -> np.ndarray:
    """Return the errors that a field's codes represent: float32 [node_count], metres."""
    return decode(field.lattice, error_for(field, meshlet), field.table)


def split_points(lattice, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Return samples (i, j) at the split vertices of the diamonds of a depth that have entries, above the cells."""
    (columns, rows), side = lattice.extent(depth), 1 << (lattice.levels - depth // 2)
    if depth % 2:
        j, i = np.indices((rows, columns)).reshape(2, -1) * side + side // 2
        return i, j
    j, i = np.indices((rows + 1, columns + 1))
    odd = (i + j) % 2 == 1
    return i[odd] * side, j[odd] * side


def ranges_of(field: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest code, int [rows, columns], of the heights of the diamond that is split at each sample.

    Of the two finest depths, which are not stored: what those have in common from which a split leads there.
    """
    lattice = field.lattice
    (across, up), levels = lattice.span, lattice.levels
    low, high = np.zeros((up + 1, across + 1), int), np.full((up + 1, across + 1), 65535)
    for depth in range(1, lattice.range_depth + 1):
        i, j = split_points(lattice, depth)
        low[j, i], high[j, i] = field.ranges[range_index(lattice, depth, i, j)].T
    for depth in range(max(lattice.range_depth, 1), 2 * levels):
        i, j = split_points(lattice, depth)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)) if depth % 2 else ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            x, y = i + dx, j + dy
            inside = (x >= 0) & (y >= 0) & (x <= across) & (y <= up)
            np.maximum.at(low, (y[inside], x[inside]), low[j[inside], i[inside]])
            np.minimum.at(high, (y[inside], x[inside]), high[j[inside], i[inside]])
    return low, high


def random_view(rng: np.random.Generator, field: HeightField) -> View:
    """Return a random view in, around or below the terrain, perhaps one that does not see it."""
    size = extent(field)
    eye = (rng.random(3) * 2 - 1) * size * 10 ** rng.uniform(-1, 0.7)
    if rng.random() < 0.2:  # on the surface, on a sample
        j, i = rng.integers(field.lattice.height), rng.integers(field.lattice.width)
        eye = sample_position(field, i, j)
    target = eye + rng.standard_normal(3) * size
    kind = rng.choice([PERSPECTIVE, PERSPECTIVE, PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC])
    return View.look(
        eye,
        target,
        fov_deg=float(360 if kind == PANORAMIC else 10 ** rng.uniform(0, 2.2)),
        resolution=(int(rng.integers(1, 4000)), int(rng.integers(1, 4000))),
        kind=str(kind),
        ortho_width=float(size[0] * 10 ** rng.uniform(-3, 1)),
        clip=(0.1, 1e6),
        roll_deg=float(rng.uniform(0, 360)),
    )


def extent(field: HeightField) -> np.ndarray:
    """float64 [3]: the terrain's size in metres."""
    lattice = field.lattice
    relief = max(field.max_height - field.min_height, 1.0)
    return np.array([(lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y, relief])


def sample_position(field: HeightField, i: int, j: int) -> np.ndarray:
    """float64 [3]: sample (column i, row j) in the terrain's own space."""
    lattice = field.lattice
    x, y = (i - (lattice.width - 1) / 2) * lattice.step_x, (j - (lattice.height - 1) / 2) * lattice.step_y
    return np.array([x, y, float(field.samples[j, i])])


def reference_heights(field: HeightField, plane: np.ndarray) -> np.ndarray:
    """Return the heights of the reference surface at points [n, 2] of the terrain's space."""
    if field.detail:
        plain = with_detail(field, None)
        return reference_heights(plain, plane) + ground_heights(field, plane)
    if field.interpolation == "bicubic":
        bicubic = partial(bezier_heights, field)
        return heights_with_tiles(field, plane, bicubic) if field.raster.finer else bicubic(plane)
    return bilinear(field.lattice, np.asarray(field.heights(), np.float64), plane)


# Four samples in a row to the control heights of the cubic between the middle two.
TO_BEZIER = np.array([[0, 1, 0, 0], [-1 / 6, 1, 1 / 6, 0], [0, 1 / 6, 1, -1 / 6], [0, 0, 1, 0]])


def bezier(field: HeightField, plane: np.ndarray, cell: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return heights [n] and gradients [n, 2] (m/m) of the C1 bicubic surface at points [n, 2], as Bezier patches.

    cell: int [n, 2], the columns and rows of the patches to use in place of those that contain the points.
    """
    control, place = _patches(field, plane, cell)
    (u, du), (v, dv) = _bernstein(place[:, 0]), _bernstein(place[:, 1])
    steps = np.array([field.lattice.step_x, field.lattice.step_y])
    return _weigh(control, u, v), np.stack([_weigh(control, du, v), _weigh(control, u, dv)], axis=1) / steps


def bezier_heights(field: HeightField, plane: np.ndarray) -> np.ndarray:
    """Return the heights alone, in a third of the time."""
    control, place = _patches(field, plane)
    return _weigh(control, *(_bernstein_values(place[:, k]) for k in (0, 1)))


def _patches(field: HeightField, plane: np.ndarray, cell: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the control heights [n, 4, 4] of the patches of points [n, 2], and the places in them, [n, 2]."""
    lattice = field.lattice
    steps, cells = np.array([lattice.step_x, lattice.step_y]), np.array([lattice.width - 1, lattice.height - 1])
    place = np.clip(plane / steps + cells / 2, 0, cells)
    at = np.minimum(place.astype(int), cells - 1) if cell is None else cell
    h = np.asarray(field.heights(), np.float64)
    h = np.concatenate([2 * h[:1] - h[1:2], h, 2 * h[-1:] - h[-2:-1]])
    h = np.concatenate([2 * h[:, :1] - h[:, 1:2], h, 2 * h[:, -1:] - h[:, -2:-1]], axis=1)
    numbers, of_points = np.unique(at @ [1, cells[0]], return_inverse=True)  # many points share a patch
    (j, i), near = np.divmod(numbers[:, None, None], cells[0]), np.arange(4)
    control = TO_BEZIER @ h[j + near[:, None], i + near] @ TO_BEZIER.T
    return control[of_points], place - at


def _weigh(control: np.ndarray, across: np.ndarray, up: np.ndarray) -> np.ndarray:
    return np.einsum("nji,ni,nj->n", control, across, up)


def _bernstein(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic Bernstein polynomials [n, 4] and their derivatives."""
    r = 1 - t
    slopes = np.stack([-3 * r**2, 3 * r**2 - 6 * t * r, 6 * t * r - 3 * t**2, 3 * t**2], axis=1)
    return _bernstein_values(t), slopes


def _bernstein_values(t: np.ndarray) -> np.ndarray:
    r = 1 - t
    r2, t2 = r * r, t * t  # a cube by ** takes ten times as long
    return np.stack([r2 * r, 3 * t * r2, 3 * t2 * r, t2 * t], axis=1)


def least_triangles(field: HeightField, meshlet: int) -> int:
    """Return the number of triangles of the coarsest mesh: the root squares, cut at the border."""
    return Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e30, meshlet=meshlet)).triangles


def mesh_heights(surface: Surface, plane: np.ndarray, values: np.ndarray | None = None) -> np.ndarray:
    """Return the height of the mesh at points [n, 2], or other `values` of its vertices there."""
    p = surface.positions.astype(np.float64)
    corners = _with_points(surface.triangles, p[:, :2], plane)
    finder = Triangulation(p[:, 0], p[:, 1], corners).get_trifinder()
    owner = finder(*plane.T)
    # The finder misses points on the border and on some edges: a hair nearer to the middle it finds most of them, and
    # for the others every triangle is tried.
    missed = np.flatnonzero(owner < 0)
    middle = (p[:, :2].min(0) + p[:, :2].max(0)) / 2
    owner[missed] = finder(*((plane[missed] - middle) * (1 - 1e-9) + middle).T)
    for n in np.flatnonzero(owner < 0):
        owner[n] = _barycentric(p[corners], plane[n]).min(axis=1).argmax()
    weights = _barycentric(p[corners[owner]], plane)
    assert weights.min() > -1e-4
    return np.einsum("nk,nk...->n...", weights, (p[:, 2] if values is None else values)[corners[owner]])


def _with_points(corners: np.ndarray, p: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Return triangles that may contain points [n, 2], by boxes of a coarse grid: to find points in all takes longer.

    corners: numbers [T, 3] of vertices in p, [V, 2].
    """
    side, low, size = 64, p.min(axis=0), np.ptp(p, axis=0)
    cells, points = (np.clip((places - low) / size * side, 0, side - 1).astype(int) for places in (p, plane))
    counts = np.bincount(points @ [side, 1], minlength=side * side).reshape(side, side).cumsum(0).cumsum(1)
    before = np.pad(counts, ((1, 0), (1, 0)))  # number of points before a row and a column
    (x0, y0), (x1, y1) = cells[corners].min(axis=1).T, cells[corners].max(axis=1).T + 1
    return corners[before[x1, y1] - before[x0, y1] - before[x1, y0] + before[x0, y0] > 0]


def _barycentric(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """float64 [n, 3] of points [n, 2] or [2] in triangles [n, 3, 2 or 3]."""
    a, u, v = triangles[:, 0, :2], triangles[:, 1, :2] - triangles[:, 0, :2], triangles[:, 2, :2] - triangles[:, 0, :2]
    area, d = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], points - a
    s = (d[:, 0] * v[:, 1] - d[:, 1] * v[:, 0]) / area
    t = (u[:, 0] * d[:, 1] - u[:, 1] * d[:, 0]) / area
    return np.stack([1 - s - t, s, t], axis=1)


def project(view: View, points: np.ndarray, placement: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels [n, 2] (or unit directions [n, 3] of a panorama) of points, and whether each is in the frame."""
    matrix = view.world_to_camera if placement is None else view.world_to_camera @ placement
    camera = points @ matrix[:3, :3].T + matrix[:3, 3]
    if view.kind == PANORAMIC:
        length = np.maximum(np.linalg.norm(camera, axis=1, keepdims=True), 1e-300)
        return camera / length, length[:, 0] > view.clip[0]
    clip = np.c_[camera, np.ones(len(camera))] @ view.projection.T
    with np.errstate(all="ignore"):
        device = clip[:, :2] / clip[:, 3:]
    seen = (np.abs(device) <= 1).all(axis=1) & (-camera[:, 2] > view.clip[0]) & (-camera[:, 2] < view.clip[1])
    return device * np.array(view.resolution) / 2, seen


def screen_error(view: View, field: HeightField, surface: Surface, plane: np.ndarray, placement=None) -> float:
    """Largest distance in pixels between a seen point of the reference surface and the mesh's point below it."""
    truth = np.c_[plane, reference_heights(field, plane)]
    below = np.c_[plane, mesh_heights(surface, plane)]
    a, seen = project(view, truth, placement)
    b, _ = project(view, below, placement)
    if not seen.any():
        return 0.0
    if view.kind == PANORAMIC:
        half = np.linalg.norm(a - b, axis=1)[seen] / 2
        return float((2 * np.arcsin(np.minimum(half, 1))).max() / view.radians_per_pixel)
    return float(np.linalg.norm(a[seen] - b[seen], axis=1).max())


def scattered(field: HeightField, count: int, seed: int = 0) -> np.ndarray:
    """Return points [n, 2] of the terrain's space: at most `count` samples, then random points between them."""
    rng = np.random.default_rng(seed)
    lattice, size = field.lattice, extent(field)[:2]
    free = (rng.random((count // 2, 2)) - 0.5) * size
    every = max(1, math.ceil(lattice.width * lattice.height / (count // 2)))
    index = np.arange(rng.integers(every), lattice.width * lattice.height, every)
    j, i = np.divmod(index, lattice.width)
    steps = np.array([lattice.step_x, lattice.step_y])
    return np.concatenate([free, (np.stack([i, j], 1) - np.array([lattice.width - 1, lattice.height - 1]) / 2) * steps])


def write_store(path: Path, seed: int) -> Path:
    """Write a store of 17 x 17 random samples."""
    return store_heights(path, np.random.default_rng(seed).random((17, 17)), 1.0)


def contents(path: Path) -> dict[str, bytes]:
    """Return all files below a folder."""
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}
