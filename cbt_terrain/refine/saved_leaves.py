# SPDX-License-Identifier: GPL-3.0-or-later
"""The leaves of a saved tree, checked against the height field that they are to refine."""

import numpy as np

from ..errors import TerrainError
from ..field.depths import depth_limit
from ..field.heightfield import HeightField
from ..field.lattice import MAX_MESHLET
from ..tree.saved import MIN_DEPTH, depths_from_bytes

OTHER_FIELD = "tree.other_field"  # code of the error of a saved tree that does not fit its height field


def depths_in_squares(tree: bytes, field: HeightField, meshlet: int) -> tuple[int, np.ndarray]:
    """Return the levels of a saved tree below a root square, and each leaf's bisections of its square, uint8 [leaves].

    Raises TerrainError unless the field, with meshlets of level `meshlet`, can have such leaves.
    """
    (max_depth, depths), lattice = depths_from_bytes(tree), field.lattice
    cell_bits = max_depth - lattice.square_bits
    num_cells = np.int64(1) << max_depth - depths.astype(np.int64)
    first_cells = np.cumsum(num_cells) - num_cells
    # The numbers after the last square, up to a power of two, are no squares.
    in_squares = first_cells < lattice.squares << max(0, cell_bits)
    depths = depths[in_squares].astype(np.int64) - lattice.square_bits
    max_bisections = depth_limit(field) - 2 * meshlet if 0 <= meshlet <= MAX_MESHLET else 0
    if not (cell_bits >= MIN_DEPTH and 1 <= depths.min() and depths.max() <= max_bisections):
        raise TerrainError(
            f"The saved tree has leaves of {depths.min()} .. {depths.max()} bisections of a square",
            expected=f"1 .. {max_bisections} for this height field with meshlets of level {meshlet}",
            fix="save it again with this height field and these settings",
            code=OTHER_FIELD,
        )
    return cell_bits, depths.astype(np.uint8)
