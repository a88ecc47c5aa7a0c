# SPDX-License-Identifier: GPL-3.0-or-later
"""Digests of arrays and texts."""

import hashlib
from collections.abc import Iterable

import numpy as np


def digest_of(arrays: Iterable[np.ndarray], *texts: str) -> str:
    """Return a hex digest of arrays and texts."""
    content = hashlib.blake2b(" ".join(texts).encode(), digest_size=16)
    for array in arrays:
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()
