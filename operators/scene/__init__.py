# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's terrains while Blender runs: their engines, their meshes and stale renders."""
