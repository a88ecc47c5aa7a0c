# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender data in and out: meshes written in place, memory, cameras, evaluated objects, paths, what a scene reads."""
