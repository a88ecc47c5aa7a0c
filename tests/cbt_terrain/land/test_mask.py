# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks by images and by rules over the ground."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.land.mask import GroundRule, Mask, whole_mask
from adaptive_terrain.cbt_terrain.land.mask_image import load_image
from adaptive_terrain.cbt_terrain.land.tiles import Level
from rasters import write_exr, write_raster

LEVEL = Level(0, 300, 200, 10.0, 20.0)


def ruled(heights, *rules, factor=1.0):
    return whole_mask(Mask("", rules, factor), None, LEVEL, lambda window: heights[window])


def plane(east, north):
    """Rises by so many metres a metre."""
    rows, columns = np.mgrid[0:300, 0:200]
    return (east * columns * 10.0 + north * rows * 20.0).astype(np.float32)


def test_heights_between_limits_with_soft_edges():
    """Half at a limit, nothing and all half an edge away from it, and in between as 3 t^2 - 2 t^3."""
    heights = plane(1.0, 0.0)
    found = ruled(heights, GroundRule("height", 500.0, 1500.0, edge=200.0), factor=0.5)[7]
    x = np.arange(200) * 10.0
    t = np.clip(np.minimum((x - 400) / 200, (1600 - x) / 200), 0, 1)
    assert abs(found - 0.5 * (3 * t**2 - 2 * t**3)).max() < 1e-5
    assert found[50] == found[150] == pytest.approx(0.25)


@pytest.mark.parametrize("edge", [0.0, 1e-9])
def test_limits_with_next_to_no_edge_are_inside_however_far(edge):
    """Dry ground, whose water is 0 m deep, is all of that from 0 to 0; samples of whole metres meet limits exactly; and
    an edge that is lost beside a limit of 1e9 m divides nothing by 0."""
    heights = np.tile(np.float32([-1e9, -3.0, 999.0, 1000.0, 1001.0, 4e6, 1e9, 2e9]), (300, 25))
    for low, high in ((1000.0, 1001.0), (-3.0, 1e9), (-1e9, 4e6), (1e9, 1e9)):
        inside = (heights >= low) & (heights <= high)
        assert (ruled(heights, GroundRule("height", low, high, edge)) == inside).all()
    depth = np.tile(np.float32([0.0, 1e-6, 1.0, 10.0]), (300, 50))
    for of in ("water_depth", "discharge"):
        found = whole_mask(Mask("", (GroundRule(of, 0.0, 1.0),)), None, LEVEL, None, {of: depth})
        assert (found == (depth <= 1.0)).all()
    dry = whole_mask(Mask("", (GroundRule("water_depth", 0.0, 0.0),)), None, LEVEL, None, {"water_depth": depth})
    assert (dry == (depth == 0.0)).all()
    assert (ruled(plane(0.0, 0.0), GroundRule("slope", 0.0, 0.0, 0.0)) == 1.0).all(), "level ground"


@pytest.mark.parametrize("edge", [0.0, 1.0])
def test_a_limit_of_flow_may_be_as_far_as_a_panel_lets_it(edge):
    flow = np.tile(np.float32([0.0, 1.0, 1e6, 1e15]), (300, 50))
    low, high = GroundRule("flow", low=3.4e38, edge=edge), GroundRule("flow", high=3.4e38, edge=edge)
    for rule, inside in ((low, 0.0), (high, 1.0)):
        rule.check("The mask")
        assert (whole_mask(Mask("", (rule,)), None, LEVEL, None, {"flow": flow}) == inside).all()


@pytest.mark.parametrize(("east", "north"), [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8)])
def test_slopes_in_degrees(east, north):
    heights = plane(east, north)
    assert abs(ruled(heights, GroundRule("slope", 44.0, 46.0)) - 1).max() < 1e-6
    assert (
        not ruled(heights, GroundRule("slope", 46.0)).any() and not ruled(heights, GroundRule("slope", high=44.0)).any()
    )
    assert abs(ruled(heights, GroundRule("slope", 45.0, edge=10.0)) - 0.5).max() < 1e-5
    assert (ruled(heights, GroundRule("slope", -90.0, 90.0)) == 1).all()


def test_aspect_is_where_downhill_points():
    """Ground that rises to the north falls to the south: 180 degrees."""
    heights = plane(0.0, 0.5)
    for degrees, cosine in ((180, 1.0), (0, -1.0), (90, 0.0), (120, 0.5)):
        rule = GroundRule("aspect", cosine - 0.01, cosine + 0.01, direction=degrees)
        assert (ruled(heights, rule) == 1).all()
        assert not ruled(heights, GroundRule("aspect", cosine + 0.01, 2.0, direction=degrees)).any() or cosine > 1
    assert (ruled(np.zeros_like(heights), GroundRule("aspect", -0.1, 0.1)) == 1).all(), "level ground has 0"


def test_a_rule_over_rows_in_bands_is_that_over_all_at_once():
    heights = np.random.default_rng(1).normal(0, 100, (300, 200)).astype(np.float32)
    north, east = np.gradient(heights.astype(np.float64), 20.0, 10.0)
    degrees = np.degrees(np.arctan(np.hypot(north, east)))
    found = ruled(heights, GroundRule("slope", 40.0, 80.0))
    sure = (abs(degrees - 40) > 1e-3) & (abs(degrees - 80) > 1e-3)
    assert (found[sure] == ((degrees > 40) & (degrees < 80))[sure]).all()


def test_an_image_lies_over_the_extent_at_every_level():
    """A ramp: half-way everywhere half, whatever the level's samples, rows from the south."""
    image = np.linspace(0, 1, 64, dtype=np.float32)[:, None] * np.ones(5, np.float32)
    for level in (LEVEL, Level(1, 151, 101, 20.0, 40.0)):
        found = whole_mask(Mask("a"), image, level, None)
        up = np.linspace(0, 1, level.rows)
        expected = np.clip((up * 64 - 0.5) / 63, 0, 1)
        assert abs(found - expected[:, None]).max() < 1e-6


def write_npy(path, values):
    np.save(path, values)


WRITERS = {
    "m.png": lambda path, part: write_raster(path, (part * 255).round().astype(np.uint8)),
    "m16.png": lambda path, part: write_raster(path, (part * 65535).round().astype(np.uint16)),
    "m.tif": lambda path, part: write_raster(path, part),
    "m.npy": write_npy,
    "m.exr": lambda path, part: write_exr(path, Y=part),
}


@pytest.mark.parametrize("name", WRITERS)
def test_any_file_that_an_import_reads_is_a_mask(tmp_path, name):
    part = (np.arange(35, dtype=np.float32) / 34).reshape(5, 7)
    WRITERS[name](tmp_path / name, part)
    (tmp_path / "kept").mkdir()
    found = load_image(str(tmp_path / name), tmp_path / "kept")
    assert found.shape == (5, 7) and abs(found - part[::-1]).max() <= (0.501 / 255 if name == "m.png" else 1e-5)
    assert load_image(str(tmp_path / name), tmp_path / "kept").tobytes() == found.tobytes()


def test_a_png_that_was_cut_off_is_refused(tmp_path):
    """GDAL gives black, or noise, for the rows that are missing."""
    write_raster(tmp_path / "m.png", np.random.default_rng(2).integers(0, 255, (64, 64), np.uint8))
    with open(tmp_path / "m.png", "r+b") as file:
        file.truncate(900)
    with pytest.raises(TerrainError, match="m.png is damaged .*ends inside a chunk"):
        load_image(str(tmp_path / "m.png"), tmp_path)


@pytest.mark.parametrize("content", [b"", b"no image", None])
def test_a_mask_that_cannot_be_read_is_named(tmp_path, content):
    if content is not None:
        (tmp_path / "m.png").write_bytes(content)
    with pytest.raises(TerrainError, match="m.png"):
        load_image(str(tmp_path / "m.png"), tmp_path)
    assert math.isinf(GroundRule("height").high)
