# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles a frozen terrain keeps, as text that a property holds: the meshlet level and the saved tree."""

import base64
import zlib
from functools import lru_cache

from ...cbt_terrain.errors import TerrainError

MOST_LEAVES = 1 << 26  # of a mesh; a byte each, and a few more


def to_text(tree: bytes, meshlet: int) -> str:
    """About a third of a byte for each leaf of a saved tree."""
    return f"{meshlet} {base64.b64encode(zlib.compress(tree)).decode()}"


@lru_cache(maxsize=4)  # the same at every update
def from_text(text: str) -> tuple[bytes, int]:
    """The saved tree and the meshlet level. Raises TerrainError for what `to_text` has not written."""
    try:
        meshlet, packed = text.split()
        return zlib.decompressobj().decompress(base64.b64decode(packed, validate=True), 2 * MOST_LEAVES), int(meshlet)
    except (ValueError, zlib.error):
        raise TerrainError("What the terrain is frozen to is damaged: switch Freeze Detail off and on again.") from None
