# SPDX-License-Identifier: GPL-3.0-or-later
"""How near shading by a baked normal map is to the truth, and how still it stays in a flight.

Pictures of Lambert's shading, 255 where the sun stands upright on the ground, of the built-in island along the demo's
flight. The truth has 4 x 4 samples a pixel on a mesh of a quarter of a pixel, with the normals of the raster's own
samples; ours 2 x 2 on the mesh at 1 px, with the normals that the map's file has, bilinear between its texels, and the
baseline those of the vertices. Only pixels that are all ground count. Flicker: how a picture changes from frame to
frame less how the truth does.
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rasterio
import warp as wp

from ...cbt_terrain.ask.camera_path import read_camera_path
from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.linear import product
from ...cbt_terrain.ask.view import View
from ...cbt_terrain.effects.effect import Asked
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.island import SIDE, island
from ...cbt_terrain.maps.folder import read_index
from ...cbt_terrain.mesh.attributes import NORMALS
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch
from ...cbt_terrain.run.buffers import shared
from ...cbt_terrain.terrain import Terrain
from ...kernels.accuracy import drawing
from ...operators.demo.demo import FLIGHT
from ...operators.effects.map_baking import MapRequest, carry_out
from ..rig.measure import Row, stopwatch

SAMPLES = 4097
RESOLUTION = (960, 540)
FRAMES = (8.0, 8.04)
TRUE, OURS = 4, 2  # samples along a pixel's side
SUN = np.array([-0.6, 0.25, 0.45]) / np.sqrt(0.625)
NORMAL = "detail_normal"
Normals = Callable[[np.ndarray], np.ndarray]  # of places, float64 [n, 2] metres, float [n, 3]


def shading_rows(folder: Path):
    """Two rows, of the error and of the flicker: ratios to those of normals at vertices; ms are the map's."""
    field = from_array(island(SAMPLES), SIDE / (SAMPLES - 1))
    file = folder / "shading.json"
    file.write_text(json.dumps(FLIGHT), encoding="utf-8")
    path = read_camera_path(file)
    views = [path.view(frame, RESOLUTION) for frame in FRAMES]
    request = MapRequest((Asked(NORMAL, ("this benchmark",)),), folder / "shading", tuple(views), only_seen=True)
    with stopwatch() as elapsed:
        carry_out(request, field)
    terrain, raster, mapped = Terrain(field), _raster_normals(field), _map_normals(request.folder)
    off, inside, triangles = [], [], 0
    for view in views:
        surface = Terrain(field).update(Criterion(error_px=1.0 / TRUE), [view]).surface
        truth, seen = _picture(surface, view, TRUE, raster)
        surface = terrain.update(Criterion(error_px=1.0), [view]).surface
        off.append([_picture(surface, view, OURS, normals)[0] - truth for normals in (mapped, None)])
        inside.append(seen)
        triangles = len(surface.triangles)
    error = [_rms(np.concatenate([less[k][seen] for less, seen in zip(off, inside, strict=True)])) for k in (0, 1)]
    flicker = [_rms((off[1][k] - off[0][k])[inside[0] & inside[1]]) for k in (0, 1)]
    for name, (ours, theirs) in (("shading_error", error), ("shading_flicker", flicker)):
        figures = {"of_255": ours, "vertices_of_255": theirs}
        yield Row(name, triangles, elapsed[0], "normals at vertices", ratio=ours / theirs, figures=figures)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _picture(surface: Surface, view: View, across: int, normals: Normals | None) -> tuple[np.ndarray, np.ndarray]:
    """Lambert's shading of each pixel, the mean of `across`^2 samples, and whether all of them are ground: float64 and
    bool [rows, columns]. normals: of places; None for those of the vertices."""
    columns, rows = (across * n for n in view.resolution)
    to_clip = product(view.projection, view.world_to_camera)
    clip = np.c_[surface.positions, np.ones(len(surface.positions))] @ to_clip.T
    ahead = clip[:, 3] > 1.0
    w = np.where(ahead, clip[:, 3], 1.0)
    places = np.c_[(clip[:, :2] / w[:, None] + 1) / 2 * (columns, rows), 1 / w]
    corners = np.ascontiguousarray(surface.triangles[ahead[surface.triangles].all(axis=1)])
    shown, nearness = np.full(rows * columns, -1, np.int32), np.full(rows * columns, -np.inf)
    arrays = [shared(corners.reshape(-1), wp.int32), shared(places, wp.vec3d), columns, rows]
    arrays += [shared(nearness, wp.float64), shared(shown, wp.int32)]
    threads = launch.default_threads()
    launch.spread(drawing.draw_triangles, -(-rows // int(drawing.BAND)), arrays, step="draw", threads=threads, cost=1e4)
    light, seen = np.zeros(rows * columns), shown >= 0
    for some in np.array_split(np.flatnonzero(seen), 16):
        hit = corners[shown[some]]
        up, right = np.divmod(some, columns)
        weights = _parts(places[hit], np.stack([right + 0.5, up + 0.5], 1)) * places[hit, 2]
        weights /= weights.sum(axis=1, keepdims=True)
        if normals is None:
            found = (surface.attributes[NORMALS].array[hit] * weights[..., None]).sum(axis=1)
        else:
            found = normals((surface.positions[hit, :2] * weights[..., None]).sum(axis=1))
        light[some] = 255 * np.maximum(found @ SUN, 0) / np.sqrt((found * found).sum(axis=1))
    shape = view.resolution[1], across, view.resolution[0], across
    return light.reshape(shape).mean((1, 3)), seen.reshape(shape).all((1, 3))


def _parts(ends: np.ndarray, at: np.ndarray) -> np.ndarray:
    """float64 [n, 3]: of the corners [n, 3, >= 2] of triangles at points [n, 2]."""
    out = at[:, None] - ends[:, (1, 2, 0), :2]
    along = ends[:, (2, 0, 1), :2] - ends[:, (1, 2, 0), :2]
    twice = along[..., 0] * out[..., 1] - along[..., 1] * out[..., 0]
    return twice / twice.sum(axis=1, keepdims=True)


def _between(image: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Bilinear between the pixels of an image, [rows, columns, 3]."""
    column, row = (np.clip(at, 0, n - 1) for at, n in ((column, image.shape[1]), (row, image.shape[0])))
    i, j = (np.minimum(at.astype(int), n - 2) for at, n in ((column, image.shape[1]), (row, image.shape[0])))
    s, t = (column - i)[:, None], (row - j)[:, None]
    low = image[j, i] * (1 - s) + image[j, i + 1] * s
    return low * (1 - t) + (image[j + 1, i] * (1 - s) + image[j + 1, i + 1] * s) * t


def _raster_normals(field: HeightField) -> Normals:
    lattice = field.lattice
    north, east = np.gradient(field.heights(), lattice.step_y, lattice.step_x)
    image = np.stack([-east, -north, np.ones_like(east)], -1)
    west, south, _, _ = lattice.rectangle()
    return lambda at: _between(image, (at[:, 0] - west) / lattice.step_x, (at[:, 1] - south) / lattice.step_y)


def _map_normals(folder: Path) -> Normals:
    """Of a map's only tile, as its file has them."""
    index = read_index(folder)
    (tile,) = index["maps"][NORMAL]["tiles"]
    coding, (west, _, _, north) = index["maps"][NORMAL]["coding"], tile["box_m"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that an image has no georeference
        with rasterio.open(folder / tile["file"]) as file:
            image = np.moveaxis(file.read(), 0, -1)
    texel_x, texel_y = ((tile["box_m"][k + 2] - tile["box_m"][k]) / tile["resolution"] for k in (0, 1))

    def normals(at: np.ndarray) -> np.ndarray:
        texels = _between(image, (at[:, 0] - west) / texel_x - 0.5, (north - at[:, 1]) / texel_y - 0.5)
        return coding["zero"] + (coding["one"] - coding["zero"]) * texels / 255.0

    return normals
