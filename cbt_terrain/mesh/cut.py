# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut of a surface where a signed value at its vertices is 0: the negative part is removed.

The value is linear over a triangle, so the cut is straight and the rest of the surface is unchanged: its bounds hold.
The border of a padded raster and the outlines that users cut are made this way.

Removed elements leave gaps, which the last elements fill. Vertices that fill a gap are swapped with the removed ones,
and the pairs are returned, so that the next frame can restore the order of the walk.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...kernels.mesh import cut as kernels
from ..run import launch
from ..run.buffers import shared
from ..view.linear import lengths
from .attributes import CORNER, EDGE, FACE, NORMALS, POINT, UV
from .surface import Surface

# Fraction of a vertex' largest coordinate in plan, 8 to 16 steps of float32. A vertex that is nearer to the cut of one
# of its edges is moved onto the line: rounding could turn the triangle between them over. New vertices that are nearer
# to each other than APART are merged.
TOLERANCE = 2.0**-20
APART = TOLERANCE / 4
TOPOLOGY = {"positions": POINT, "edges": EDGE, "corner_verts": CORNER, "corner_edges": CORNER}
# Kind of element that the values of a domain belong to, and their number per element.
ITEMS = {
    POINT: (int(kernels.VERTEX), 1),
    EDGE: (int(kernels.EDGE), 1),
    FACE: (int(kernels.TRIANGLE), 1),
    CORNER: (int(kernels.TRIANGLE), 3),
}

# Edges per vertex of a planar graph.
MAX_EDGES = 3

NONE_SWAPPED = np.empty((2, 0), np.int64)

# Allocator: (name, array, count) -> the surface's array `name` or a copy of it, with room for `count` items.
Room = Callable[[str, np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Side:
    """The side of a line that a cut keeps.

    `value`: function from positions, float32 [V, 3], to signed values, float64 [V]; each depends on its position alone.
    `known`: (array's name, column, exact value) of new vertices on the line. `tolerance`: see TOLERANCE. `rounding`:
    distance by which new vertices of earlier sides may miss this line where both lines meet in an edge.
    """

    value: Callable[[np.ndarray], np.ndarray]
    known: tuple[tuple[str, int, float], ...] = ()
    tolerance: float = TOLERANCE
    rounding: float = 0.0


def above_line(axis: int, at: float) -> Side:
    """Return the side that keeps positions whose coordinate `axis` is at least `at` metres, rounded to float32."""
    at = float(np.float32(at))
    return Side(lambda positions: np.subtract(positions[:, axis], at, dtype=np.float64), (("positions", axis, at),))


def border_side(axis: int, at: float, rounding: float) -> Side:
    """Return the side that keeps positions whose coordinate `axis` is at most `at` metres: the border, where uv is 1.

    Vertices are on the border or cells away from it, so none needs the tolerance. An edge may run through the raster's
    corner, where both borders meet: a new vertex that the cut at the other border makes there is on this border, too,
    and misses it by `rounding` at most.
    """
    at = float(np.float32(at))
    known = (("positions", axis, at), (UV, axis, 1.0))
    return Side(
        lambda positions: np.subtract(at, positions[:, axis], dtype=np.float64), known, tolerance=0.0, rounding=rounding
    )


def copy_with_room(_name: str, array: np.ndarray, count: int) -> np.ndarray:
    """Return a copy of an array in new memory with room for `count` items. _name: unused; other allocators need it."""
    larger = np.empty((count, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


def cut(
    surface: Surface, sides: Sequence[Side], *, room: Room = copy_with_room, threads: int = 1
) -> tuple[Surface, np.ndarray]:
    """Remove everything outside of `sides`; return the remaining surface and int64 [2, n]: pairs of swapped vertices.

    If all vertices are inside, the surface itself is returned. Each edge that changes sign gets one new vertex, so the
    mesh stays welded; its attributes are interpolated between the edge's ends. Elements keep their numbers, except that
    the last ones fill the gaps of removed ones. `room` allocates the larger arrays for new elements. With another
    `room` than `copy_with_room` the given arrays are overwritten; swapping the returned pairs again restores the
    vertices of `surface`. The bytes do not depend on the number of threads. `sides` should be few: each may double the
    number of triangles near the sides.
    """
    if not sides:
        return surface, NONE_SWAPPED
    values = [side.value(surface.positions) for side in sides]
    near = np.zeros(len(surface.positions), bool)
    for value in values:
        near |= value <= 0.0
    if not near.any():
        return surface, NONE_SWAPPED
    if any(side.tolerance for side in sides):  # vertices that are moved onto the line may be removed, too
        near[surface.triangles[_triangles_near(near, surface.corner_verts, threads)]] = True
    work = _Work(surface, near, len(sides), room, threads)
    for side, value in zip(sides, values, strict=True):
        work.cut(side, value)
    return work.close()


def drop_triangles(
    surface: Surface, triangles: np.ndarray, *, room: Room = copy_with_room, threads: int = 1
) -> tuple[Surface, np.ndarray]:
    """Remove flagged triangles, bool [T]; return the remaining surface and int64 [2, n]: pairs of swapped vertices.

    The last elements fill the gaps of removed ones. room: allocates the larger arrays for new elements; another one
    than `copy_with_room` overwrites the given arrays.
    """
    if not triangles.any():
        return surface, NONE_SWAPPED
    near = np.zeros(len(surface.positions), bool)
    near[surface.triangles[triangles]] = True
    work = _Work(surface, near, sides=0, room=room, threads=threads)
    launch.once(kernels.remove_flagged, [shared(triangles.view(np.uint8), wp.uint8), work.m], step="cut")
    return work.close()


class _Work:
    """A surface that is being cut, in arrays with room for new elements.

    `items`: entry of ITEMS for each array by name; `arrays`, and `rows` with one row per element, likewise. `before`:
    numbers of vertices, edges and triangles before all cuts; `counts`: those now, and of listed triangles. `m`: the
    kernels' struct, whose arrays `listed`, `value`, `ends`, `parent` and `removed` are. `corners`: vertices of the
    triangles that were listed first.
    """

    def __init__(self, surface: Surface, near: np.ndarray, sides: int, room: Room, threads: int) -> None:
        """Allocate the arrays for `sides` cuts and bind them to the kernels' struct.

        near: bool [V], vertices that may be removed or moved; triangles with such a vertex are listed, and only they
        change. It is overwritten.
        """
        self.surface = surface
        self.before = len(surface.positions), len(surface.edges), len(surface.triangles)
        # At most this number of vertices is removed, with the edges between them: as many of the last fill the gaps.
        max_removed = int(np.count_nonzero(near))
        near[max(0, len(near) - max_removed) :] = True
        near[surface.edges[max(0, len(surface.edges) - MAX_EDGES * max_removed) :]] = True
        listed = _triangles_near(near, surface.corner_verts, threads)
        self.corners = surface.triangles[listed]
        # Each side may double the listed triangles, and each triangle adds up to two vertices and two edges.
        max_new = 2 * len(listed) * ((1 << sides) - 1)
        self.counts = np.array([*self.before, len(listed)], np.int32)
        domains = TOPOLOGY | {name: a.domain for name, a in surface.attributes.items()}
        self.items = {name: ITEMS[domain] for name, domain in domains.items()}  # kind of element, and items in one
        self.arrays = {
            name: room(name, array, self.items[name][1] * (self.before[self.items[name][0]] + max_new))
            for name, array in surface.arrays().items()
        }
        self.rows = {name: self._rows(name) for name in self.arrays}
        self.value, self.ends = np.empty(self.before[0] + max_new), np.empty((max_new, 2), np.int32)
        self.parent, self.removed = np.empty(max_new, np.int32), np.zeros((3, max(self.before) + max_new), bool)
        m = self.m = kernels.Cut()
        m.corner_verts = shared(self.arrays["corner_verts"], wp.int32)
        m.corner_edges = shared(self.arrays["corner_edges"], wp.int32)
        m.edges, m.value = shared(self.arrays["edges"], wp.vec2i), shared(self.value, wp.float64)
        self.listed = copy_with_room("", listed, len(listed) + max_new)
        m.listed = shared(self.listed, wp.int32)
        m.ends, m.parent = shared(self.ends, wp.vec2i), shared(self.parent, wp.int32)
        m.removed, m.counts = shared(self.removed.view(np.uint8), wp.uint8), shared(self.counts, wp.int32)

    def _rows(self, name: str) -> np.ndarray:
        """Return a view of an array with one row for each vertex, edge or triangle."""
        array, each = self.arrays[name], self.items[name][1]
        return array[: len(array) // each * each].reshape(len(array) // each, -1)

    def cut(self, side: Side, value: np.ndarray) -> None:
        """Cut at a side: add vertices, edges and triangles with their attributes; mark the negative part as removed.

        value: float64 [V], the side's signed values of the vertices from before all cuts. side.known: (array, column,
        number) that vertices on the side get exactly; side.tolerance: rounding within which a vertex is on the side;
        side.rounding: metres by which vertices that earlier cuts made may miss it where both lines meet.
        """
        first, first_edge, first_face, _ = self.counts.tolist()
        self.value[self.corners] = value[self.corners]
        # `value` lacks the new vertices of earlier sides.
        earlier, on_line = slice(len(value), first), np.zeros(first - len(value), bool)
        if first > len(value):
            values = side.value(self.arrays["positions"][earlier])
            on_line = np.abs(values) < side.rounding
            self.value[earlier] = np.where(on_line, 0.0, values)
        if side.tolerance:
            positions = shared(self.arrays["positions"], wp.vec3f)
            launch.once(kernels.snap_to_line, [wp.float64(side.tolerance), positions, self.m], step="cut")
        launch.once(kernels.cut, [self.m], step="cut")
        end, end_edge, end_face, _ = self.counts.tolist()
        p, q = self.ends[: end - first].T  # a new vertex is where the value is 0 on the edge from p to q
        fraction = (self.value[p] / (self.value[p] - self.value[q]))[:, None]
        for name, (kind, _) in self.items.items():
            rows = self.rows[name]
            if kind == kernels.VERTEX:
                at_p, at_q = rows[p].astype(np.float64), rows[q].astype(np.float64)
                new = at_p + fraction * (at_q - at_p)
                if name == NORMALS:
                    new /= np.sqrt(np.sum(new * new, axis=1, keepdims=True))
                rows[first:end] = new
            elif kind == kernels.TRIANGLE and name not in TOPOLOGY:
                # A triangle has the same values at all three corners.
                rows[first_face:end_face] = rows[self.parent[: end_face - first_face]]
            elif name not in TOPOLOGY:  # new edges across a triangle have no edge to copy from
                rows[first_edge:end_edge] = 0
        for name, column, known in side.known:
            self.arrays[name][first:end, column] = known
            self.arrays[name][earlier, column][on_line] = known
        if side.tolerance:
            self._merge(np.arange(first_edge, end_edge))

    def _merge(self, new: np.ndarray) -> None:
        """Merge the two ends of those new edges (numbers `new`) that float32 cannot resolve, as where a sliver is cut.

        Triangles without an area are removed, and elements that become equal get one number.
        """
        edges, corners, sides = (self.rows[name] for name in ("edges", "corner_verts", "corner_edges"))
        ends_in_plan = self.arrays["positions"][edges[new], :2].astype(np.float64)
        lengths_in_plan = lengths((ends_in_plan[:, 0] - ends_in_plan[:, 1]).T)
        short = new[lengths_in_plan < APART * np.abs(ends_in_plan).max(axis=(1, 2), initial=0.0)]
        if not len(short):
            return
        listed = self.listed[: self.counts[kernels.LISTED]]
        listed = listed[~self.removed[kernels.TRIANGLE, listed]]
        removed_ends = np.unique(edges[short])
        merged = _merge_numbers(edges[short], self.counts[kernels.VERTEX])  # the vertex that each becomes
        corners[listed], used_edges = merged[corners[listed]], np.unique(sides[listed])
        edges[used_edges] = merged[edges[used_edges]]
        flat = listed[(corners[listed] == np.roll(corners[listed], 1, axis=1)).any(axis=1)]
        # Of a flat triangle's edges one is a point; the others are one edge.
        is_point = edges[sides[flat], 0] == edges[sides[flat], 1]
        equal = [
            edge_numbers[~is_collapsed]
            for edge_numbers, is_collapsed in zip(sides[flat], is_point, strict=True)
            if is_collapsed.sum() == 1
        ]
        pairs = np.array(equal, np.int64).reshape(-1, 2)
        sides[listed] = _merge_numbers(pairs, self.counts[kernels.EDGE])[sides[listed]]
        self.removed[kernels.TRIANGLE, flat] = True
        self.removed[kernels.VERTEX, np.union1d(removed_ends, corners[flat])] = True
        self.removed[kernels.EDGE, np.union1d(sides[flat], np.union1d(pairs, short))] = True

    def close(self) -> tuple[Surface, np.ndarray]:
        """Fill the gaps with the last remaining elements; return the surface and the pairs of swapped vertices."""
        launch.once(kernels.keep_used, [self.m], step="cut")
        remaining, moves, new_numbers = zip(*(self._moves(kind) for kind in range(3)), strict=True)
        inputs = [self.m, *remaining[:2], *(shared(numbers, wp.int32) for numbers in new_numbers[:2])]
        launch.once(kernels.renumber, inputs, step="cut")
        views = {}
        for name, (kind, per_element) in self.items.items():
            source, gaps = moves[kind]
            if kind == kernels.VERTEX:  # the history needs the removed ones
                swap(self.rows[name], moves[kind])
            else:
                self.rows[name][gaps] = self.rows[name].take(source, axis=0)
            views[name] = self.arrays[name][: per_element * remaining[kind]]
        attributes = {name: replace(a, array=views.pop(name)) for name, a in self.surface.attributes.items()}
        return replace(self.surface, **views, attributes=attributes), moves[kernels.VERTEX]

    def _moves(self, kind: int) -> tuple[int, np.ndarray, np.ndarray]:
        """Return how the last elements of a kind fill the gaps of removed ones: (remaining, moves, new numbers).

        remaining: number of elements that remain. moves: int64 [2, n], old and new numbers of the elements that move.
        new numbers: int32, of the elements whose old numbers are `remaining` or more; -1 for removed ones. kind:
        VERTEX, EDGE or TRIANGLE.
        """
        total = int(self.counts[kind])
        removed = np.flatnonzero(self.removed[kind, :total])
        remaining = total - len(removed)
        stays, gaps = np.flatnonzero(~self.removed[kind, remaining:total]), removed[removed < remaining]
        new_numbers = np.full(total - remaining, -1, np.int32)
        new_numbers[stays] = gaps
        return remaining, np.stack([remaining + stays, gaps]), new_numbers


def _merge_numbers(pairs: np.ndarray, count: int) -> np.ndarray:
    """Return int64 [count]: for each number the smallest one that a chain of `pairs` (int [n, 2]) joins it with."""
    joined = np.arange(count)
    for a, b in pairs.tolist():
        smaller, larger = sorted((joined[a], joined[b]))
        joined[joined == larger] = smaller
    return joined


def swap(array: np.ndarray, swapped: np.ndarray) -> None:
    """Exchange pairs of items in place, int64 [2, n]; a second call undoes it."""
    array[swapped] = array[swapped[::-1]]


def _triangles_near(near: np.ndarray, corner_verts: np.ndarray, threads: int) -> np.ndarray:
    """Return the triangles that have a flagged vertex, int32, ascending. near: bool [V]. corner_verts: int32 [3 T]."""
    triangles = len(corner_verts) // 3
    pieces = threads if triangles >= launch.SLICE_ITEMS else 1
    listed, counts = np.empty(triangles, np.int32), np.zeros(pieces, np.int32)
    arrays = [shared(near.view(np.uint8), wp.uint8), *(shared(a, wp.int32) for a in (corner_verts, listed, counts))]
    ranges = launch.ranges(triangles, pieces)
    launch.slices(kernels.list_near, [[*piece, k, *arrays] for k, piece in enumerate(ranges)], step="cut")
    return np.concatenate([listed[first : first + n] for (first, _), n in zip(ranges, counts, strict=True)])
