# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes out of Blender: exports and bakes."""
