# SPDX-License-Identifier: GPL-3.0-or-later
"""The fixtures for Blender are shared with the tests of the operators."""

from blender_scenes import add_terrain, empty, grid_surface, scene, store  # noqa: F401
