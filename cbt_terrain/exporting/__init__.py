# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles for other programs: height rasters for engines, and meshes with levels of detail for viewers of the globe."""
