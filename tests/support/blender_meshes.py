# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Blender object shows, as numbers to compare."""

from invariants import assert_blender_invariants
from live_windows import positions


def digest(obj) -> tuple[int, bytes]:
    """Return the digest of a terrain's faces and coordinates; check the invariants of a mesh."""
    if len(obj.data.polygons):
        assert_blender_invariants(obj)
    return digest_alone(obj)


def digest_alone(obj) -> tuple[int, bytes]:
    """Return the `digest` of an object that may be no terrain of this file or may have been cut by a clean-up."""
    return len(obj.data.polygons), positions(obj).tobytes()
