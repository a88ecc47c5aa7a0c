# SPDX-License-Identifier: GPL-3.0-or-later
"""From leaves to the arrays that Blender keeps: welding, meshlets, displacement."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from ..kernels import displace as displace_kernels
from ..kernels import join as join_kernels
from ..kernels import meshlet as meshlet_kernels
from ..kernels import weld as weld_kernels
from ..kernels.criterion import Domain
from . import launch
from .buffers import Buffers, shared
from .refinement import Leaves


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


def build_surface(leaves: Leaves, domain: Domain, meshlet: int, buffers: Buffers, threads: int) -> Surface:
    """Weld the leaves, expand them to meshlets, displace the points."""
    mesh, triangles = _weld(leaves, domain, buffers, threads)
    # Points were written slice by slice; expanded ones lie in a row.
    runs = [(int(base), int(n)) for base, n in zip(leaves.base, leaves.counts[:, 1], strict=True)]
    prefix = "leaf_"
    if meshlet:
        _gather_points(runs, mesh, buffers)
        mesh, triangles = _expand(mesh, triangles, meshlet, buffers, threads)
        runs, prefix = [(0, mesh.vertices)], "mesh_"
    positions = buffers.get("positions", mesh.vertices, wp.vec3f)
    normals = buffers.get("normals", mesh.vertices, wp.vec3f)
    uv = buffers.get("uv", mesh.vertices, wp.vec2f)
    first = 0
    for base, n in runs:
        inputs = [domain, base, first, mesh.point, positions, normals, uv]
        launch.spread(displace_kernels.displace, n, inputs, step="displace", threads=threads, cost=4.0)
        first += n
    memory = buffers.numpy
    return Surface(
        memory("positions")[: mesh.vertices],
        memory("normals")[: mesh.vertices],
        memory("uv")[: mesh.vertices],
        memory(prefix + "corner_verts")[: 3 * triangles],
        memory(prefix + "corner_edges")[: 3 * triangles],
        memory(prefix + "edges")[: mesh.edge_count],
        memory(prefix + "level")[:triangles],
    )


def _mesh(prefix: str, vertices: int, edges: int, triangles: int, buffers: Buffers) -> meshlet_kernels.Mesh:
    mesh = meshlet_kernels.Mesh()
    mesh.vertices, mesh.edge_count = vertices, edges
    mesh.corner_verts = buffers.get(prefix + "corner_verts", 3 * triangles, wp.int32)
    mesh.corner_edges = buffers.get(prefix + "corner_edges", 3 * triangles, wp.int32)
    mesh.edges = buffers.get(prefix + "edges", edges, wp.vec2i)
    mesh.level = buffers.get(prefix + "level", triangles, wp.int32)
    return mesh


def _weld(leaves: Leaves, domain: Domain, buffers: Buffers, threads: int) -> tuple[meshlet_kernels.Mesh, int]:
    """Number vertices and edges along the curve, each slice from its exact base, and join the slices."""
    slices, squares = len(leaves.counts), domain.columns * domain.rows
    triangles, vertices, edges = (int(n) for n in leaves.counts[:, :3].sum(axis=0))
    mesh = _mesh("leaf_", vertices, edges, triangles, buffers)
    mesh.point = buffers.get("point", 0, wp.vec2i)
    n = leaves.counts[:, 0]
    right_base = np.concatenate([[0], np.cumsum(leaves.sides[:, 2])]).astype(np.int32)
    above_base = (right_base[-1] + np.concatenate([[0], np.cumsum(leaves.sides[:, 3])])).astype(np.int32)
    first = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(leaves.counts[:, :3], axis=0)])
    # Open edges and imports of a slice are at most one and three a leaf; memory is committed as they come.
    stack_base = 2 * np.concatenate([[0], np.cumsum(n + 1)])
    import_base = np.concatenate([[0], np.cumsum(2 * n + 8)])
    fix_base = np.concatenate([[0], np.cumsum(3 * n + 8)])
    work = []
    for k in range(slices):
        w = weld_kernels.Weld()
        w.columns, w.rows, w.leaves, w.leaf_base = domain.columns, domain.rows, int(n[k]), int(leaves.base[k])
        w.triangle, w.vertex, w.edge = (int(i) for i in first[k])
        w.square, w.slot = int(leaves.squares[k]), k
        w.stack_base, w.stack_size = int(stack_base[k]), int(n[k]) + 1
        w.import_base, w.fix_base = int(import_base[k]), int(fix_base[k])
        w.code = buffers.get("code", 0, wp.uint16)
        w.before = shared(leaves.before.reshape(-1), wp.int32)
        w.right_base, w.above_base = shared(right_base, wp.int32), shared(above_base, wp.int32)
        w.side = buffers.get("side", int(above_base[-1]) + 1, wp.vec2i)
        w.corners = buffers.get("corners", 2 * squares, wp.int32)
        w.stack = buffers.get("weld_stack", int(stack_base[-1]), wp.vec2i)
        w.imports = buffers.get("imports", int(import_base[-1]), wp.vec2i)
        w.fixes = buffers.get("fixes", int(fix_base[-1]), wp.int32)
        w.ends = buffers.get("ends", slices * weld_kernels.ENDS, wp.int32)
        w.corner_verts, w.corner_edges = mesh.corner_verts, mesh.corner_edges
        w.edges, w.level = mesh.edges, mesh.level
        work.append(w)
    launch.slices(weld_kernels.weld, [[w] for w in work], step="weld")
    if slices > 1:
        s = join_kernels.Slices()
        s.count, s.joined_size = slices, triangles + 1
        rows = np.stack([leaves.squares, stack_base[:-1], n + 1, import_base[:-1]], axis=1).astype(np.int32)
        s.rows, s.starts = shared(rows, wp.vec4i), shared(leaves.starts.astype(np.int32), wp.int32)
        s.joined = buffers.get("joined", 2 * (triangles + 1), wp.vec2i)
        s.found = buffers.get("found", int(import_base[-1]), wp.vec2i)
        launch.once(join_kernels.resolve, [s, work[0]], step="weld")
        launch.slices(join_kernels.patch, [[w, s.found] for w in work], step="weld")
    return mesh, triangles


def _gather_points(runs: list[tuple[int, int]], mesh: meshlet_kernels.Mesh, buffers: Buffers) -> None:
    """Bring the slices' points into one row, where edges and leaves can look them up."""
    mesh.point = buffers.get("leaf_point", mesh.vertices, wp.vec2i)
    points, to, first = buffers.numpy("point"), buffers.numpy("leaf_point"), 0
    for base, n in runs:
        to[first : first + n] = points[base : base + n]
        first += n


def _expand(
    source: meshlet_kernels.Mesh, leaves: int, meshlet: int, buffers: Buffers, threads: int
) -> tuple[meshlet_kernels.Mesh, int]:
    """Every leaf to 4**meshlet triangles."""
    t = _template(meshlet)
    n = t.segments
    vertices = source.vertices + source.edge_count * (n - 1) + leaves * t.inner_points
    edges, triangles = source.edge_count * n + leaves * t.inner_lines, leaves * t.triangles
    out = _mesh("mesh_", vertices, edges, triangles, buffers)
    out.point = buffers.get("mesh_point", vertices, wp.vec2i)
    buffers.numpy("mesh_point")[: source.vertices] = buffers.numpy("leaf_point")[: source.vertices]
    launch.spread(
        meshlet_kernels.expand_edges, source.edge_count, [n, source, out], step="meshlets", threads=threads, cost=n / 2
    )
    pieces = threads if leaves * t.triangles >= launch.SLICE_ITEMS else 1
    cuts = [leaves * i // pieces for i in range(pieces + 1)]
    scratch = max(t.points, t.lines)
    points = buffers.get("template_points", pieces * scratch, wp.int32)
    lines = buffers.get("template_lines", pieces * scratch, wp.int32)
    launch.slices(
        meshlet_kernels.expand_leaves,
        [[cuts[k], cuts[k + 1], k * scratch, t, source, out, 2 * meshlet, points, lines] for k in range(pieces)],
        step="meshlets",
    )
    return out, triangles


@cache
def _template(meshlet: int) -> meshlet_kernels.Template:
    """What `2 meshlet` bisections make of one triangle, in barycentric coordinates of n-ths."""
    n = 1 << meshlet
    triangles = [((n, 0, 0), (0, n, 0), (0, 0, n))]
    for _ in range(2 * meshlet):
        triangles = [
            child
            for left, apex, right in triangles
            for middle in [tuple((x + y) // 2 for x, y in zip(left, right, strict=True))]
            for child in ((left, middle, apex), (apex, middle, right))
        ]
    # Side 0 runs from left to apex (no right in it), 1 from apex to right, 2 from right to left.
    sides = ((2, 1), (0, 2), (1, 0))  # (coordinate that is zero, coordinate that counts the place)
    point_of, point_class, weights = {}, [], []
    line_of, line_class, ends = {}, [], []

    def point(b: tuple[int, int, int]) -> int:
        if b not in point_of:
            point_of[b] = len(point_of)
            on = [s for s, (zero, _) in enumerate(sides) if b[zero] == 0]
            if n in b:
                point_class.append((0, b.index(n), 0))
            elif on:
                point_class.append((1, on[0], b[sides[on[0]][1]]))
            else:
                point_class.append((2, len(weights), 0))
                weights.append(b)
        return point_of[b]

    def line(p: tuple[int, int, int], q: tuple[int, int, int]) -> int:
        key = (min(p, q), max(p, q))
        if key not in line_of:
            line_of[key] = len(line_of)
            on = [s for s, (zero, _) in enumerate(sides) if p[zero] == 0 and q[zero] == 0]
            if on:
                place = sides[on[0]][1]
                line_class.append((1, on[0], min(p[place], q[place])))
            else:
                line_class.append((2, len(ends), 0))
                ends.append((point(p), point(q)))
        return line_of[key]

    corners = [[point(b) for b in triangle] for triangle in triangles]
    lines = [[line(a, b), line(b, c), line(c, a)] for a, b, c in triangles]

    def table(rows: list, dtype, columns: int) -> wp.array:
        return wp.array(
            np.array(rows, np.int32).reshape(-1, columns) if columns > 1 else np.array(rows, np.int32).ravel(),
            dtype=dtype,
            device="cpu",
        )

    t = meshlet_kernels.Template()
    t.segments, t.triangles, t.points, t.lines = n, len(triangles), len(point_of), len(line_of)
    t.inner_points, t.inner_lines = len(weights), len(ends)
    t.corners, t.sides = table(corners, wp.int32, 1), table(lines, wp.int32, 1)
    t.point_class, t.line_class = table(point_class, wp.vec3i, 3), table(line_class, wp.vec3i, 3)
    t.weights, t.ends = table(weights, wp.vec3i, 3), table(ends, wp.vec2i, 2)
    return t
