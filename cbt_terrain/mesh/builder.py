# SPDX-License-Identifier: GPL-3.0-or-later
"""Build of a surface from leaves: welding, meshlets, displacement, and the cut at the border.

The history owns the arrays of the last and the next frame, and scratch memory. The walk has written the next frame's
leaves in slices, one for each of its threads.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.mesh import meshlet as meshlet_kernels
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..history.frame import Vertices
from ..history.frame_history import DISPLACED, FrameHistory
from ..run import launch
from ..run.buffers import Buffers, bind
from ..run.memory import physical_memory
from . import borders
from .attributes import FACE, LEVEL, NORMALS, POINT, UV, Attribute
from .displacement import displace, reuse_inner_points, reuse_points
from .geomorph import Geomorph
from .meshlet_template import template
from .surface import Surface
from .welding import mesh_arrays, weld

# Peak memory per triangle until the mesh is written, measured in Blender 4.3, which encodes normals per corner.
TRIANGLE_BYTES = 600


@dataclass(frozen=True)
class SurfaceRequest:
    """Parameters of a surface: each leaf becomes 4**meshlet triangles on the placed field of `domain`.

    `geomorph`: parameters of points that morph, None if none do. `whole`: leaves that reach beyond the border of the
    raster or into holes are not cut.
    """

    domain: Domain
    meshlet: int = 0
    geomorph: Geomorph | None = None
    whole: bool = False


def build_surface(field: HeightField, request: SurfaceRequest, history: FrameHistory, threads: int = 1) -> Surface:
    """Build the surface of the next frame's leaves in read-only arrays. Its bytes do not depend on the history.

    Memory of earlier surfaces is reused once no caller uses it, so a warm build allocates no large array.

    Raises:
        TerrainError: a damaged field gives leaves that do not fit together or positions that are not finite, or memory
            cannot hold the triangles. The caller then discards the history.
    """
    domain, meshlet, geomorph = request.domain, request.meshlet, request.geomorph
    leaves, arrays, scratch = history.next.leaves, history.next.arrays, history.scratch
    assert leaves is not None, "refine has not been called"
    triangles, vertices, edges = leaves.counts.sum(axis=0).tolist()
    tables = template(meshlet) if meshlet else None
    # Whether there are lists of runs: points that this frame and the last one have, whose vertices can be copied.
    has_runs = tables.inner_points > 0 if tables else history.next.reused_points is not None
    reuses, slots = history.reuse_vertices(domain, geomorph is not None, has_runs), None  # slots: list of each part
    _check_memory(triangles * 4**meshlet)
    weld(field, domain, history, level_in=arrays if tables else scratch)
    # The walk has stored points slice by slice. Points of meshlets are stored in one row: first those on corners and
    # edges of leaves, then those inside leaves.
    point = arrays.get("point", 0, wp.vec2i)  # 0: as large as the walk has made it
    # First entry and number of the points of each slice; with meshlets, of those two groups.
    parts = [(int(base), n) for base, n in zip(leaves.base, leaves.counts[:, 1].tolist(), strict=True)]
    prefix, built = "leaf_", Vertices(domain, geomorph is not None)
    if tables:
        built.leaves, built.first_inner = triangles, vertices + edges * (tables.segments - 1)
        if reuses:
            slots = reuse_inner_points(history, built, tables.inner_points)
        point, triangles, vertices, edges = _expand(history, parts, triangles, vertices, edges, tables, threads)
        prefix, parts = "mesh_", [(0, built.first_inner), (built.first_inner, vertices - built.first_inner)]
    elif reuses:
        slots = reuse_points(history)
    pieces = _pieces(vertices, threads) if tables or len(parts) == 1 else 1  # several slices are parallel already
    displace(field, domain, history, point, parts, pieces, slots, geomorph, meshlet)
    surface = Surface(
        arrays.numpy("positions")[:vertices],
        scratch.numpy(prefix + "corner_verts")[: 3 * triangles],
        scratch.numpy(prefix + "corner_edges")[: 3 * triangles],
        scratch.numpy(prefix + "edges")[:edges],
        {
            NORMALS: Attribute(arrays.numpy("normals")[:vertices], POINT),
            UV: Attribute(arrays.numpy("uv")[:vertices], POINT),
            LEVEL: Attribute(scratch.numpy(prefix + "level")[:triangles], FACE),
        },
    )

    def memory_of(name: str) -> tuple[Buffers, str]:
        """Return the buffers and the name in them that hold an array of the surface."""
        if name in DISPLACED:
            return arrays, name
        return scratch, prefix + ("level" if name == LEVEL else name)

    def room(name: str, _array: np.ndarray, count: int) -> np.ndarray:
        """Return the memory of an array with room for `count` items: the `Room` of the cuts."""
        buffers, buffer_name = memory_of(name)
        return buffers.extend(buffer_name, count)

    if not request.whole:
        surface, swapped = borders.cut_ends(surface, field, domain, room=room, threads=threads)
        built.swapped = [items for items in swapped if items.size]
    history.next.vertices = built
    return surface.with_arrays({n: history.lend(*memory_of(n), len(a)) for n, a in surface.arrays().items()})


def _expand(
    history: FrameHistory,
    parts: list[tuple[int, int]],
    leaves: int,
    vertices: int,
    edges: int,
    tables: meshlet_kernels.Template,
    threads: int,
) -> tuple[wp.array, int, int, int]:
    """Divide every leaf into the triangles of its meshlet, in the arrays of the next frame.

    Return the points, and the new numbers of triangles, vertices and edges. parts: first entry and number of each
    slice's points. leaves, vertices, edges: their numbers before. tables: those of a meshlet.
    """
    scratch, arrays, segments = history.scratch, history.next.arrays, tables.segments
    coarse, fine = (scratch.struct(meshlet_kernels.WeldedMesh, slot) for slot in range(2))
    triangles = leaves * tables.triangles
    all_vertices = vertices + edges * (segments - 1) + leaves * tables.inner_points
    all_edges = edges * segments + leaves * tables.inner_lines
    coarse.vertices, coarse.edge_count = vertices, edges
    point = scratch.get("mesh_point", all_vertices, wp.vec2i)
    bind(coarse, point=point, **mesh_arrays(scratch, "leaf_", leaves, edges, arrays))
    bind(fine, point=point, **mesh_arrays(scratch, "mesh_", triangles, all_edges, scratch))
    # The leaves' points come first, without gaps between slices, where edges and leaves can look them up.
    source, target, first = arrays.numpy("point"), scratch.numpy("mesh_point"), 0
    for base, count in parts:
        target[first : first + count] = source[base : base + count]
        first += count
    pieces = _pieces(triangles, threads)
    table_size = tables.points + tables.lines
    numbers = scratch.get("template_numbers", pieces * table_size, wp.int32)
    ranges = zip(launch.ranges(edges, pieces), launch.ranges(leaves, pieces), strict=True)
    inputs = [
        [*of_edges, *of_leaves, k * table_size, tables, coarse, fine, numbers]
        for k, (of_edges, of_leaves) in enumerate(ranges)
    ]
    launch.slices(meshlet_kernels.expand, inputs, step="meshlets", recorded=scratch.launches)
    return point, triangles, all_vertices, all_edges


def _pieces(items: int, threads: int) -> int:
    """Return the number of pieces for parallel work on `items` items: 1 if they are too few."""
    return threads if items >= launch.SLICE_ITEMS else 1


def _check_memory(triangles: int) -> None:
    """Raise TerrainError for a mesh so large that the system might end the process, which is Blender.

    Three quarters of the physical memory may be used.
    """
    max_triangles = physical_memory() * 3 // 4 // TRIANGLE_BYTES
    if triangles > max_triangles:
        raise TerrainError(
            f"The mesh would have {triangles:,} triangles",
            expected=f"at most {max_triangles:,}, which this machine's memory holds",
            fix="choose a larger error, or limit the number of triangles",
        )
