# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement of a terrain for a set of views: drives the walk and keeps to a triangle limit.

The *walk* is the kernel that refines from the root triangles, along the space-filling curve through all triangles; the
threads walk slices of the curve. Results are functions of the field and the request. The history only saves time:
`last` is the frame before, `next` the one that is being made, `tree` the concurrent binary tree of the leaves, `hints`
guesses, `scratch` arrays.
"""

import math

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine import curve
from ...kernels.refine import replay as replay_kernels
from ...kernels.refine import walk as kernels
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..history.drift import CachedSubtrees
from ..history.frame import Leaves
from ..history.frame_history import FrameHistory
from ..run import launch
from ..run.buffers import shared
from ..tree.concurrent_binary_tree import LeafPart
from ..tree.saved import MIN_DEPTH
from .budget import limit_at_step, ramp_start, search
from .horizon import fill_horizons, has_rings
from .request import RefinementRequest
from .slices import Slices
from .step_search import Found

# Indices are int32, three corners a triangle; Blender cannot use larger meshes either.
MAX_TRIANGLES = 1 << 26
# Cost of a reused leaf in leaves that are found anew: 8 ns of 91, by a fit to flights of four speeds.
REUSED_COST = 0.1
# A count and a walk agree unless errors are not nested, except on step 0, which need not be counted.
MAX_SEARCHES = 2
# Relaxation factors for which horizon maps are tried, for unlimited and (index 1) for limited meshes: the first map
# that the result satisfies is used; the last hides nothing.
RELAXED = (1.0, math.inf), (4.0, 64.0, math.inf)


def refine(
    field: HeightField, request: RefinementRequest, history: FrameHistory, threads: int = 1
) -> tuple[Leaves, float]:
    """Refine from the roots and write the leaves into the next frame.

    Returns the leaves, and the factor by which the triangle limit relaxed the criterion (1: not at all). If vertices
    morph, it is the factor from which they morph. Raises TerrainError for a field whose errors are damaged.
    """
    domain, criterion, depth, morphs = request.domain, request.criterion, request.max_depth, request.morph_until > 1
    history.need_tree(field.lattice.square_bits + max(depth, MIN_DEPTH), threads)
    hides, slices = has_rings(criterion), None
    # Horizons hold for meshes up to a relaxation factor: RELAXED has factors without and with a limit; infinity hides
    # nothing.
    for relaxed in RELAXED[request.is_limited] if hides else (math.inf,):
        if hides:
            # Points morph up to the ratio `morph_until`, from a factor at most a step coarser: see `ramp_start`.
            max_factor = relaxed * (request.morph_until * math.sqrt(limit_at_step(1)) if morphs else 1.0)
            fill_horizons(field, domain, criterion, depth, max_factor, history.scratch, threads)
        slices, step = _refine_to_limit(field, request, history, threads, relaxed)
        if slices is not None:
            break
    assert slices is not None, "no limit applies to the last attempt"
    leaves, factor = _store_leaves(history, slices, field.lattice), math.sqrt(criterion.limit)  # a factor on squares
    if morphs and request.is_limited:
        factor = ramp_start(field.lattice, request, history, threads, step, leaves.total)
    return leaves, factor


def _refine_to_limit(
    field: HeightField, request: RefinementRequest, history: FrameHistory, threads: int, relaxed: float
) -> tuple[Slices | None, int]:
    """Return the finest walk over the leaves that keeps to the triangle limit, and its relaxation step.

    There is no walk (None) if that relaxes the criterion by more than `relaxed`. The step is kept in the hints, and its
    factor on squared limits in `criterion.limit`. Raises TerrainError for a field whose errors are damaged.
    """
    criterion, roots, hints = request.criterion, 2 * field.lattice.squares, history.hints
    max_leaves = max(request.max_leaves, roots)
    criterion.limit, slices = 1.0, None
    start, found = hints.step, Found(0)
    hints.step = found
    # Where the last refinement kept to the limit without relaxing, this one may, too.
    may_fit = not request.is_limited or (start is not None and start.step == 0)
    if may_fit:
        slices = _walk(field, request, history, threads, max_leaves)
    low, too_many = int(may_fit), 0  # step 0 is not searched after a walk of it
    while slices is None:
        last_relaxed = start if start and start.step else None  # step 0 is no hint for a search beyond it
        found = hints.step = search(field.lattice, request, history, threads, max_leaves, last_relaxed, low)
        criterion.limit, low = limit_at_step(found.step), found.step + 1
        if criterion.limit > relaxed * relaxed:
            break
        slices = _walk(field, request, history, threads, max_leaves, found.splits + roots)
        too_many += slices is None
        if too_many > MAX_SEARCHES:
            raise field.raster.damage("there are more leaves than its errors allow")
    return slices, found.step


def replay(
    field: HeightField, domain: Domain, depths: np.ndarray, cell_bits: int, history: FrameHistory
) -> tuple[Leaves, float]:
    """Write the leaves of a saved tree into the next frame, with the arrays that refinement writes.

    depths: uint8, bisections of a square of each of its leaves, 1 .. cell_bits, square by square without a gap. Returns
    the leaves, and the largest error of one, metres before scaling.
    """
    lattice = field.lattice
    history.need_tree(lattice.square_bits + cell_bits, threads=1)
    history.replace_leaves()
    history.hints.step = None
    history.hints.make_room(len(depths))
    slices = Slices.of(history, lattice, [0, lattice.squares << cell_bits], cell_bits, len(depths))
    worst = history.scratch.get("replay_worst", 1, wp.float32)
    launch.once(replay_kernels.replay, [domain, slices.walks[0], shared(depths, wp.uint8), worst], step="refine")
    slices.read_counts()
    return _store_leaves(history, slices, lattice), float(history.scratch.numpy("replay_worst")[0])


def _walk(
    field: HeightField,
    request: RefinementRequest,
    history: FrameHistory,
    threads: int,
    max_leaves: int,
    expected: int = 0,
) -> Slices | None:
    """Walk over the curve and write the leaves, again with larger arrays if a slice needs them.

    Subtrees of the last frame are reused where the view has hardly moved, and cached for the next one. Return the
    slices; None if there are more than `max_leaves` leaves. expected: leaves of the mesh if they were counted, so that
    one walk is enough; else 0.
    """
    domain, criterion, depth, lattice = request.domain, request.criterion, request.max_depth, field.lattice
    cuts = _cuts(history, lattice, threads)
    history.hints.make_room(expected // (len(cuts) - 1))
    # Caching does not pay for edges alone, which intervals decide fast, nor with maps of horizons, which hide other
    # ground in each frame.
    caches = criterion.view_count == 1 and criterion.error_px2 < math.inf and not criterion.view.rings.count
    view_motion = history.reuse_subtrees(domain, criterion, depth) if caches else None
    if not caches:
        history.replace_leaves()  # nothing reads the last frame's leaves, so their memory is free
    while True:
        slices = Slices.of(history, lattice, cuts, depth, max_leaves)
        slices.bind_reuse(caches, view_motion)
        inputs = [[domain, criterion, walk, reuse] for walk, reuse in zip(slices.walks, slices.reuses, strict=True)]
        launch.slices(kernels.walk, inputs, step="refine", recorded=history.next.arrays.launches)
        leaves = slices.read_counts()[:, 0]
        if leaves.sum() > max_leaves:
            return None
        if leaves.max() <= slices.capacity:
            break
        history.hints.make_room(leaves.max())
    room = slices.reuses[0].room  # subtrees that each slice may cache
    history.next.subtrees = CachedSubtrees(domain, criterion, depth, len(cuts) - 1, room) if caches else None
    history.next.reused_points = slices.reused_points() if view_motion else None
    return slices


def _cuts(history: FrameHistory, lattice: Lattice, threads: int) -> list[int]:
    """Return where the curve is cut for the threads: evenly by the cost of the last frame. No result depends on it.

    These are numbers of deepest cells, ascending, from 0 to the end of the last root square.
    """
    tree, last = history.tree, history.last.leaves
    assert tree is not None, "refine and replay have a tree"
    end = lattice.squares << tree.max_depth - lattice.square_bits
    # Numbers of squares are padded to a power of two; each unused one is a leaf, which does not count here.
    leaves = tree.leaf_count - (1 << lattice.square_bits) + lattice.squares
    if threads < 2 or leaves < launch.SLICE_ITEMS:
        return [0, end]
    leaves_before = costs = np.array([0, leaves])  # leaves before each slice of the last frame, and their cost
    if last is not None and last.total == leaves:
        leaves_before, costs = (np.cumsum([0, *by_slice]) for by_slice in (last.counts[:, 0], last.work))
    cut_leaves = np.interp(np.arange(1, threads) / threads * costs[-1], costs, leaves_before).astype(np.int64)
    heap_ids = tree.decode(np.minimum(cut_leaves, leaves - 1))
    first_cells = tree.cells_of(heap_ids).tolist()
    return [0, *sorted({cut for cut in first_cells if 0 < cut < end}), end]


def _store_leaves(history: FrameHistory, slices: Slices, lattice: Lattice) -> Leaves:
    """Store the leaves of the slices that have any as the next frame's `Leaves`, and in the tree; return them."""
    counts, walks, squares, cell_bits = slices.counts, slices.walks, lattice.squares, slices.cell_bits
    used = np.flatnonzero(counts[:, 0])  # slices that have leaves
    # Edges that each slice has on the four sides of each square. `before`: those that earlier slices have.
    sides = history.scratch.numpy("sides")[: len(walks) * 4 * squares].reshape(len(walks), squares, 4)
    code = history.next.arrays.numpy("code")
    base = np.array([w.leaf_base for w in walks], np.int64)[used]  # entry of each slice's first leaf in `code`
    starts_square = (code[base] >> curve.FIRST & 1).astype(bool)  # the slice's first leaf is the first of a square
    cells = np.array([w.first_cell for w in walks], np.int64)[used]
    # A slice whose first cells belong to the last leaf of a square begins with the next square.
    squares_of = (cells >> cell_bits) + (starts_square & (cells & ((1 << cell_bits) - 1) > 0))
    history.next.leaves = leaves = Leaves(
        counts=np.ascontiguousarray(counts[used, :3]),  # leaves, vertices, edges
        squares=squares_of.astype(np.int32),
        before=np.array([sides[:slot, q].sum(axis=0) for slot, q in zip(used, squares_of, strict=True)], np.int32),
        sides=sides.sum(axis=0),
        base=base,
        slots=used,
        work=(counts[:, 0] - (1 - REUSED_COST) * slices.reused)[used],
        stopped=bool(counts[:, 3].any()),
    )
    leaves.changed = history.set_tree(leaves, _tree_parts(history, slices, lattice), cell_bits)
    return leaves


def _tree_parts(history: FrameHistory, slices: Slices, lattice: Lattice) -> list[LeafPart]:
    """Return the leaves that the slices have written, as parts of the tree, and a part for the unused squares.

    A part is the leaves up to a cell `end` of the tree, which begins where the part before it ends.
    """
    parts, unused = slices.leaf_parts(), (1 << lattice.square_bits) - lattice.squares
    if unused and history.tree:  # each unused number of a square, up to a power of two, is a leaf: 0 bisections
        codes = shared(np.zeros(unused, np.uint16), wp.uint16)
        parts.append(LeafPart(codes, first=0, count=unused, end=history.tree.cell_count))
    return parts
