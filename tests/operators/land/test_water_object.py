# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Water shows water by one click, at a level that the user can change and that an update keeps."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.land.water_object import LEVEL


def levels(water) -> np.ndarray:
    """Return the heights of an object's vertices."""
    heights = np.empty(3 * len(water.data.vertices), np.float32)
    water.data.vertices.foreach_get("co", heights)
    return heights[2::3]


def ground_of(terrain) -> np.ndarray:
    from adaptive_terrain.operators.session import session

    return session.open_field(terrain.adaptive_terrain.store).heights()


def test_a_coast_has_its_sea_at_zero(scene, add_terrain):
    terrain = add_terrain()
    assert (ground_of(terrain) < 0.0).mean() > 0.01
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    [water] = terrain.children
    assert (np.abs(levels(water)) < 1e-3).mean() > 0.5 and LEVEL not in water


def test_an_update_keeps_the_chosen_level(scene, add_terrain):
    terrain = add_terrain()
    level = float(np.quantile(ground_of(terrain), 0.4))
    assert bpy.ops.adaptive_terrain.water_surface(level=level) == {"FINISHED"}
    [water] = terrain.children
    assert (np.abs(levels(water) - level) < 1e-3).mean() > 0.5
    terrain.adaptive_terrain.vertical_scale = 2.0
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    assert list(terrain.children) == [water] and water[LEVEL] == pytest.approx(level)
    assert (np.abs(levels(water) - 2.0 * level) < 2e-3).mean() > 0.5
