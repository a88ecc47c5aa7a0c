# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender data in and out: meshes, memory, cameras, evaluated objects, paths, attributes that a scene reads."""
