# SPDX-License-Identifier: GPL-3.0-or-later
"""Decals lie where they are put, in their order, smoothed as far as the scale asks."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import decals as decals_module
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.decals import Decal, picture
from adaptive_terrain.cbt_terrain.attributes.examples import evaluate_on
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer
from adaptive_terrain.cbt_terrain.errors import TerrainError

GROUND = {"layers": (Layer("Grass"),), "colors": ((0.2, 0.4, 0.1),)}
FLAT = np.zeros((37, 37))  # of which 33 x 33 samples are evaluated
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def plain(color, alpha=1.0, tilts=False, sides=(4, 4)):
    return picture(np.broadcast_to(np.float32([*color, alpha]), (*sides, 4)), tilts)


def test_a_rotated_decal_covers_the_ground_below_it():
    corner, along, up = np.array([-60.0, -40.0]), np.array([80.0, 40.0]), np.array([-30.0, 60.0])
    decal = Decal("d", plain(RED, 0.25), tuple(corner), tuple(along), tuple(up), 0.5)
    colors = evaluate_on("color", FLAT, step=10.0, decals=(decal,), **GROUND)
    y, x = np.mgrid[-160:161:10, -160:161:10].astype(float)
    away = np.stack([x, y], 2) - corner
    u, v = ((away * side).sum(2) / (side * side).sum() for side in (along, up))  # they are at right angles
    inside = (u > 1e-9) & (u < 1 - 1e-9) & (v > 1e-9) & (v < 1 - 1e-9)
    outside = (u < -1e-9) | (u > 1 + 1e-9) | (v < -1e-9) | (v > 1 + 1e-9)
    assert inside.sum() > 30
    np.testing.assert_allclose(colors[inside], np.full((inside.sum(), 3), (0.3, 0.35, 0.0875)), atol=1e-6)
    assert (colors[outside] == np.float32((0.2, 0.4, 0.1))).all()


def test_the_last_decal_is_on_top():
    red, blue = (Decal("d", plain(color), (-50.0, -50.0), (100.0, 0.0), (0.0, 100.0)) for color in (RED, BLUE))
    for decals, top in (((red, blue), BLUE), ((blue, red), RED)):
        assert (evaluate_on("color", FLAT, step=10.0, decals=decals, **GROUND)[16, 16] == top).all()


def test_decals_are_filtered_by_scale():
    checker = np.ones((64, 48, 4), np.float32)
    checker[..., :3] = (np.indices((64, 48)).sum(0) % 2)[..., None]
    ends = (-200.0, -200.0), (400.0, 0.0), (0.0, 400.0)
    fine = Decal("d", picture(checker, False), *ends)
    colors = evaluate_on("color", FLAT, step=100.0, decals=(fine,), **GROUND)
    np.testing.assert_allclose(colors[15:18, 15:18], 0.5, atol=1e-6)
    ramp = np.ones((8, 8, 4), np.float32)
    ramp[..., :3] = ((np.arange(8) + 0.5) / 8)[None, :, None]
    colors = evaluate_on("color", FLAT, step=10.0, decals=(Decal("d", picture(ramp, False), *ends),), **GROUND)
    x = np.arange(-160, 161, 10)
    np.testing.assert_allclose(colors[16, :, 0], (x + 200) / 400, atol=1e-6)


def test_slopes_of_a_normal_decal_are_added():
    y, x = np.mgrid[0:37, 0:37] * 10.0
    slope = 0.3
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    bump = plain(0.5 + 0.5 * normal, 0.5, tilts=True)
    north = Decal("d", bump, (50.0, -50.0), (0.0, 100.0), (-100.0, 0.0))  # its columns go north
    found = evaluate_on("detail_normal", 0.25 * x, step=10.0, decals=(north,))
    wanted = np.array([-0.25, -0.5 * slope, 1.0])
    np.testing.assert_allclose(found[16, 16], wanted / np.sqrt((wanted * wanted).sum()), atol=1e-6)
    np.testing.assert_allclose(found[16, 3], np.array([-0.25, 0, 1]) / np.hypot(0.25, 1), atol=1e-6)
    colors = evaluate_on("color", FLAT, step=10.0, decals=(north,), **GROUND)
    assert (colors == np.float32((0.2, 0.4, 0.1))).all()


def test_decals_are_known_by_their_content():
    place = (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)
    one, same, other = (Decal("d", plain(color), *place) for color in (RED, RED, BLUE))
    assert one == same and hash(one) == hash(same) and one != other
    plans = [
        plan([AttributeRequest("color", ("a test",), parameters=(("decals", (decal,)),))])
        for decal in (one, same, other)
    ]
    assert plans[0] == plans[1] != plans[2]
    with pytest.raises(TerrainError, match="'d' stands upright"):
        Decal("d", plain(RED), (0.0, 0.0), (1.0, 0.0), (2.0, 0.0))


def test_a_layer_without_a_colour_is_an_error():
    with pytest.raises(TerrainError, match="1 splat layers and 2 colours"):
        evaluate_on("color", FLAT, step=10.0, layers=(Layer("Grass"),), colors=(RED, BLUE))


@pytest.mark.parametrize("tilts", [False, True])
def test_a_picture_does_not_depend_on_its_blocks(monkeypatch, tilts):
    pixels = np.random.default_rng(4).normal(0.5, 0.6, (37, 53, 4)).astype(np.float32)
    pixels[3, 5], pixels[20, 7], pixels[30, 52] = np.nan, np.inf, -np.inf
    given = pixels.copy()
    whole = picture(pixels, tilts)
    monkeypatch.setattr(decals_module, "BLOCK_VALUES", 53 * 4 * 3)  # three rows
    parts = picture(pixels, tilts)
    assert parts.digest == whole.digest and np.array_equal(pixels, given, equal_nan=True)
    assert all(np.array_equal(a, b) for a, b in zip(parts.mips, whole.mips, strict=True))
    finite = np.clip(np.nan_to_num(pixels), -1e9, 1e9)
    alpha = np.clip(finite[..., 3:], 0, 1)
    slopes = -(2 * finite[..., :2] - 1) / np.maximum(2 * finite[..., 2:3] - 1, np.float32(0.05))
    expected = np.concatenate([slopes, np.zeros_like(alpha)], axis=2) if tilts else finite[..., :3]
    assert np.allclose(parts.values, np.concatenate([expected * alpha, alpha], axis=2), rtol=1e-6, atol=0)
    padded = np.pad(parts.values, ((0, 1), (0, 1), (0, 0)), "edge").astype(np.float64)
    means = padded.reshape(19, 2, 27, 2, 4).mean(axis=(1, 3))
    assert np.abs(parts.mips[1] - means).max() <= 1e-6 * np.abs(means).max()
