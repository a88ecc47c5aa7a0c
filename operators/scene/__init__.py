# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's terrains while Blender runs: their meshes, what these show, and what a render may rely on."""
