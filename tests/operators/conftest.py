# SPDX-License-Identifier: GPL-3.0-or-later
"""The fixtures for Blender are shared with the hard cases."""

from blender_scenes import add_terrain, empty, grid_surface, imports_here, preparing, scene, store  # noqa: F401
from land_scenes import first_shaped, shaped, terrain, wide_store  # noqa: F401
from store_exports import export, flight  # noqa: F401
