# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a mosaic's extent that files cover, as a text in the report of its import.

A store has no marks of filled samples, so this alone tells where its files are.
"""

import numpy as np

COVERED = "covered"  # entry of the report
POINTS = 256  # along each axis, from the first sample to the last


def covered_text(is_covered: np.ndarray) -> str:
    """Return a text for the points that files cover. is_covered: bool [POINTS, POINTS], row 0 south."""
    return np.packbits(is_covered, axis=1).tobytes().hex()


def covered_points(text: object) -> np.ndarray | None:
    """Return the points of an unchecked text of `covered_text`; None if it is no such text or no point is covered."""
    try:
        packed = np.frombuffer(bytes.fromhex(text), np.uint8) if isinstance(text, str) else np.empty(0, np.uint8)
    except ValueError:
        return None
    if len(packed) != POINTS * POINTS // 8 or not packed.any():
        return None
    return np.unpackbits(packed.reshape(POINTS, -1), axis=1).astype(bool)
