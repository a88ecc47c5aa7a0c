# SPDX-License-Identifier: GPL-3.0-or-later
"""Welding: from leaves in curve order to the vertices, edges and corners of one mesh."""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.mesh import join as join_kernels
from ...kernels.mesh import weld as weld_kernels
from ...kernels.mesh import weld_state
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..history.frame_history import FrameHistory
from ..run import launch
from ..run.buffers import Buffers, bind

NOT_NESTED = "its errors are not nested or its heights not finite, so that triangles would not meet"


class TornMesh(TerrainError):
    """Error of leaves that do not fit together."""


def weld(field: HeightField, domain: Domain, history: FrameHistory, level_in: Buffers) -> None:
    """Number the next frame's vertices and edges along the curve, the slices side by side; then join the slices.

    history: has the leaves that the walk wrote in slices, and owns the arrays. A slice refers to vertices and edges of
    earlier slices by negative numbers (imports), which the join replaces. The mesh is in scratch arrays that begin with
    "leaf_"; the levels of leaves are in `level_in`. Raises TornMesh where a damaged field or tree gives leaves that do
    not fit together.
    """
    leaves, scratch, arrays = history.next.leaves, history.scratch, history.next.arrays
    assert leaves is not None, "refine has not been called"
    triangles, _, edges = leaves.counts.sum(axis=0).tolist()
    slices, squares = len(leaves.counts), domain.columns * domain.rows
    _check_sides(field, leaves.sides.reshape(domain.rows, domain.columns, 4))
    # Entry in `side` of the first edge of each square's right side, then of each upper side: squares that share a side
    # look up its edges there.
    side_base = scratch.get("side_base", 2 * squares + 1, wp.int32)
    side_bases = scratch.numpy("side_base")
    side_bases[0] = 0
    np.cumsum(leaves.sides.T[2:], dtype=np.int32, out=side_bases[1 : 2 * squares + 1])
    # Each list has an entry for every leaf, and SPARE for each slice: memory is committed only as it is touched.
    list_size, sides = triangles + weld_state.SPARE * slices, int(side_bases[2 * squares])
    w = scratch.struct(weld_state.Weld)
    w.columns, w.rows = domain.columns, domain.rows
    bind(
        w,
        counts=scratch.table("slice_counts", leaves.counts, wp.int64),
        leaf_base=scratch.table("slice_base", leaves.base, wp.int64),
        squares=scratch.table("slice_squares", leaves.squares, wp.int32),
        before=scratch.table("slice_before", leaves.before, wp.int32),
        side_base=side_base,
        code=arrays.get("code", 0, wp.uint16),  # as large as the walk has made it
        side=scratch.get("side", sides, wp.vec2i),
        side_level=scratch.get("side_level", sides, wp.int32),
        corners=scratch.get("corners", 2 * squares, wp.int32),
        stack=scratch.get("weld_stack", 2 * list_size, wp.vec2i),
        stack_level=scratch.get("weld_stack_level", 2 * list_size, wp.int32),
        imports=scratch.get("imports", 2 * list_size, wp.vec2i),
        fixes=scratch.get("fixes", list_size, wp.int32),  # triangles that have an import
        state=scratch.get("weld_state", (slices + 1) * weld_state.STATE_SIZE, wp.int32),
        **mesh_arrays(scratch, "leaf_", triangles, edges, level_in),
    )
    launch.slices(weld_kernels.weld, [[k, w] for k in range(slices)], step="weld", recorded=scratch.launches)
    if slices > 1:
        open_edges, found = (scratch.get(name, 2 * list_size, wp.vec2i) for name in ("open_edges", "found"))
        open_level = scratch.get("open_level", 2 * list_size, wp.int32)
        inputs = [slices, list_size, w, open_edges, open_level, found]
        launch.once(join_kernels.join, inputs, step="weld", recorded=scratch.launches)
    state = scratch.numpy("weld_state")[: slices * weld_state.STATE_SIZE].reshape(slices, -1)
    # Each slice ends at the level at which the next one begins; the first begins, and the last ends, at 0.
    entered, left = state[:, weld_state.FIRST_LEVEL], state[:, weld_state.LAST_LEVEL]
    torn = state[:, weld_state.TORN].any() or entered[0] or left[-1] or (entered[1:] != left[:-1]).any()
    # A single slice has no earlier ones that could have the edges it looks for.
    if torn or (slices == 1 and state[0, weld_state.IMPORTS]):
        raise TornMesh(*field.raster.damage(NOT_NESTED).args)


def mesh_arrays(buffers: Buffers, prefix: str, triangles: int, edges: int, level_in: Buffers) -> dict[str, wp.array]:
    """Return the topology arrays of a mesh, and the levels of its triangles, by name.

    The levels are in `level_in`, the others in `buffers`. prefix: of their names there.
    """
    return {
        "corner_verts": buffers.get(prefix + "corner_verts", 3 * triangles, wp.int32),
        "corner_edges": buffers.get(prefix + "corner_edges", 3 * triangles, wp.int32),
        "edges": buffers.get(prefix + "edges", edges, wp.vec2i),
        "level": level_in.get(prefix + "level", triangles, wp.int32),
    }


def _check_sides(field: HeightField, sides: np.ndarray) -> None:
    """Raise TornMesh unless neighbouring squares have equal numbers of edges on the side between them.

    sides: int32 [rows, columns, 4], edges on the left, lower, right and upper side of each square.
    """
    left, below, right, above = np.moveaxis(sides, 2, 0)
    if (left[:, 1:] != right[:, :-1]).any() or (below[1:] != above[:-1]).any():
        raise TornMesh(*field.raster.damage(NOT_NESTED).args)
