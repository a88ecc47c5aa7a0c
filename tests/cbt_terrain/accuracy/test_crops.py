# SPDX-License-Identifier: GPL-3.0-or-later
"""Crops of a frame at several errors: the triangle at each pixel, and its colours."""

import io

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.accuracy.crops import SIDE, crops
from adaptive_terrain.cbt_terrain.accuracy.timed_runs import TimedFrame
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import shared
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from adaptive_terrain.kernels.accuracy import drawing
from adaptive_terrain.operators.text.png import png
from PIL import Image


def test_each_pixel_has_the_nearest_triangle_over_its_middle():
    rng, width, height, count = np.random.default_rng(5), 70, 50, 60
    places = np.c_[rng.uniform(-20, 90, (3 * count, 2)), rng.uniform(1, 2, 3 * count)]
    corners = np.arange(3 * count, dtype=np.int32)
    places[3:6, :2] = [(5, 5), (15, 15), (25, 25)]  # seen from its edge
    shown, depth_keys = np.full(width * height, -1, np.int32), np.full(width * height, -np.inf)
    arrays = [shared(corners, wp.int32), shared(places, wp.vec3d), width, height]
    bands = -(-height // int(drawing.BAND))
    launch.spread(
        drawing.draw_triangles, bands, [*arrays, shared(depth_keys, wp.float64), shared(shown, wp.int32)], step="draw"
    )
    y, x = np.divmod(np.arange(width * height), width)
    best, expected = np.full(width * height, -np.inf), np.full(width * height, -1)
    for triangle, ends in enumerate(places.reshape(count, 3, 3)):
        if triangle == 1:
            continue
        plane = np.linalg.solve(np.c_[ends[:, :2], np.ones(3)], np.c_[np.eye(3), ends[:, 2]])
        parts = np.c_[x + 0.5, y + 0.5, np.ones(len(x))] @ plane
        over = (parts[:, :3] > 0).all(axis=1) & (parts[:, 3] > best)
        best[over], expected[over] = parts[over, 3], triangle
    assert (shown == expected).mean() > 0.999 and len(set(expected)) > count // 2


@pytest.fixture(scope="module")
def terrain():
    y, x = np.mgrid[0:65, 0:65]
    heights = np.where(x > 32, 12 * np.sin(x * 1.3) * np.cos(y * 0.9), 0.0)  # rough in the east alone
    return Terrain(from_array(heights.astype(np.float32), step_x=10.0, step_y=10.0))


def above(**look) -> View:
    return View.look((0, -1, 2000), (0, 0, 0), resolution=(640, 640), kind=ORTHOGRAPHIC, ortho_width=640.0, **look)


def test_a_crop_shows_where_errors_differ(terrain):
    frame = TimedFrame([above()], vertical_scale=2.0)
    coarse, middle, fine = crops(terrain, frame, (8.0, 2.0, 0.25))
    assert coarse.pixels.shape == (SIDE, SIDE, 3) and coarse.pixels.dtype == np.uint8
    assert coarse.triangles < middle.triangles < fine.triangles
    update = terrain.update(Criterion(error_px=2.0), [above()], None, 2.0)
    assert middle.triangles == update.triangles
    bare = np.add.outer(np.arange(SIDE)[::-1], np.arange(SIDE)) > SIDE + 4  # where no edges are drawn
    apart = [np.abs(crop.pixels.astype(int) - fine.pixels)[bare].mean() for crop in (coarse, middle)]
    assert apart[0] > apart[1] > 0
    assert fine.pixels[bare].std() > 10, "it shows the rough east, not the plain west"


def test_panoramas_and_frames_without_views_have_no_crops(terrain):
    panorama = View.look((0, 0, 50), (1, 0, 50), kind=PANORAMIC, resolution=(64, 32))
    assert crops(terrain, TimedFrame([panorama]), (4.0, 1.0)) == []
    assert crops(terrain, TimedFrame([]), (4.0,)) == [] and crops(terrain, TimedFrame([above()]), ()) == []


def test_other_programs_read_the_png():
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 3), np.uint8)
    assert (np.asarray(Image.open(io.BytesIO(png(pixels)))) == pixels).all()
