# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends of a raster's mesh: its border and its holes.

Holes have no signed value: a triangle inside a hole may have all corners on the hole's border, as a triangle outside
may. So triangles in holes are removed whole. The errors refine a hole's border down to single cells, so no triangle
reaches into two cells there.
"""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.mesh import cut as kernels
from ..field.domain import NO_BORDER
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import shared
from ..view.linear import add_up
from .cut import Room, Side, border_side, copy_with_room, cut, drop_triangles
from .surface import Surface


def cut_ends(
    surface: Surface, field: HeightField, domain: Domain, *, room: Room = copy_with_room, threads: int = 1
) -> tuple[Surface, list[np.ndarray]]:
    """Cut the surface of all leaves at the raster's border and at its holes.

    Return a Surface, and for each cut the pairs of vertices that were swapped to fill gaps, int64 [2, n], in order: one
    cut, or two with holes. domain: the placed field. room: allocates the larger arrays; another one than the default
    overwrites those of `surface`.
    """
    surface, at_border = cut(surface, border_sides(domain), room=room, threads=threads)
    if field.valid is None:
        return surface, [at_border]
    surface, at_holes = drop_triangles(surface, in_holes(surface, field, domain, threads), room=room, threads=threads)
    return surface, [at_border, at_holes]


def border_sides(domain: Domain) -> list[Side]:
    """Return the sides on which to cut because the raster ends before its squares do: east, north, both or none."""
    # Of each axis: the border in units, the first unit's coordinate, and metres a unit.
    axes = (domain.east, domain.west, domain.unit_x), (domain.north, domain.south, domain.unit_y)
    # Positions are rounded to float32. A new vertex is on an edge, so rounding along one axis also moves it along the
    # other: the steps of both axes are added.
    rounding = 2.0 * add_up(float(np.spacing(np.float32(abs(start)))) / unit for _, start, unit in axes)
    # start + border * unit: computed as the displacement computes positions, so that its vertices are exactly on it.
    return [
        border_side(axis, start + border * unit, rounding * unit)
        for axis, (border, start, unit) in enumerate(axes)
        if border != NO_BORDER
    ]


def in_holes(surface: Surface, field: HeightField, domain: Domain, threads: int) -> np.ndarray:
    """Return whether the centroid of each triangle is in a hole, bool [T].

    field: one with holes, so that `valid` is not None. domain: the placed field.
    """
    triangles = len(surface.level)
    flags = np.zeros(triangles, bool)
    lattice, valid = field.lattice, np.ascontiguousarray(field.valid).reshape(-1)
    corner, steps = wp.vec2d(domain.west, domain.south), wp.vec2d(lattice.step_x, lattice.step_y)
    arrays = [shared(surface.positions, wp.vec3f), shared(surface.corner_verts, wp.int32), shared(valid, wp.uint8)]
    inputs = [corner, steps, lattice.width, lattice.height, *arrays, shared(flags.view(np.uint8), wp.uint8)]
    launch.spread(kernels.flag_holes, triangles, inputs, step="cut", threads=threads)
    return flags
