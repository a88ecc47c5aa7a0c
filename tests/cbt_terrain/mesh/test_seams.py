# SPDX-License-Identifier: GPL-3.0-or-later
"""Two tiles that share a line of samples: how far their meshes may be apart there."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion

SIZE, STEP, ERROR_M = 129, 10.0, 5.0


def ground(is_smooth_in_the_east: bool) -> np.ndarray:
    """Return rough float32 heights of two tiles, which calm down east of the line that these share."""
    y, x = np.mgrid[:SIZE, : 2 * SIZE - 1]
    noise = np.random.default_rng(3).standard_normal(x.shape)
    rough = 200.0 * np.sin(x / 17.0) * np.cos(y / 13.0) + 3.0 * noise
    if is_smooth_in_the_east:
        rough[:, SIZE:] *= np.exp(-np.arange(SIZE - 1) / 20.0)
    return rough.astype(np.float32)


@pytest.mark.parametrize("is_smooth_in_the_east", [False, True])
@pytest.mark.parametrize("method", ["refine", "fit"])
def test_meshes_differ_on_the_shared_line_by_their_bounds(method, is_smooth_in_the_east):
    """Each mesh is within its bound of the samples there, so both are apart by no more than the sum."""
    heights = ground(is_smooth_in_the_east)
    samples, y = heights[:, SIZE - 1].astype(np.float64), (np.arange(SIZE) - (SIZE - 1) / 2) * STEP
    lines, bounds = [], []
    for tile, side in ((heights[:, :SIZE], 1.0), (heights[:, SIZE - 1 :], -1.0)):
        field = from_array(np.ascontiguousarray(tile), STEP)
        made = fit(field, ERROR_M) if method == "fit" else Terrain(field, 1).update(Criterion(0.0, error_m=ERROR_M))
        positions = np.asarray(made.surface.positions, np.float64)
        line = positions[positions[:, 0] == side * (SIZE - 1) / 2 * STEP]
        line = line[np.argsort(line[:, 1])]
        lines.append(np.interp(y, line[:, 1], line[:, 2]))
        bounds.append(made.bound_m)
        assert 2 < len(line) < SIZE and np.abs(lines[-1] - samples).max() <= made.bound_m <= ERROR_M * 1.01
    assert np.abs(lines[0] - lines[1]).max() <= sum(bounds)
