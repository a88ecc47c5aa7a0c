# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing into Blender's meshes."""
