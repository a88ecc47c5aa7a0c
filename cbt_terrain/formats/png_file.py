# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of PNG files, because some readers accept a truncated one and return black for its missing rows."""

import struct
import zlib
from typing import BinaryIO

SIGNATURE = b"\x89PNG\r\n\x1a\n"
END = b"IEND"
PIECE = 1 << 20


def png_damage(file: BinaryIO) -> str:
    """Return the damage of a PNG file as a clause for an error, "" for a whole PNG and for any other file."""
    if file.read(len(SIGNATURE)) != SIGNATURE:
        return ""
    while True:
        head = file.read(8)
        if len(head) < 8:
            return "it ends before its last chunk"
        bytes_left, kind = struct.unpack(">I4s", head)
        check = zlib.crc32(kind)
        while bytes_left:
            piece = file.read(min(bytes_left, PIECE))
            if not piece:
                return "it ends inside a chunk"
            check, bytes_left = zlib.crc32(piece, check), bytes_left - len(piece)
        if file.read(4) != struct.pack(">I", check):
            return f"its chunk {kind.decode('ascii', 'replace')} differs from its checksum"
        if kind == END:
            return ""
