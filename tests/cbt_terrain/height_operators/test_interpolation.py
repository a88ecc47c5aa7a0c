# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes of a coarse level on a finer raster: no spikes at cliffs, and all detail where the change is even."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators.interpolation import add_change, interpolate
from adaptive_terrain.cbt_terrain.height_operators.preview import preview
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from land_effects import bumpy

FOOT, TOP = 100.0, 500.0
ROWS, COLUMNS = np.arange(61) / 4, np.arange(81) / 4


def cliff(rows: int, columns: int) -> np.ndarray:
    """Return a wall that crosses the samples of every coarser level at an angle."""
    east = np.arange(columns) + 0.3 * np.arange(rows)[:, None]
    return np.where(east < 0.6 * columns, np.float32(TOP), np.float32(FOOT))


def test_a_preview_has_no_spikes_at_cliffs():
    """The stack only averages heights, so that none leaves their range."""
    land = from_array(cliff(590, 601), 10.0, 10.0)
    heights = preview(land, Stack((Entry("smooth", {"sweeps": 40}),))).field.heights()
    assert FOOT - 0.01 <= heights.min() and heights.max() <= TOP + 0.01
    assert abs(heights - land.heights()).max() > 100.0


def test_an_even_change_keeps_all_detail():
    source, change = bumpy(61, 81), np.full((16, 21), np.float32(-35.0))
    found = add_change(source, source[::4, ::4], change, ROWS, COLUMNS)
    assert abs(found - (source - 35.0)).max() < 1e-3


def test_heights_stay_between_the_changes_around_them():
    """A height gets a change of its neighbourhood, or is on the changed coarse ground."""
    source = bumpy(61, 81)
    before, change = source[::4, ::4], bumpy(16, 21)[::-1]
    found = add_change(source, before, change, ROWS, COLUMNS)
    ground = interpolate(before + change, ROWS, COLUMNS)
    least, greatest = (
        np.array([[of(change[max(j - 1, 0) : j + 3, max(i - 1, 0) : i + 3]) for i in range(21)] for j in range(16)])
        for of in (np.min, np.max)
    )
    around = np.ix_(np.arange(61) // 4, np.arange(81) // 4)
    is_on_ground = abs(found - ground) < 1e-3
    is_within = (found - source >= least[around] - 1e-3) & (found - source <= greatest[around] + 1e-3)
    assert (is_on_ground | is_within).all() and 0.05 < is_on_ground.mean() < 0.95
    assert abs(found[::4, ::4] - before - change).max() < 1e-3
