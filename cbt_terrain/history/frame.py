# SPDX-License-Identifier: GPL-3.0-or-later
"""One frame: the result of an update and the arrays that the next update may reuse."""

from dataclasses import dataclass, field

import numpy as np

from ...kernels.field.domain import Domain
from ...kernels.refine.runs import Runs
from ..run.buffers import Buffers
from .drift import CachedSubtrees


@dataclass
class Leaves:
    """The leaves of one refinement in curve order, slice by slice.

    `counts` int64 [slices, 3]: leaves, vertices, edges. `squares` int32 [slices]: the square where each slice begins.
    `before` int32 [slices, 4]: edges of that square's sides in earlier slices. `sides` int32 [squares, 4]: edges of
    each square's sides. Sides are left, below, right and above. `base` int64 [slices]: first entry of each slice in the
    frame's arrays "code" and "point". `slots` int64 [slices]: rows of the walk's lists. `work` float64 [slices]: cost,
    in leaves that are found anew.
    `stopped`: whether a leaf is too coarse by the criterion and as deep as leaves may be. `changed`: whether the last
    frame has other leaves.
    """

    counts: np.ndarray
    squares: np.ndarray
    before: np.ndarray
    sides: np.ndarray
    base: np.ndarray
    slots: np.ndarray
    work: np.ndarray
    stopped: bool
    changed: bool = True

    @property
    def total(self) -> int:
        """Return the number of leaves of all slices."""
        return int(self.counts[:, 0].sum())


@dataclass
class Vertices:
    """Description of the points in a frame's arrays "positions", "normals" and "uv".

    With meshlets, `leaves` counts leaves and `first_inner` is the first vertex inside one; the array "leaf_level" has
    the leaves' levels. `swapped`: pairs of vertices that have changed places where the mesh was cut, int64 [2, n] each.
    """

    domain: Domain
    morphs: bool
    leaves: int = 0
    first_inner: int = 0
    swapped: list[np.ndarray] = field(default_factory=list)


@dataclass
class Frame:
    """The arrays of one frame and the facts that describe them.

    `key`: the arguments of the update. `subtrees`: None if none were cached. `reused_points`: runs of points that were
    in the last frame, None without any. `result`: the update.
    """

    arrays: Buffers = field(default_factory=Buffers)
    key: tuple | None = None
    leaves: Leaves | None = None
    subtrees: CachedSubtrees | None = None
    reused_points: "Runs | None" = None
    vertices: Vertices | None = None
    result: object = None

    def emptied(self) -> "Frame":
        """Return a frame in the same memory, without the result and the other facts of this one."""
        return Frame(self.arrays)
