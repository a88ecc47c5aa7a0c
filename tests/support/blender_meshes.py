# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Blender object shows, as numbers to compare."""

import numpy as np
from invariants import assert_blender_invariants


def digest(obj) -> tuple[int, bytes]:
    """Return the digest of a terrain's faces and coordinates; check the invariants of a mesh."""
    if len(obj.data.polygons):
        assert_blender_invariants(obj)
    return digest_alone(obj)


def digest_alone(obj) -> tuple[int, bytes]:
    """Return the `digest` of an object that may be no terrain of this file or may have been cut by a clean-up."""
    array = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", array)
    return len(obj.data.polygons), array.tobytes()
