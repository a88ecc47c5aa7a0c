# SPDX-License-Identifier: GPL-3.0-or-later
"""Queries of a height field at full resolution, without a mesh.

    ground_at   heights, normals and slopes at points
    profile     heights along a line
    pick        where rays first meet the surface; nearest: along a direction, to either side
    box_range   lowest and highest height in a box
    viewshed    which samples an eye sees

All use metres in the terrain's own space, its middle at (0, 0), as positions of its mesh; heights become `height *
vertical_scale + vertical_offset` as in `Terrain.update`. The surface is the field's: bilinear or bicubic, with its
displacement; in holes there is none. Arguments that cannot be used raise a TerrainError.
"""
