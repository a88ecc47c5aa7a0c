# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG files, written without libraries that the extension lacks."""

import struct
import zlib

import numpy as np


def png(pixels: np.ndarray) -> bytes:
    """Encode a picture, uint8 [height, width, 3], first row on top (PNG specification, sections 5 and 11)."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # each begins with its filter, 0: none
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits a channel, RGB
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b""))
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
