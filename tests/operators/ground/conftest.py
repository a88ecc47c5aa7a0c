# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of tilted terrains."""

from blender_scenes import add_terrain, empty, scene, store  # noqa: F401
from ground_scenes import askew, hills_store  # noqa: F401
