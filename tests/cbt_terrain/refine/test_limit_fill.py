# SPDX-License-Identifier: GPL-3.0-or-later
"""A triangle limit is used as far as equal errors allow: no other error gives a larger mesh within it."""

from dataclasses import replace

import pytest
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from fields import rough

MAP = View.look((0, -90.0, 90.0), (0, 0, 0), kind=ORTHOGRAPHIC, resolution=(960, 540), ortho_width=300.0)
METRES, PIXELS = Criterion(error_px=0, error_m=1e-3), Criterion(error_px=1e-3, shading_floor=1.0)


@pytest.mark.parametrize(("criterion", "views", "name"), [(METRES, [], "error_m"), (PIXELS, [MAP], "error_px")])
@pytest.mark.parametrize(("limit", "side"), [(3000, 129), pytest.param(20_000, 257, marks=pytest.mark.thorough)])
def test_no_error_fills_a_limit_better(criterion, views, name, limit, side):
    """Bisect the triangles as a function of the error: 0.3 % lie between the mesh and the best one.

    The limit is far below all triangles of the raster, near which many errors are equal.
    """
    terrain = Terrain(rough(side, side, 4, relief=20.0), 2)
    limited = terrain.update(replace(criterion, max_triangles=limit), views)
    fine, coarse = 1e-3, 1e-3 * limited.relaxed * 2.0
    for _ in range(40):
        middle = (fine * coarse) ** 0.5
        if terrain.update(replace(criterion, **{name: middle}), views).triangles <= limit:
            coarse = middle
        else:
            fine = middle
    best = terrain.update(replace(criterion, **{name: coarse}), views).triangles
    assert 0.997 * best <= limited.triangles <= best <= limit
    assert terrain.update(replace(criterion, **{name: fine}), views).triangles > limit
