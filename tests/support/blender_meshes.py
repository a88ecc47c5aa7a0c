# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Blender object shows, as numbers to compare."""

import numpy as np
from invariants import assert_blender_invariants


def digest(obj) -> tuple[int, bytes]:
    """Faces and coordinates of what a terrain shows; a mesh that is there keeps the invariants."""
    if len(obj.data.polygons):
        assert_blender_invariants(obj)
    return digest_alone(obj)


def digest_alone(obj) -> tuple[int, bytes]:
    """As `digest`, of an object that may be no terrain of this file or has been cut by a clean-up."""
    array = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", array)
    return len(obj.data.polygons), array.tobytes()
