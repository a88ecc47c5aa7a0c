# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a Python module, ready for terrains."""

from .export.blend_files import import_bpy


def need_bpy(what: str):
    """Return the bpy module with this extension registered. Raises TerrainError without Blender.

    what: subject of the error "... needs Blender's Python module".
    """
    bpy = import_bpy(what)
    if not hasattr(bpy.types.Object, "adaptive_terrain"):
        from . import registration

        registration.register()
    return bpy
