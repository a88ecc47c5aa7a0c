# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain and a scatter of points on it."""

import pytest
from adaptive_terrain.operators.scatter.operators import new_scatter


@pytest.fixture
def terrain(scene, add_terrain):
    return add_terrain()


@pytest.fixture
def scatter(terrain):
    return new_scatter(terrain, 12.0)
