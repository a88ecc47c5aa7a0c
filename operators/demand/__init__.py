# SPDX-License-Identifier: GPL-3.0-or-later
"""Which attributes of a mesh a scene reads: the only part that knows Blender's node trees."""
