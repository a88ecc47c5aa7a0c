# SPDX-License-Identifier: GPL-3.0-or-later
"""From leaves to the arrays that Blender keeps: welding, meshlets, displacement."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import displace as displace_kernels
from ..kernels import join as join_kernels
from ..kernels import meshlet as meshlet_kernels
from ..kernels import weld as weld_kernels
from ..kernels import weld_state
from ..kernels.criterion import Domain
from ..kernels.smooth import displace as smooth_kernels
from . import launch
from .buffers import Buffers, bind
from .meshlet_template import template
from .refinement import Leaves
from .tree import no_runs

# What becomes of points; the last frame's is kept for the next one.
DISPLACED = ("positions", "normals", "uv")


@dataclass(frozen=True)
class Surface:
    """A welded triangle mesh; views of buffers that the next update overwrites.

    `positions` float32 [V, 3], metres in the terrain's own space. `normals` float32 [V, 3], unit length.
    `uv` float32 [V, 2]: 0 .. 1 from west to east, south to north. `corner_verts`, `corner_edges` int32 [3 T]: edge c
    of a triangle runs from its corner c to the next. `edges` int32 [E, 2]. `level` int32 [T]: bisections of a root
    square.
    """

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    corner_verts: np.ndarray
    corner_edges: np.ndarray
    edges: np.ndarray
    level: np.ndarray

    @property
    def triangles(self) -> np.ndarray:
        """int32 [T, 3]: vertices, counter-clockwise seen from above."""
        return self.corner_verts.reshape(-1, 3)


class SurfaceBuilder:
    """Builds surfaces in memory of its own: once that is large enough, a build allocates no array."""

    def __init__(self, buffers: Buffers, threads: int):
        self._buffers = buffers
        self._threads = threads
        self._weld = weld_state.Weld()
        self._coarse, self._fine = meshlet_kernels.Mesh(), meshlet_kernels.Mesh()
        self._points = displace_kernels.Points()
        self._recorded: dict = {}
        self._shown: Leaves | None = None  # whose points the positions are of

    def build(self, leaves: Leaves, domain: Domain, meshlet: int) -> Surface:
        """Weld the leaves, expand them to 4**meshlet triangles each, displace the points."""
        slices = leaves.counts.tolist()
        triangles, vertices, edges, _ = (sum(column) for column in zip(*slices, strict=True))
        prefix = "leaf_"
        self._weld_slices(leaves, domain, triangles, vertices, edges)
        # Points lie slice by slice; those of meshlets in one row.
        parts, point = [(int(base), n) for base, (_, n, _, _) in zip(leaves.base, slices, strict=True)], "point"
        if meshlet:
            triangles, vertices, edges = self._expand(parts, triangles, vertices, edges, meshlet)
            prefix, parts, point = "mesh_", [(0, vertices)], "mesh_point"
        taking = leaves.after is not None and leaves.after is self._shown
        self._displace(parts, domain, vertices, point, leaves if taking else None)
        self._shown = None if meshlet else leaves
        memory = self._buffers.numpy
        return Surface(
            memory("positions")[:vertices],
            memory("normals")[:vertices],
            memory("uv")[:vertices],
            memory(prefix + "corner_verts")[: 3 * triangles],
            memory(prefix + "corner_edges")[: 3 * triangles],
            memory(prefix + "edges")[:edges],
            memory(prefix + "level")[:triangles],
        )

    def _weld_slices(self, leaves: Leaves, domain: Domain, triangles: int, vertices: int, edges: int) -> None:
        """Number vertices and edges along the curve, each slice from its exact base, and join the slices."""
        get, w = self._buffers.get, self._weld
        slices, squares = len(leaves.counts), domain.columns * domain.rows
        side_base = get("side_base", 2 * squares + 1, wp.int32)
        ends = self._buffers.numpy("side_base")
        ends[0] = 0
        np.cumsum(leaves.sides.T[2:], dtype=np.int32, out=ends[1 : 2 * squares + 1])
        # A place in each list for every leaf, and some: memory is committed as it is touched.
        room = triangles + weld_state.SPARE * slices
        w.columns, w.rows = domain.columns, domain.rows
        bind(
            w,
            counts=self._table("slice_counts", leaves.counts, wp.int64),
            leaf_base=self._table("slice_base", leaves.base, wp.int64),
            squares=self._table("slice_squares", leaves.squares, wp.int32),
            before=self._table("slice_before", leaves.before, wp.int32),
            side_base=side_base,
            code=get("code", 0, wp.uint16),
            side=get("side", int(ends[2 * squares]), wp.vec2i),
            corners=get("corners", 2 * squares, wp.int32),
            stack=get("weld_stack", 2 * room, wp.vec2i),
            imports=get("imports", 2 * room, wp.vec2i),
            fixes=get("fixes", room, wp.int32),
            state=get("weld_state", (slices + 1) * weld_state.STATE_SIZE, wp.int32),
            **self._mesh_arrays("leaf_", triangles, edges),
        )
        launch.slices(weld_kernels.weld, [[k, w] for k in range(slices)], step="weld", recorded=self._recorded)
        if slices > 1:
            open_edges, found = get("open_edges", 2 * room, wp.vec2i), get("found", 2 * room, wp.vec2i)
            launch.once(join_kernels.join, [slices, room, w, open_edges, found], step="weld", recorded=self._recorded)

    def _expand(
        self, parts: list[tuple[int, int]], leaves: int, vertices: int, edges: int, meshlet: int
    ) -> tuple[int, int, int]:
        """Every leaf to 4**meshlet triangles; returns how many triangles, vertices and edges there are."""
        get, t, coarse, fine = self._buffers.get, template(meshlet), self._coarse, self._fine
        n = t.segments
        triangles = leaves * t.triangles
        all_vertices = vertices + edges * (n - 1) + leaves * t.inner_points
        all_edges = edges * n + leaves * t.inner_lines
        coarse.vertices, coarse.edge_count = vertices, edges
        point = get("mesh_point", all_vertices, wp.vec2i)
        bind(coarse, point=point, **self._mesh_arrays("leaf_", leaves, edges))
        bind(fine, point=point, **self._mesh_arrays("mesh_", triangles, all_edges))
        # The leaves' own points first, in one row, where edges and leaves can look them up.
        source, to, first = self._buffers.numpy("point"), self._buffers.numpy("mesh_point"), 0
        for base, count in parts:
            to[first : first + count] = source[base : base + count]
            first += count
        pieces = self._pieces(triangles)
        room = t.points + t.lines
        numbers = get("template_numbers", pieces * room, wp.int32)
        inputs = [
            [*_piece(edges, k, pieces), *_piece(leaves, k, pieces), k * room, t, coarse, fine, numbers]
            for k in range(pieces)
        ]
        launch.slices(meshlet_kernels.expand, inputs, step="meshlets", recorded=self._recorded)
        return triangles, all_vertices, all_edges

    def _displace(
        self, parts: list[tuple[int, int]], domain: Domain, vertices: int, point: str, taking: Leaves | None
    ) -> None:
        """Positions, normals and uv of points that lie in parts (base, count).

        `taking`: leaves some of whose points are those that the positions are of, if there are any.
        """
        get, p = self._buffers.get, self._points
        if taking:
            for name in DISPLACED:
                self._buffers.swap(name, "last_" + name)
            before = taking.after
            first = np.cumsum([0, *before.counts[:-1, 1]])
            bind(
                p,
                taken=taking.taken,
                last_base=self._table("last_slice_base", before.base, wp.int64),
                last_vertex=self._table("last_slice_vertex", first, wp.int64),
                last_slices=len(before.base),
                last_positions=get("last_positions", 1, wp.vec3f),
                last_normals=get("last_normals", 1, wp.vec3f),
                last_uv=get("last_uv", 1, wp.vec2f),
            )
        else:
            bind(p, taken=no_runs())
        slots = taking.slots.tolist() if taking else [0] * len(parts)
        pieces = self._pieces(vertices) if len(parts) == 1 else 1
        bind(
            p,
            point=get(point, 0, wp.vec2i),
            positions=get("positions", vertices, wp.vec3f),
            normals=get("normals", vertices, wp.vec3f),
            uv=get("uv", vertices, wp.vec2f),
        )
        inputs, first = [], 0
        for (base, n), slot in zip(parts, slots, strict=True):
            inputs += [[*_piece(n, k, pieces), base, first, slot, domain, p] for k in range(pieces)]
            first += n
        kernel = smooth_kernels.displace_bicubic if domain.bicubic else displace_kernels.displace
        launch.slices(kernel, inputs, step="displace", recorded=self._recorded)

    def _mesh_arrays(self, prefix: str, triangles: int, edges: int) -> dict[str, wp.array]:
        get = self._buffers.get
        return {
            "corner_verts": get(prefix + "corner_verts", 3 * triangles, wp.int32),
            "corner_edges": get(prefix + "corner_edges", 3 * triangles, wp.int32),
            "edges": get(prefix + "edges", edges, wp.vec2i),
            "level": get(prefix + "level", triangles, wp.int32),
        }

    def _table(self, name: str, values: np.ndarray, dtype) -> wp.array:
        """A small table in memory that lasts."""
        table = self._buffers.get(name, values.size, dtype)
        self._buffers.numpy(name)[: values.size] = values.reshape(-1)
        return table

    def _pieces(self, items: int) -> int:
        return self._threads if items >= launch.SLICE_ITEMS else 1


def _piece(count: int, k: int, pieces: int) -> tuple[int, int]:
    """The k-th of even pieces of a range: where it begins and ends."""
    return count * k // pieces, count * (k + 1) // pieces
