# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh that is being fitted: sweeps that move its vertices, and splits where that is not enough.

A triangle is beyond the bound if it is farther from the surface than a fit may leave it. Each listed triangle pushes
its corners up or down by what would reduce its error; a vertex moves by the weighted mean of its pushes.
"""

from typing import Any

import numpy as np
import warp as wp

from ...kernels.fitting import binding
from ...kernels.fitting import mesh as mesh_kernels
from ...kernels.fitting import moving as kernels
from ...kernels.fitting import splitting as refine_kernels
from ..mesh.surface import Surface
from ..run import launch
from ..run.buffers import Buffers, shared

SWEEPS = 4
# A triangle is split if its excess is this part of the largest that it touches; all are, once few are left or many
# rounds have gone.
LOCAL, FEW, MANY_ROUNDS = 0.85, 0.01, 16
MAX_ROUNDS = 64


class Sweeps:
    """A mesh that is being fitted: its triangles, and the list of those that the next sweep reads.

    `m`: the mesh for kernels. `triangles`, `vertices`: numbers of the mesh. `count`: number of listed triangles.
    `recorded`: recorded launches. `found_np`: results of the kernels `move` (listed triangles; those beyond the bound)
    and `refine` (listed triangles, triangles, vertices; then the counts that `Sweeps.refine` returns).
    """

    def __init__(self, fitter: Any, m: mesh_kernels.FitMesh, buffers: Buffers) -> None:
        """Allocate the counters that sweeps return; `bind` fills the mesh `m`, in arrays of `buffers`.

        fitter: the Fitter of the mesh, for its threads, depth and progress.
        """
        self.fitter, self.m, self.buffers = fitter, m, buffers
        self.triangles = self.vertices = self.count = 0
        self.recorded: dict = {}
        # Scratch stacks of kernels: triangles to split, and diamonds whose errors rise.
        m.splitting, m.climbing = wp.zeros(64, wp.int32, device="cpu"), wp.zeros(1024, wp.vec3i, device="cpu")
        self.found_np = np.zeros(7, np.int32)  # counts that kernels write (`_sweep`, `refine`)
        self.found = shared(self.found_np, wp.int32)

    def bind(self, surface: Surface, known: list[wp.array]) -> None:
        """Start the sweeps from a welded mesh, all of its triangles listed and none measured.

        `known`: Warp arrays of the heights and states of the vertices of earlier meshes, by sample (`_nothing_known` of
        Fitter); vertices of `surface` that were in one of them get these.
        """
        triangles, vertices = len(surface.triangles), len(surface.positions)
        if triangles + triangles // 8 > self.m.capacity:  # an eighth is left for splits
            self._reserve(2 * triangles + 1024, vertices + triangles + 1024)
        self.triangles, self.vertices, self.count, self.m.round = triangles, vertices, triangles, 0
        self.buffers.numpy("fit_corner_verts")[: 3 * triangles] = surface.corner_verts
        self.buffers.numpy("fit_level")[:triangles] = surface.level
        self.buffers.numpy("fit_active")[:triangles] = np.arange(triangles)  # the list
        self.buffers.numpy("fit_awake")[:triangles] = -1  # measured in no round
        self.mark_unmeasured(slice(None))
        self.fitter.spread(binding.place_vertices, vertices, [self.m, shared(surface.positions, wp.vec3f), *known])

    def _reserve(self, triangles: int, vertices: int) -> None:
        """Allocate arrays for this many triangles and vertices; earlier contents are lost."""
        get = self.buffers.get
        # Arrays of triangles, of their corners, and of vertices (a weighted sum and a weight each in `push`).
        for count, arrays in (
            (triangles, {"level": wp.int32, "worst": wp.float64, "seen": wp.vec3f}),
            (triangles, {"awake": wp.int32, "active": wp.int32}),
            (3 * triangles, {"corner_verts": wp.int32, "neighbours": wp.int32, "pushes": wp.vec2f}),
            (vertices, {"point": wp.vec2i, "z": wp.float32, "state": wp.uint8, "first": wp.int32, "movers": wp.int32}),
            (2 * vertices, {"push": wp.float64}),
        ):
            for name, dtype in arrays.items():
                setattr(self.m, name, get(f"fit_{name}", count, dtype))
        self.m.marks = get("fit_marks", triangles // 32 + 1, wp.uint32)  # a bit for each triangle
        self.buffers.numpy("fit_marks")[:] = 0
        self.m.capacity = triangles - 32  # to spare: `list_marked` also writes past the end of its list

    def link(self, surface: Surface) -> None:
        """Write to `m` the neighbours of the triangles across their edges, and a triangle of each vertex.

        Call it before anything is split or moved.
        """
        edges = len(surface.edges)
        first_corners = self.buffers.get("fit_side", edges, wp.int32)  # scratch: of each edge the first corner, or -1
        self.buffers.numpy("fit_side")[:edges] = -1
        inputs = [self.triangles, self.m, shared(surface.corner_edges, wp.int32), first_corners]
        launch.once(binding.link_triangles, inputs, step="fit link")

    def beyond(self) -> np.ndarray:
        """Return whether each triangle is farther from the surface than the bound, bool [T]."""
        return self.buffers.numpy("fit_worst")[: self.triangles] > self.m.bound

    def mark_unmeasured(self, which: np.ndarray | slice) -> None:
        """Mark triangles, by index or slice, as not measured, so that the next sweep measures them."""
        self.buffers.numpy("fit_worst")[: self.triangles][which] = mesh_kernels.NOT_MEASURED.value

    def sweep_and_split(self) -> None:
        """Move vertices in sweeps and split triangles by turns, until no triangle is beyond the bound.

        It ends early where a new walk of the tree would split better.
        """
        later = 0  # triangles beyond the bound that only the next walk of the tree can split
        for rounds in range(1, MAX_ROUNDS + 1):
            self.m.round = rounds
            self.fitter.tell_progress()
            beyond = self._sweep()
            # While many are beyond the bound, split only those that stand out: others may come within it by moves
            # alone.
            is_local = beyond - later > FEW * self.triangles and rounds < MANY_ROUNDS
            counts = self.refine(LOCAL if is_local else 0.0)
            later = counts["later"]
            num_changes = counts["splits"] - later + counts["pins"]  # in this mesh: splits include those that wait
            if num_changes <= later:  # the next walk is due, or nothing was beyond the bound
                break

    def _sweep(self) -> int:
        """Move the vertices up to SWEEPS times, and measure.

        Return the number of triangles beyond the bound before the last move.
        """
        for _ in range(SWEEPS):
            self._measure_pushes()
            inputs = [self.count, self.triangles, self.m, self.found]
            launch.once(kernels.move, inputs, step="fit move", recorded=self.recorded)
            self.count = int(self.found_np[0])  # triangles to measure again
            if not self.found_np[1]:  # none is beyond the bound
                break
        self._measure_pushes()
        return int(self.found_np[1])

    def _measure_pushes(self) -> None:
        """Measure the listed triangles, and how far each would push its vertices to err less."""
        work_ns = self.count * self.fitter.ns_each(self.triangles)
        pieces = min(self.fitter.threads, int(work_ns / 3e5)) or 1  # 0.3 ms each, or more
        inputs = [[*piece, self.m] for piece in launch.ranges(self.count, pieces)]  # ranges of the list, one a thread
        launch.slices(kernels.measure_pushes, inputs, step="fit pull", recorded=self.recorded)

    def refine(self, min_share: float) -> dict[str, int]:
        """Split triangles beyond the bound, or pin their vertices to the surface; return four counts by name.

        "splits": all splits; "later": those of them that only the next walk of the tree makes; "pins": vertices that
        were pinned; "deepest": triangles too coarse at the deepest level. min_share: only triangles whose distance
        beyond the bound is at least this fraction of the largest one around are split: LOCAL, or 0 for all.
        """
        self.found_np[1:3] = self.triangles, self.vertices  # before the splits; the kernel replaces them
        inputs = [self.count, self.fitter.depth, wp.float64(min_share), self.m, self.found]
        launch.once(refine_kernels.refine, inputs, step="fit refine", recorded=self.recorded)
        self.count, self.triangles, self.vertices = self.found_np[:3].tolist()
        return dict(zip(("splits", "pins", "later", "deepest"), self.found_np[3:].tolist(), strict=True))
