# SPDX-License-Identifier: GPL-3.0-or-later
"""The fixtures for Blender are shared with the hard cases. Children of the extension are forked."""

import pytest
from blender_scenes import add_terrain, empty, factory, grid_surface, imports_here, preparing, scene, store  # noqa: F401
from forked_children import fork, fork_children  # noqa: F401
from ground_scenes import askew, hills_store  # noqa: F401
from land_scenes import first_shaped, shaped, terrain, wide_store  # noqa: F401
from store_exports import export, flight  # noqa: F401


@pytest.fixture(scope="module", autouse=True)
def children_are_forked():
    """Fork the children of every test and of the fixtures of its module."""
    with pytest.MonkeyPatch.context() as patch:
        fork(patch)
        yield
