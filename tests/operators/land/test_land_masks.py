# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an effect on heights acts: masks by rules, images and objects."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators import land_folder
from adaptive_terrain.cbt_terrain.height_operators.mask import LIMITS
from adaptive_terrain.operators.land import masks as land_masks
from adaptive_terrain.operators.land import properties as land_properties
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.session import session
from demand_trees import new_object
from land_scenes import add, stack_now
from rasters import write_raster


def test_a_mask_without_pixels_is_told_of_as_a_mask(terrain):
    entry = add("relief")
    entry.mask.kind, entry.mask.image = "IMAGE", bpy.data.images.new("Lost", 4, 4)
    entry.mask.image.source = "FILE"
    with pytest.raises(session.TerrainError, match="The image 'Lost' of a mask has no pixels"):
        session.update_object(terrain)


def test_masks_by_rule_image_and_object(terrain, tmp_path):
    entry = add("scree")
    entry.mask.kind = "IMAGE"
    with pytest.raises(session.TerrainError, match="masked by an image, and none is chosen"):
        session.update_object(terrain)
    image = bpy.data.images.new("Paint", 6, 3, float_buffer=True)
    pixels = np.zeros((3, 6, 4), np.float32)
    pixels[0, :2, 0], pixels[2, 5, 0] = 1.0, 0.25  # the lower rows of an image are south
    image.pixels.foreach_set(pixels.ravel())
    entry.mask.image, entry.mask.factor = image, 0.5
    [found] = stack_now(terrain, tmp_path).entries
    kept = np.load(found.mask.image)
    assert found.mask.factor == 0.5 and kept.shape == (3, 6)
    assert (kept[2, :2] == 1.0).all() and kept[0, 5] == 0.25 and kept.sum() == 2.25, "the first row is north"
    entry.mask.kind = "OBJECT"
    with pytest.raises(session.TerrainError, match="masked by an object, and none is chosen"):
        session.update_object(terrain)
    entry.mask.object = terrain
    with pytest.raises(session.TerrainError, match="is masked by the terrain itself"):
        session.update_object(terrain)
    entry.mask.object = new_object("Patch", [(0, 0, 5), (640, 0, 9), (640, 320, 0), (0, 320, 0)])
    kept = np.load(stack_now(terrain, tmp_path).entries[0].mask.image)
    assert kept.shape == (512, 512) and kept[:256, 256:].mean() == pytest.approx(0.5, abs=0.01)
    assert kept[256:].max() == 0.0 and kept[:, :255].max() == 0.0, "only the north-eastern quarter, its southern half"
    assert kept[:127].max() == 0.0 and kept[130:255, 258:].min() == 1.0
    session.update_object(terrain)


def test_a_shadow_is_the_part_that_is_covered():
    """Of a triangle: its area, from points that no triangle rule was written for."""
    triangle = np.array([[[-30.0, -20.0], [45.0, -10.0], [5.0, 28.0]]])
    (ax, ay), (bx, by), (cx, cy) = triangle[0]
    area = abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2
    found = land_masks.rasterize_shadow(triangle, (100.0, 60.0))
    assert found.shape == (308, 512) and found.sum() * (100.0 / 512) * (60.0 / 308) == pytest.approx(area, rel=2e-3)
    assert land_masks.rasterize_shadow(triangle[:, ::-1], (100.0, 60.0)).tobytes() == found.tobytes()
    assert land_masks.rasterize_shadow(triangle + 500.0, (100.0, 60.0)).max() == 0.0


def test_a_right_angle_is_a_limit_of_slopes(terrain, tmp_path):
    """In Blender's float32 it is a little more than 90 degrees."""
    slope = add("scree").mask.slope
    terrain.adaptive_terrain.land.entries[0].mask.kind, slope.use, slope.low = "RULE", True, np.pi / 2
    [rule] = stack_now(terrain, tmp_path).entries[0].mask.rules
    assert (rule.low, rule.high) == (90.0, np.inf)
    slope.high = 0.0
    with pytest.raises(session.TerrainError, match="slope from 90 to 0; expected a low limit below the high one"):
        session.update_object(terrain)


def test_a_mask_by_rules_about_anything_that_the_ground_has(terrain, tmp_path):
    """Each rule of the menu is one of the stack, with its limits in the stack's units, and comes back from a file."""
    entry = add("scree")
    entry.mask.kind = "RULE"
    for of in land_properties.RULES:
        assert bpy.ops.adaptive_terrain.land_rule_add(of=of) == {"FINISHED"}
        getattr(entry.mask, of).low = 0.25
    rules = stack_now(terrain, tmp_path).entries[0].mask.rules
    assert {rule.of for rule in rules} == set(LIMITS) - {"aspect"}
    for rule in rules:
        assert rule.low == pytest.approx(np.degrees(0.25) if rule.of == "slope" else 0.25)
    kept = land_stack.preset_of(terrain.adaptive_terrain.land)
    entry.mask.kind = "NONE"
    assert land_stack.fill(terrain.adaptive_terrain.land, kept) == []
    assert stack_now(terrain, tmp_path).entries[0].mask.rules == rules
    only = terrain.adaptive_terrain.land.entries[0].mask
    for of in land_properties.RULES:
        getattr(only, of).use = of == "sediment"
    with pytest.raises(session.TerrainError, match="about sediment, which is not there"):
        session.update_object(terrain)
    assert shaped_land.state_of(terrain).note == "Not shown: see the error above"
    add("rivers")
    assert bpy.ops.adaptive_terrain.land_move(by=-1) == {"FINISHED"}
    session.update_object(terrain)


@pytest.mark.parametrize("packed", [False, True])
def test_a_mask_that_was_cut_off_is_told_of(terrain, tmp_path, packed):
    """Blender itself reads such a file, partly black."""
    file = tmp_path / "mask.png"
    write_raster(file, np.random.default_rng(0).integers(1, 255, (90, 70)).astype(np.uint8))
    whole = file.read_bytes()
    entry = add("relief")
    for content, said in (
        (whole[: len(whole) // 2], r"is damaged \(it ends inside a chunk\); expected a whole PNG: get the file"),
        (whole[:-12], r"is damaged \(it ends before its last chunk\)"),
        (whole[:200] + b"?" + whole[201:], r"is damaged \(its chunk IDAT differs from its checksum\)"),
    ):
        file.write_bytes(content)
        image = bpy.data.images.load(str(file))
        if packed:
            image.pack()
            file.unlink()
        entry.mask.kind, entry.mask.image = "IMAGE", image
        with pytest.raises(session.TerrainError, match=said):
            session.update_object(terrain)
    file.write_bytes(whole)
    entry.mask.image = bpy.data.images.load(str(file))
    session.update_object(terrain)


@pytest.mark.parametrize("damage", [b"", b"\x93NUMPY\x01\x00\xff", b"mine"])
def test_a_damaged_mask_file_is_named(terrain, tmp_path, damage):
    entry = add("scree")
    entry.mask.kind, entry.mask.image = "IMAGE", bpy.data.images.new("Paint", 4, 4)
    [found] = stack_now(terrain, tmp_path).entries
    assert land_folder.read_mask(found.mask.image).shape == (4, 4)
    Path(found.mask.image).write_bytes(damage)
    with pytest.raises(session.TerrainError, match=r"\.npy is damaged .*: delete the file, it is written again"):
        land_folder.read_mask(found.mask.image)
