# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that only a Blender mesh needs: texture coordinates per corner, and the first corner of each face."""

import warp as wp

from ..unchecked import item_at, put


@wp.kernel
def corner_uv(
    offset: wp.int32,
    uv: wp.array(dtype=wp.vec2f),
    corner_verts: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.vec2f),
):
    """Write the UV of face corner `offset + tid` to `out`: that of its vertex.

    uv: of each vertex. corner_verts: vertex of each corner.
    """
    c = wp.tid() + offset
    put(out, c, item_at(uv, item_at(corner_verts, c)))


@wp.kernel
def face_offsets(offset: wp.int32, out: wp.array(dtype=wp.int32)):
    """Write the number of the first corner of triangle `offset + tid`."""
    f = wp.tid() + offset
    put(out, f, 3 * f)
