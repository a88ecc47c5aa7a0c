# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement: positions, normals and uv of a frame's points. Points that the last frame had are copied.

A run is a sequence of points that is contiguous in both frames. Points are stored in slices, one for each thread of the
walk; a slice has a list of runs. `history` owns the arrays of the last and the next frame.
"""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.detail import displace as detail_kernels
from ...kernels.field.domain import Domain
from ...kernels.mesh import displace as displace_kernels
from ...kernels.mesh import meshlet as meshlet_kernels
from ...kernels.morph import displace as morph_kernels
from ...kernels.refine.runs import Run, Runs
from ..field.heightfield import HeightField
from ..history.frame import Vertices
from ..history.frame_history import FrameHistory
from ..run import launch
from ..run.buffers import bind
from .geomorph import Geomorph, thread_memories


def displace(
    field: HeightField,
    domain: Domain,
    history: FrameHistory,
    point: wp.array,
    parts: list[tuple[int, int]],
    pieces: int,
    slots: list[int] | None,
    geomorph: Geomorph | None,
    meshlet: int,
) -> None:
    """Displace the points in parts (first entry, number) of the array `point`, each part in `pieces` pieces.

    The results are the next frame's arrays "positions", "normals" and "uv", part after part without gaps. `slots`:
    number of each part's list of runs, which `reuse_points` or `reuse_inner_points` has bound; None if nothing is
    copied. geomorph: parameters of points that morph, None without. meshlet: leaves are drawn as 4**meshlet triangles.
    Raises TerrainError if a damaged field gives positions that are not finite.
    """
    arrays, scratch, vertices = history.next.arrays, history.scratch, sum(int(n) for _, n in parts)
    displaced = arrays.struct(displace_kernels.DisplacedPoints)
    if slots is None:
        bind(displaced, reused=_no_runs())
        slots = [0] * len(parts)
    bind(
        displaced,
        point=point,
        positions=arrays.get("positions", vertices, wp.vec3f),
        normals=arrays.get("normals", vertices, wp.vec3f),
        uv=arrays.get("uv", vertices, wp.vec2f),
        not_finite=scratch.get("not_finite", 1, wp.int32),
    )
    inputs, first = [], 0
    for (base, n), slot in zip(parts, slots, strict=True):
        inputs += [[*piece, base, first, slot, domain, displaced] for piece in launch.ranges(n, pieces)]
        first += n
    not_finite = scratch.numpy("not_finite")
    not_finite[0] = 0
    kernel, detail = displace_kernels.displace, field.packed_detail
    if geomorph:
        packed = geomorph.pack(detail, meshlet, vertices, history)
        kernel, memory = morph_kernels.displace_morphing, thread_memories(scratch, len(inputs))
        inputs = [[*values, packed, m] for values, m in zip(inputs, memory, strict=True)]
    elif detail:
        kernel, inputs = detail_kernels.displace_detail, [[*values, detail] for values in inputs]
    launch.slices(kernel, inputs, step="displace", recorded=arrays.launches)
    if not_finite[0]:
        raise field.raster.damage("it has heights that are not finite or too large for a mesh")


def reuse_points(history: FrameHistory) -> list[int]:
    """Prepare `displace` to copy the runs of points that the walk has found again in the last frame.

    Return the number of each slice's list of runs.
    """
    leaves, before = history.next.leaves, history.last.leaves
    assert leaves is not None and before is not None, "points are reused from a frame to the next"
    vertices = before.counts[:, 1]  # of each slice in the last frame
    first_vertex = np.cumsum([0, *vertices[:-1]])
    _bind_last_points(history, history.next.reused_points, base=before.base, first=first_vertex)
    return leaves.slots.tolist()


def reuse_inner_points(history: FrameHistory, now: Vertices, points: int) -> list[int]:
    """Prepare `displace` to copy the `points` inside each leaf that both frames have, from the last frame.

    now: the vertices of the next frame. points: their number inside a leaf. Return the `slots` of `displace` for its
    two parts: 1, which has no list, for the points on corners and edges of leaves, which are not copied; 0 for the
    points inside leaves.
    """
    scratch, before = history.scratch, history.last.vertices
    assert before is not None, "points are reused from the last frame"
    runs, room = scratch.struct(Runs, slot=1), min(before.leaves, now.leaves)
    bind(runs, runs=scratch.get("inner_runs", room, Run), counts=scratch.get("inner_run_counts", 1, wp.int64))
    bind(runs, room=room, lists=1)
    levels = [frame.arrays.get("leaf_level", 1, wp.int32) for frame in (history.last, history.next)]  # 1: any size
    firsts = before.first_inner, now.first_inner
    inputs = [before.leaves, now.leaves, *levels, *firsts, points, runs.runs, runs.counts]
    launch.once(meshlet_kernels.find_common_points, inputs, step="meshlets", recorded=history.next.arrays.launches)
    zero = np.zeros(1, np.int64)  # the points of meshlets are in one row
    _bind_last_points(history, runs, base=zero, first=zero)
    return [1, 0]


def _bind_last_points(history: FrameHistory, runs: Runs, base: np.ndarray, first: np.ndarray) -> None:
    """Bind runs of points to copy, with the last frame's positions, normals and uv, to the arguments of `displace`.

    base: int64 [slices], first entry of each slice's points in the last frame. first: int64 [slices], number of the
    slice's first vertex there.
    """
    arrays, last = history.next.arrays, history.last.arrays
    bind(
        arrays.struct(displace_kernels.DisplacedPoints),
        reused=runs,
        last_base=history.scratch.table("last_slice_base", base, wp.int64),
        last_vertex=history.scratch.table("last_slice_vertex", first, wp.int64),
        last_slices=len(base),
        # written in the last frame, so that any size will do
        last_positions=last.get("positions", 1, wp.vec3f),
        last_normals=last.get("normals", 1, wp.vec3f),
        last_uv=last.get("uv", 1, wp.vec2f),
    )


@cache
def _no_runs() -> Runs:
    """Return lists of runs that are empty, for a frame that copies no points."""
    runs = Runs()
    runs.runs, runs.counts = wp.zeros(1, dtype=Run, device="cpu"), wp.zeros(1, dtype=wp.int64, device="cpu")
    runs.room = 1
    return runs
