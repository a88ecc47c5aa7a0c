# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 62 and 69: rasters that do not fill their lattice, measured by code independent of the engine."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from own_surface import distances
from padded import raster

# Samples from west to east and from south to north.
SIZES = [(64, 64), (7, 256), (97, 33), (66, 40), (2, 3), (129, 90)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("meshlet", [0, 1])
def test_case_62_the_bound_holds_over_the_rasters_own_surface(size, meshlet):
    """For rasters of six sizes that do not fill their lattice, no point is further from the mesh than the criterion."""
    heights, found = raster(*size), []
    field = from_array(heights, 10.0, 7.0)
    for error_m in (1e9, 20.0, 4.0, 0.5):
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=error_m, meshlet=meshlet))
        far = distances(heights, 10.0, 7.0, update.surface.positions, update.surface.corner_verts)
        assert np.isfinite(far).all(), "the mesh covers all of it"
        assert far.max() <= min(update.bound_m, error_m)
        found.append(far.max() / error_m)
    assert max(found) > 0.8 or heights.size < 10, "and the bound is not wasteful"


def test_case_69_a_coarse_view_of_a_thin_raster_is_small():
    """A coarse view of 7 x 1,024 samples has 385 triangles, and one of 512 x 512 samples at most four."""
    field = from_array(raster(7, 1024), 10.0)
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1e4))
    assert update.leaves == 256 and update.triangles == 3 * 128 + 1, "the border cuts a square's two triangles to three"
    update = Terrain(from_array(raster(512, 512)), 1).update(Criterion(error_px=0.0, error_m=1e4))
    assert update.leaves == 2 and update.triangles <= 4
