# SPDX-License-Identifier: GPL-3.0-or-later
"""The triangles of a frozen terrain as the text of a property: the meshlet level and the saved tree."""

import base64
import zlib
from contextlib import contextmanager
from functools import lru_cache

from ...cbt_terrain.errors import TerrainError

MAX_LEAVES = 1 << 26  # of a mesh, at about a byte each
AGAIN = "switch Freeze Detail off and on again"


def encode_tree(tree: bytes, meshlet: int) -> str:
    """Encode a saved tree as text for a property, in about a third of a byte per leaf.

    meshlet: level of the meshlets, needed to restore the mesh.
    """
    return f"{meshlet} {base64.b64encode(zlib.compress(tree)).decode()}"


@lru_cache(maxsize=4)  # the same at every update
def decode_tree(text: str) -> tuple[bytes, int]:
    """Return the saved tree and the meshlet level of a text by `encode_tree`.

    Raises TerrainError for another text. The tree itself is checked when it is restored.
    """
    try:
        meshlet, packed = text.split()
        max_bytes = 2 * MAX_LEAVES  # twice the largest tree, since a damaged text may claim any size
        return zlib.decompressobj().decompress(base64.b64decode(packed, validate=True), max_bytes), int(meshlet)
    except (ValueError, zlib.error):
        raise TerrainError("The frozen triangles are damaged", fix=AGAIN) from None


@contextmanager
def name_remedy():
    """Replace the error of a saved tree that does not fit the height field, of which the user knows nothing.

    The store has changed since the detail was frozen: by Undo, by an import of a copy that shares it, or by another
    path.
    """
    from ...cbt_terrain.refine.saved_leaves import OTHER_FIELD  # imports kernels

    try:
        yield
    except TerrainError as error:
        if error.code != OTHER_FIELD:
            raise
        raise TerrainError("The frozen triangles belong to other heights", fix=AGAIN) from None
