# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the mesh of a raster ends: at its rim, and where holes are to be cut out, at those.

Holes have no signed value: a triangle in the cell of a hole may have all its corners on the hole's border, like one
beside it. So what lies in a hole is left out whole. Errors have its border refined like everything else, down to the
cells, of which no triangle reaches into two.
"""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.mesh import cut as kernels
from ..field.heightfield import HeightField
from ..refine.domain import NO_BORDER
from ..run import launch
from ..run.buffers import shared
from ..view.linear import add_up
from .cut import Room, Side, copied, cut, drop, rim


def end(surface, field: HeightField, domain: Domain, *, room: Room = copied, threads: int = 1):
    """The whole surface of the leaves cut at the rim of the raster and at its holes; `room` and the rest as in `cut`.

    Returns a Surface, and what was swapped, first things first.
    """
    surface, at_rim = cut(surface, rims(domain), room=room, threads=threads)
    if field.valid is None:
        return surface, [at_rim]
    surface, at_holes = drop(surface, in_holes(surface, field, domain, threads), room=room, threads=threads)
    return surface, [at_rim, at_holes]


def rims(domain: Domain) -> list[Side]:
    """Where the raster ends before its squares do: in the east, in the north, or nowhere."""
    axes = (domain.east, domain.west, domain.unit_x), (domain.north, domain.south, domain.unit_y)
    # Points have float32's steps, and a point where an edge is cut has those of both axes.
    rounding = 2.0 * add_up(float(np.spacing(np.float32(abs(start)))) / unit for _, start, unit in axes)
    # As the displacement places points.
    return [
        rim(axis, start + at * unit, rounding * unit) for axis, (at, start, unit) in enumerate(axes) if at != NO_BORDER
    ]


def in_holes(surface, field: HeightField, domain: Domain, threads: int = 1) -> np.ndarray:
    """bool [T]: triangles whose middle is in a hole."""
    triangles = len(surface.level)
    flags = np.zeros(triangles, bool)
    lattice, valid = field.lattice, np.ascontiguousarray(field.valid).reshape(-1)
    corner, steps = wp.vec2d(domain.west, domain.south), wp.vec2d(lattice.step_x, lattice.step_y)
    arrays = [shared(surface.positions, wp.vec3f), shared(surface.corner_verts, wp.int32), shared(valid, wp.uint8)]
    inputs = [corner, steps, lattice.width, lattice.height, *arrays, shared(flags.view(np.uint8), wp.uint8)]
    launch.spread(kernels.flag_holes, triangles, inputs, step="cut", threads=threads)
    return flags
