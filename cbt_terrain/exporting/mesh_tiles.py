# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh divided at straight lines, so that neighbouring parts share the vertices on them, and skirts below parts."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class TileMesh:
    """A triangle mesh. `positions`, `normals`: float32 [n, 3]. `uv`: float32 [n, 2]. `triangles`: int64 [t, 3]."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    triangles: np.ndarray

    def with_vertices(self, other: "TileMesh", triangles: np.ndarray) -> "TileMesh":
        """Return this mesh with the vertices of another one appended, and with these triangles."""
        positions = np.concatenate([self.positions, other.positions])
        normals, uv = np.concatenate([self.normals, other.normals]), np.concatenate([self.uv, other.uv])
        return TileMesh(positions, normals, uv, triangles)

    def vertices_alone(self, vertices: np.ndarray) -> "TileMesh":
        """Return some vertices, by their numbers, without triangles."""
        return TileMesh(self.positions[vertices], self.normals[vertices], self.uv[vertices], self.triangles[:0])


def split(mesh: TileMesh, axis: int, at: float) -> TileMesh:
    """Return the mesh with triangles divided that cross the line where coordinate `axis` is `at`, a float32 number.

    Each crossing edge gets one vertex, so the mesh stays welded. Vertices keep their numbers, new ones follow; the mesh
    itself is returned if no triangle crosses.
    """
    side = np.sign(mesh.positions[:, axis].astype(np.float64) - at).astype(np.int8)
    signs = side[mesh.triangles]
    crosses = (signs.min(1) < 0) & (signs.max(1) > 0)
    if not crosses.any():
        return mesh
    crossing, signs = mesh.triangles[crosses], signs[crosses]
    # Roll the corner that is on the line, or else alone on its side, to the front: `a`, followed by `b` and `c` in the
    # order of the triangle. The two on the other side decide the sum of signs, so it is the corner of opposite sign.
    alone = np.where((signs == 0).any(1), (signs == 0).argmax(1), (signs == -np.sign(signs.sum(1))[:, None]).argmax(1))
    order = (alone[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(crossing, order, 1).T
    on_line = np.take_along_axis(signs, order, 1)[:, 0] == 0
    # The edges that cross, by their vertices; two triangles with a common edge get the same new vertex.
    pairs = np.concatenate([np.stack([b, c], 1)[on_line], np.stack([a, b], 1)[~on_line], np.stack([a, c], 1)[~on_line]])
    pairs, numbers = np.unique(np.sort(pairs, 1), axis=0, return_inverse=True)
    # New vertices: p across from a corner on the line, q and r on both edges of a corner that is alone.
    p, q, r = np.split(len(mesh.positions) + numbers.reshape(-1), np.cumsum([on_line.sum(), (~on_line).sum()]))
    halves = [(a[on_line], b[on_line], p), (a[on_line], p, c[on_line])]
    a, b, c = a[~on_line], b[~on_line], c[~on_line]
    thirds = [(a, q, r), (q, b, c), (q, c, r)]
    parts = [np.stack(corners, 1) for corners in (*halves, *thirds)]
    triangles = np.concatenate([mesh.triangles[~crosses], *parts])
    return mesh.with_vertices(_cut_edges(mesh, pairs, axis, at), triangles)


def _cut_edges(mesh: TileMesh, pairs: np.ndarray, axis: int, at: float) -> TileMesh:
    """Return new vertices where edges cross the line at coordinate `at` of an axis (0 or 1), without triangles.

    pairs: the edges' vertices, int [n, 2], on both sides of the line.
    """
    ends = mesh.positions[pairs].astype(np.float64)
    fraction = ((at - ends[:, 0, axis]) / (ends[:, 1, axis] - ends[:, 0, axis]))[:, None]

    def interpolate_ends(values: np.ndarray) -> np.ndarray:
        """Interpolate values of the vertices to the places where edges are cut, float32."""
        first, last = values[pairs[:, 0]].astype(np.float64), values[pairs[:, 1]].astype(np.float64)
        return (first + fraction * (last - first)).astype(np.float32)

    positions = interpolate_ends(mesh.positions)
    positions[:, axis] = at
    return TileMesh(positions, interpolate_ends(mesh.normals), interpolate_ends(mesh.uv), mesh.triangles[:0])


def part_of(mesh: TileMesh, which: np.ndarray) -> tuple[TileMesh, np.ndarray]:
    """Return the part with the triangles `which`, by index, and the numbers of its vertices in `mesh`."""
    used, triangles = np.unique(mesh.triangles[which], return_inverse=True)
    return replace(mesh.vertices_alone(used), triangles=triangles.reshape(-1, 3)), used


def border_edges(mesh: TileMesh) -> np.ndarray:
    """Return the edges with one triangle, int64 [n, 2], in the direction of that triangle."""
    edges = np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]])
    _, first, counts = np.unique(edge_keys(edges), return_index=True, return_counts=True)
    return edges[first[counts == 1]]


def edge_keys(edges: np.ndarray) -> np.ndarray:
    """Return an integer for each edge, int64 [n], that is the same for both directions."""
    return (edges.min(1) << 32) | edges.max(1)


def with_skirt(mesh: TileMesh, edges: np.ndarray, down: np.ndarray) -> TileMesh:
    """Return the mesh with a wall below the border `edges`, two triangles each.

    edges: of `border_edges`; without any the mesh itself is returned. down: float64 [n, 3] metres, from each vertex of
    the mesh to the one below it. The wall has the normals and uv of the border.
    """
    if not len(edges):
        return mesh
    # `used`: vertices of the border. `ends`: of each edge two indices of `used`.
    used, ends = np.unique(edges, return_inverse=True)
    below = mesh.vertices_alone(used)
    below = replace(below, positions=(below.positions.astype(np.float64) + down[used]).astype(np.float32))
    lower = len(mesh.positions) + ends.reshape(-1, 2)
    # Ends of the edges, and the new vertices below them.
    (a, b), (c, d) = edges.T, lower.T
    wall = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    return mesh.with_vertices(below, np.concatenate([mesh.triangles, wall]))
