# SPDX-License-Identifier: GPL-3.0-or-later
"""The leaves of a saved tree, checked against the height field that they are to refine."""

import numpy as np

from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.lattice import MAX_MESHLET
from ..tree.saved import MIN_DEPTH, depths_from_bytes
from .domain import depth_limit


def depths_in_squares(tree: bytes, field: HeightField, meshlet: int) -> tuple[int, np.ndarray]:
    """Levels below a root square of a saved tree, and how often each leaf's square was bisected: uint8 [leaves].

    Raises TerrainError unless it is of a tree over the field's squares whose leaves can be so many triangles each.
    """
    (max_depth, depths), lattice = depths_from_bytes(tree), field.lattice
    cell_bits = max_depth - lattice.square_bits
    sizes = np.int64(1) << max_depth - depths.astype(np.int64)
    depths = (
        depths[np.cumsum(sizes) - sizes < lattice.squares << max(0, cell_bits)].astype(np.int64) - lattice.square_bits
    )
    most = depth_limit(field) - 2 * meshlet if 0 <= meshlet <= MAX_MESHLET else 0
    if not (cell_bits >= MIN_DEPTH and 1 <= depths.min() and depths.max() <= most):
        raise TerrainError(
            f"The saved tree has leaves of {depths.min()} .. {depths.max()} bisections of a square, expected 1 .. "
            f"{most} with meshlets of level {meshlet}: it is of another height field or setting; save it again."
        )
    return cell_bits, depths.astype(np.uint8)
