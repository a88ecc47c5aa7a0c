# SPDX-License-Identifier: GPL-3.0-or-later
"""The fixtures for Blender are shared with the hard cases. Children of the extension are forked."""

import forked_children
import pytest
from adaptive_terrain.cbt_terrain.run import child
from blender_scenes import add_terrain, empty, grid_surface, imports_here, preparing, scene, store  # noqa: F401
from land_scenes import first_shaped, shaped, terrain, wide_store  # noqa: F401
from store_exports import export, flight  # noqa: F401


@pytest.fixture(autouse=True)
def fork_children(monkeypatch):
    """Fork children of the extension from one process that has imported their modules."""
    monkeypatch.setattr(child, "subprocess", forked_children.SUBPROCESS)
