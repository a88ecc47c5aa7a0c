# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that meets Blender: the only house that imports bpy."""
