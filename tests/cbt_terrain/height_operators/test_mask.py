# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks by images and by rules over the ground."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators import mask_image
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask, compute_mask
from adaptive_terrain.cbt_terrain.height_operators.mask_image import load_image
from adaptive_terrain.cbt_terrain.height_operators.tiles import Level
from rasters import write_exr, write_raster

LEVEL = Level(0, 300, 200, 10.0, 20.0)


def ruled(heights, *rules, factor=1.0):
    return compute_mask(HeightMask("", rules, factor), None, LEVEL, lambda window: heights[window])


def plane(east, north):
    """Return heights with these slopes."""
    rows, columns = np.mgrid[0:300, 0:200]
    return (east * columns * 10.0 + north * rows * 20.0).astype(np.float32)


def test_heights_between_limits_with_soft_edges():
    """A weight is 0.5 at a limit, 0 and 1 half an edge away from it, and 3 t^2 - 2 t^3 in between."""
    heights = plane(1.0, 0.0)
    found = ruled(heights, GroundRule("height", 500.0, 1500.0, edge=200.0), factor=0.5)[7]
    x = np.arange(200) * 10.0
    t = np.clip(np.minimum((x - 400) / 200, (1600 - x) / 200), 0, 1)
    assert abs(found - 0.5 * (3 * t**2 - 2 * t**3)).max() < 1e-5
    assert found[50] == found[150] == pytest.approx(0.25)


@pytest.mark.parametrize("edge", [0.0, 1e-9])
def test_limits_without_an_edge_are_inside(edge):
    """Water from 0 to 0 m selects dry ground, heights of whole metres equal limits, and an edge that float32 loses at a
    limit of 1e9 m does not divide by 0."""
    heights = np.tile(np.float32([-1e9, -3.0, 999.0, 1000.0, 1001.0, 4e6, 1e9, 2e9]), (300, 25))
    for low, high in ((1000.0, 1001.0), (-3.0, 1e9), (-1e9, 4e6), (1e9, 1e9)):
        inside = (heights >= low) & (heights <= high)
        assert (ruled(heights, GroundRule("height", low, high, edge)) == inside).all()
    depth = np.tile(np.float32([0.0, 1e-6, 1.0, 10.0]), (300, 50))
    for of in ("water_depth", "discharge"):
        found = compute_mask(HeightMask("", (GroundRule(of, 0.0, 1.0),)), None, LEVEL, None, {of: depth})
        assert (found == (depth <= 1.0)).all()
    dry = compute_mask(
        HeightMask("", (GroundRule("water_depth", 0.0, 0.0),)), None, LEVEL, None, {"water_depth": depth}
    )
    assert (dry == (depth == 0.0)).all()
    assert (ruled(plane(0.0, 0.0), GroundRule("slope", 0.0, 0.0, 0.0)) == 1.0).all(), "level ground"


@pytest.mark.parametrize("edge", [0.0, 1.0])
def test_a_limit_of_flow_reaches_the_end_of_float32(edge):
    flow = np.tile(np.float32([0.0, 1.0, 1e6, 1e15]), (300, 50))
    low, high = GroundRule("flow", low=3.4e38, edge=edge), GroundRule("flow", high=3.4e38, edge=edge)
    for rule, inside in ((low, 0.0), (high, 1.0)):
        rule.check("The mask")
        assert (compute_mask(HeightMask("", (rule,)), None, LEVEL, None, {"flow": flow}) == inside).all()


@pytest.mark.parametrize(("east", "north"), [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8)])
def test_slopes_in_degrees(east, north):
    heights = plane(east, north)
    assert abs(ruled(heights, GroundRule("slope", 44.0, 46.0)) - 1).max() < 1e-6
    assert not ruled(heights, GroundRule("slope", 46.0)).any()
    assert not ruled(heights, GroundRule("slope", high=44.0)).any()
    assert abs(ruled(heights, GroundRule("slope", 45.0, edge=10.0)) - 0.5).max() < 1e-5
    assert (ruled(heights, GroundRule("slope", -90.0, 90.0)) == 1).all()


def test_aspect_is_the_direction_of_downhill():
    """Ground that rises to the north has 180 degrees."""
    heights = plane(0.0, 0.5)
    for degrees, cosine in ((180, 1.0), (0, -1.0), (90, 0.0), (120, 0.5)):
        rule = GroundRule("aspect", cosine - 0.01, cosine + 0.01, direction=degrees)
        assert (ruled(heights, rule) == 1).all()
        assert not ruled(heights, GroundRule("aspect", cosine + 0.01, 2.0, direction=degrees)).any() or cosine > 1
    assert (ruled(np.zeros_like(heights), GroundRule("aspect", -0.1, 0.1)) == 1).all(), "level ground has 0"


def test_a_rule_in_bands_of_rows_equals_that_of_all_rows():
    heights = np.random.default_rng(1).normal(0, 100, (300, 200)).astype(np.float32)
    north, east = np.gradient(heights.astype(np.float64), 20.0, 10.0)
    degrees = np.degrees(np.arctan(np.hypot(north, east)))
    found = ruled(heights, GroundRule("slope", 40.0, 80.0))
    sure = (abs(degrees - 40) > 1e-3) & (abs(degrees - 80) > 1e-3)
    assert (found[sure] == ((degrees > 40) & (degrees < 80))[sure]).all()


def test_an_image_covers_the_extent_at_every_level():
    """A ramp from the south is the same function of the position at every level."""
    image = np.linspace(0, 1, 64, dtype=np.float32)[:, None] * np.ones(5, np.float32)
    for level in (LEVEL, Level(1, 151, 101, 20.0, 40.0)):
        found = compute_mask(HeightMask("a"), image, level, None)
        up = np.linspace(0, 1, level.rows)
        expected = np.clip((up * 64 - 0.5) / 63, 0, 1)
        assert abs(found - expected[:, None]).max() < 1e-6


WRITERS = {
    "m.png": lambda path, part: write_raster(path, (part * 255).round().astype(np.uint8)),
    "m16.png": lambda path, part: write_raster(path, (part * 65535).round().astype(np.uint16)),
    "m.tif": lambda path, part: write_raster(path, part),
    "m.npy": np.save,
    "m.exr": lambda path, part: write_exr(path, Y=part),
}


@pytest.mark.parametrize("name", WRITERS)
def test_any_importable_file_is_a_mask(tmp_path, name):
    part = (np.arange(35, dtype=np.float32) / 34).reshape(5, 7)
    WRITERS[name](tmp_path / name, part)
    (tmp_path / "kept").mkdir()
    found = load_image(str(tmp_path / name), tmp_path / "kept")
    assert found.shape == (5, 7) and abs(found - part[::-1]).max() <= (0.501 / 255 if name == "m.png" else 1e-5)
    assert load_image(str(tmp_path / name), tmp_path / "kept").tobytes() == found.tobytes()


def test_an_unchanged_mask_image_is_converted_once(tmp_path, monkeypatch):
    file, folder = tmp_path / "m.png", tmp_path / "kept"
    folder.mkdir()
    converted = []
    monkeypatch.setattr(mask_image, "guard", lambda *_: None)  # this process converts, as the child would
    monkeypatch.setattr(mask_image.child, "end_with_parent", lambda: None)
    monkeypatch.setattr(
        mask_image, "ask", lambda _module, request, _what: (converted.append(request), mask_image._read(request))[1]
    )

    def check(value: int, conversions: int) -> None:
        """Assert the image's only value and the number of conversions so far."""
        found = load_image(str(file), folder)
        assert found.shape == (6, 9) and (found == np.float32(value) / np.float32(255)).all()
        assert len(converted) == conversions

    write_raster(file, np.full((6, 9), 51, np.uint8))
    check(51, 1)
    check(51, 1)
    write_raster(file, np.full((6, 9), 102, np.uint8))
    os.utime(file, ns=(1, 1))
    check(102, 2)
    (tmp_path / "m.pgw").write_text("1\n0\n0\n-1\n0\n0\n")  # a sidecar may turn the image
    check(102, 3)
    check(102, 3)
    for array in folder.glob("*.npy"):
        with array.open("r+b") as handle:
            handle.seek(-300, os.SEEK_END)
            handle.write(b"\x7f" * 8)
    check(102, 4)
    for array in folder.glob("*.npy"):
        array.write_bytes(b"")
    check(102, 5)


def test_a_truncated_png_is_refused(tmp_path):
    """GDAL returns black or noise for the missing rows."""
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
