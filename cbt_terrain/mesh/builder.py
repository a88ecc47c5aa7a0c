# SPDX-License-Identifier: GPL-3.0-or-later
"""From leaves to the arrays that Blender keeps: welding, meshlets, displacement."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from ...kernels.detail import displace as detail_kernels
from ...kernels.field.domain import Domain
from ...kernels.mesh import displace as displace_kernels
from ...kernels.mesh import join as join_kernels
from ...kernels.mesh import meshlet as meshlet_kernels
from ...kernels.mesh import weld as weld_kernels
from ...kernels.mesh import weld_state
from ...kernels.morph import displace as rising_kernels
from ...kernels.refine.runs import Run, Runs
from ..errors import TerrainError
from ..field import coats
from ..field.heightfield import HeightField
from ..refine.refinement import Leaves
from ..run import launch
from ..run.buffers import Buffers, bind
from ..run.memory import physical_memory
from . import borders
from .attributes import FACE, LEVEL, NORMALS, POINT, UV, Attribute
from .cut import swap
from .meshlet_template import template
from .rising import Rising, memories
from .surface import Surface

NOT_NESTED = "its errors are not nested or its heights not finite, so that triangles would not meet"
# Of memory at most, until the mesh is written: measured in Blender 4.3, which encodes normals corner by corner.
TRIANGLE_BYTES = 600
# What becomes of points; the last frame's is kept for the next one.
DISPLACED = ("positions", "normals", "uv")
KNOWN = "known"  # ... of points that rise
# Arrays of a surface whose buffers have other names, behind "leaf_" or "mesh_".
BUFFERS = {LEVEL: "level"}


class TornMesh(TerrainError):
    """Leaves do not fit together."""


@dataclass(frozen=True)
class _Meshlets:
    """What a surface of meshlets is made of."""

    domain: Domain
    leaves: int
    inner: int  # the first point that is inside of a leaf


class SurfaceBuilder:
    """Builder of surfaces, which reuses memory: once that is large enough, a build allocates no large array.

    Surfaces have read-only arrays. Memory of which one is still in use is not written again: the next build takes other
    memory, that of an earlier surface if it is free.

    `whole`: with what of their leaves reaches beyond the raster's rim.
    """

    def __init__(self, field: HeightField, buffers: Buffers, threads: int, whole: bool = False):
        self._field, self._buffers = field, buffers
        self._threads, self._whole = threads, whole
        self._weld = weld_state.Weld()
        self._coarse, self._fine = meshlet_kernels.Mesh(), meshlet_kernels.Mesh()
        self._points = displace_kernels.Points()
        self._coats = field.detail and coats.packed(field.detail, field.finest_edge, field.lattice)
        self._recorded: dict = {}
        self._shown: Leaves | _Meshlets | None = None  # whose points the positions are of
        self._risen = False  # ... which were rising
        self._swapped: list[np.ndarray] = []  # ... once these have changed places again
        self._inner_runs = Runs()

    def build(self, leaves: Leaves, domain: Domain, meshlet: int, rising: Rising | None = None) -> Surface:
        """Weld the leaves, expand them to 4**meshlet triangles each, displace the points; `rising`: not all the way.

        Raises TerrainError where a damaged field gives leaves that do not fit together or positions that are not
        finite, and for more triangles than memory holds; then nothing of a surface holds, the last one's neither.
        """
        slices = leaves.counts.tolist()
        triangles, vertices, edges = (sum(map(int, column)) for column in zip(*slices, strict=True))
        shown, self._shown = self._shown, None  # where it is interrupted, the positions are of nothing
        self._buffers.reclaim(keep=DISPLACED)
        if shown is not None:
            for swapped in reversed(self._swapped):
                for name in DISPLACED:
                    swap(self._buffers.numpy(name), swapped)
        if self._risen != (rising is not None):
            shown = None  # nothing to be copied from
        self._risen = rising is not None
        _check_memory(triangles * 4**meshlet)
        if meshlet:
            self._buffers.swap("leaf_level", "last_leaf_level")
        self._weld_slices(leaves, domain, triangles, edges)
        prefix, point, slots = "leaf_", "point", None
        # Points lie slice by slice; those of meshlets in one row, what is inside of leaves last.
        parts = [(int(base), n) for base, (_, n, _) in zip(leaves.base, slices, strict=True)]
        showing = leaves
        if meshlet:
            t = template(meshlet)
            showing = _Meshlets(domain, triangles, vertices + edges * (t.segments - 1))
            if t.inner_points and isinstance(shown, _Meshlets) and shown.domain is domain:
                slots = self._take_inside(shown, showing, t.inner_points)
            triangles, vertices, edges = self._expand(parts, triangles, vertices, edges, t)
            prefix, point = "mesh_", "mesh_point"
            parts = [(0, showing.inner), (showing.inner, vertices - showing.inner)]
        elif shown is not None and leaves.after is shown:
            slots = self._take_points(leaves)
        pieces = self._pieces(vertices) if meshlet or len(parts) == 1 else 1
        self._displace(parts, pieces, domain, point, slots, rising, meshlet)
        memory = self._buffers.numpy
        surface = Surface(
            memory("positions")[:vertices],
            memory(prefix + "corner_verts")[: 3 * triangles],
            memory(prefix + "corner_edges")[: 3 * triangles],
            memory(prefix + "edges")[:edges],
            {
                NORMALS: Attribute(memory("normals")[:vertices], POINT),
                UV: Attribute(memory("uv")[:vertices], POINT),
                LEVEL: Attribute(memory(prefix + "level")[:triangles], FACE),
            },
        )
        if not self._whole:
            surface = self._end(surface, domain, prefix)
        self._shown = showing
        names = {name: _buffer_of(name, prefix) for name in surface.arrays()}
        return surface.with_arrays({n: self._buffers.lend(names[n], len(a)) for n, a in surface.arrays().items()})

    def _end(self, surface: Surface, domain: Domain, prefix: str) -> Surface:
        """Cut it at the rim and at holes, in the builder's memory: the points of the leaves are there again once what
        was swapped is swapped back."""

        def room(name: str, _array: np.ndarray, count: int) -> np.ndarray:
            return self._buffers.extend(_buffer_of(name, prefix), count)

        surface, self._swapped = borders.end(surface, self._field, domain, room=room, threads=self._threads)
        return surface

    def _weld_slices(self, leaves: Leaves, domain: Domain, triangles: int, edges: int) -> None:
        """Number vertices and edges along the curve, each slice from its exact base, and join the slices."""
        get, w = self._buffers.get, self._weld
        slices, squares = len(leaves.counts), domain.columns * domain.rows
        self._check_sides(leaves.sides.reshape(domain.rows, domain.columns, 4))
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
            side_level=get("side_level", int(ends[2 * squares]), wp.int32),
            corners=get("corners", 2 * squares, wp.int32),
            stack=get("weld_stack", 2 * room, wp.vec2i),
            stack_level=get("weld_stack_level", 2 * room, wp.int32),
            imports=get("imports", 2 * room, wp.vec2i),
            fixes=get("fixes", room, wp.int32),
            state=get("weld_state", (slices + 1) * weld_state.STATE_SIZE, wp.int32),
            **self._mesh_arrays("leaf_", triangles, edges),
        )
        launch.slices(weld_kernels.weld, [[k, w] for k in range(slices)], step="weld", recorded=self._recorded)
        if slices > 1:
            open_edges, found = get("open_edges", 2 * room, wp.vec2i), get("found", 2 * room, wp.vec2i)
            open_level = get("open_level", 2 * room, wp.int32)
            inputs = [slices, room, w, open_edges, open_level, found]
            launch.once(join_kernels.join, inputs, step="weld", recorded=self._recorded)
        state = self._buffers.numpy("weld_state")[: slices * weld_state.STATE_SIZE].reshape(slices, -1)
        entered, left = state[:, weld_state.FIRST_LEVEL], state[:, weld_state.LAST_LEVEL]
        torn = state[:, weld_state.TORN].any() or entered[0] or left[-1] or (entered[1:] != left[:-1]).any()
        # What a single slice would ask of earlier ones nobody has.
        if torn or (slices == 1 and state[0, weld_state.IMPORTS]):
            raise TornMesh(str(self._field.damage(NOT_NESTED)))

    def _check_sides(self, sides: np.ndarray) -> None:
        """Every square takes as many edges of a side as its neighbour gives; sides int32 [rows, columns, 4]."""
        left, below, right, above = np.moveaxis(sides, 2, 0)
        if (left[:, 1:] != right[:, :-1]).any() or (below[1:] != above[:-1]).any():
            raise TornMesh(str(self._field.damage(NOT_NESTED)))

    def _expand(
        self, parts: list[tuple[int, int]], leaves: int, vertices: int, edges: int, t: meshlet_kernels.Template
    ) -> tuple[int, int, int]:
        """Every leaf to the template's triangles; returns how many triangles, vertices and edges there are."""
        get, coarse, fine = self._buffers.get, self._coarse, self._fine
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
        both = zip(launch.ranges(edges, pieces), launch.ranges(leaves, pieces), strict=True)
        inputs = [
            [*of_edges, *of_leaves, k * room, t, coarse, fine, numbers] for k, (of_edges, of_leaves) in enumerate(both)
        ]
        launch.slices(meshlet_kernels.expand, inputs, step="meshlets", recorded=self._recorded)
        return triangles, all_vertices, all_edges

    def _take_points(self, leaves: Leaves) -> list[int]:
        """Have the points of leaves that were taken from the last frame copied; returns each slice's list of runs."""
        before = leaves.after
        self._take(leaves.taken, before.base, np.cumsum([0, *before.counts[:-1, 1]]))
        return leaves.slots.tolist()

    def _take_inside(self, before: "_Meshlets", now: "_Meshlets", points: int) -> list[int]:
        """As `_take_points`, of what is inside of leaves that are in both, so many points each; returns the list of all
        other points and that of these."""
        get, runs = self._buffers.get, self._inner_runs
        room = min(before.leaves, now.leaves)
        bind(runs, runs=get("inner_runs", room, Run), counts=get("inner_run_counts", 1, wp.int64), room=room, lists=1)
        levels = [get(name, 1, wp.int32) for name in ("last_leaf_level", "leaf_level")]
        inputs = [before.leaves, now.leaves, *levels, before.inner, now.inner, points, runs.runs, runs.counts]
        launch.once(meshlet_kernels.points_that_stay, inputs, step="meshlets", recorded=self._recorded)
        nothing = np.zeros(1, np.int64)
        self._take(runs, nothing, nothing)
        return [1, 0]

    def _take(self, runs: Runs, base: np.ndarray, first: np.ndarray) -> None:
        """Have runs of points copied from the last frame, in which slices' points lie from `base` on and have numbers
        from `first` on."""
        for name in (*DISPLACED, KNOWN):
            self._buffers.swap(name, "last_" + name)
        get = self._buffers.get
        bind(
            self._points,
            taken=runs,
            last_base=self._table("last_slice_base", base, wp.int64),
            last_vertex=self._table("last_slice_vertex", first, wp.int64),
            last_slices=len(base),
            last_positions=get("last_positions", 1, wp.vec3f),
            last_normals=get("last_normals", 1, wp.vec3f),
            last_uv=get("last_uv", 1, wp.vec2f),
        )

    def _displace(
        self,
        parts: list[tuple[int, int]],
        pieces: int,
        domain: Domain,
        point: str,
        slots: list[int] | None,
        rising: Rising | None,
        meshlet: int,
    ) -> None:
        """Positions, normals and uv of points that lie in parts (base, count), each part in so many pieces.

        `slots`: each part's list of the runs that are copied from the last frame; None where nothing is.
        """
        get, p, vertices = self._buffers.get, self._points, sum(int(n) for _, n in parts)
        if slots is None:
            bind(p, taken=_no_runs())
            slots = [0] * len(parts)
        bind(
            p,
            point=get(point, 0, wp.vec2i),
            positions=get("positions", vertices, wp.vec3f),
            normals=get("normals", vertices, wp.vec3f),
            uv=get("uv", vertices, wp.vec2f),
            not_finite=get("not_finite", 1, wp.int32),
        )
        inputs, first = [], 0
        for (base, n), slot in zip(parts, slots, strict=True):
            inputs += [[*piece, base, first, slot, domain, p] for piece in launch.ranges(n, pieces)]
            first += n
        not_finite = self._buffers.numpy("not_finite")
        not_finite[0] = 0
        kernel = displace_kernels.displace
        if rising:
            packed = rising.pack(self._coats, meshlet, vertices, self._buffers)
            scratch = memories(self._buffers, len(inputs))
            kernel = rising_kernels.displace_rising
            inputs = [[*values, packed, own] for values, own in zip(inputs, scratch, strict=True)]
        elif self._coats:
            kernel, inputs = detail_kernels.displace_detail, [[*values, self._coats] for values in inputs]
        launch.slices(kernel, inputs, step="displace", recorded=self._recorded)
        if not_finite[0]:
            raise self._field.damage("it has heights that are not finite or too large for a mesh")

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


def _buffer_of(array: str, prefix: str) -> str:
    """Return the name of the buffer that an array of a surface is in."""
    return array if array in DISPLACED else prefix + BUFFERS.get(array, array)


@cache
def _no_runs() -> Runs:
    """Nothing known of two streams."""
    runs = Runs()
    runs.runs, runs.counts = wp.zeros(1, dtype=Run, device="cpu"), wp.zeros(1, dtype=wp.int64, device="cpu")
    runs.room = 1
    return runs


def _check_memory(triangles: int) -> None:
    """Refuse what the system would kill the process for, which is Blender."""
    most = physical_memory() * 3 // 4 // TRIANGLE_BYTES
    if triangles > most:
        raise TerrainError(
            f"The mesh would have {triangles:,} triangles, expected {most:,} at most, which this machine's memory "
            "holds: ask for a larger error, or limit its triangles."
        )
