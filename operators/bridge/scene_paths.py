# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that a .blend file holds, as this machine opens them."""

import os
import re

_DRIVE = re.compile(r"^[A-Za-z]:[\\/]")


def absolute_path(text: str, library=None) -> str:
    r"""Return the absolute form of a path property, whatever system it was saved on.

    Blender on Windows saves `//terrain\store`, and `bpy.path.abspath` elsewhere takes that for one name. A backslash
    counts as a separator unless a file of exactly that name exists. A path with a drive letter names a place on another
    machine, and is returned as it is.
    """
    import bpy  # an export of .npz imports this module without Blender

    path = bpy.path.abspath(text, library=library)
    if os.sep == "\\" or "\\" not in path or _DRIVE.match(text) or os.path.lexists(path):
        return path
    return bpy.path.abspath(text.replace("\\", "/"), library=library)
