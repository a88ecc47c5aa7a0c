# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of the counts in LAS and LAZ headers, because the library would reserve memory for, or read, billions."""

import os
import struct
from typing import BinaryIO

HEADER_BYTES, HEADER_1_4_BYTES = 227, 375
RECORD_BYTES, EXTENDED_RECORD_BYTES = 54, 60  # of a variable length record without its content
COMPRESSED = 128  # added to a point format


def las_damage(file: BinaryIO) -> str:
    """Return the damage of a LAS header as a clause for an error, "" for counts that the file can hold.

    Numbers below are offsets in the header, by the specification of LAS 1.4.
    """
    size = os.fstat(file.fileno()).st_size
    head = file.read(HEADER_1_4_BYTES)
    if len(head) < HEADER_BYTES or head[:4] != b"LASF":
        return "it does not begin with a header of LAS"
    # form: number of the format of points, which are compressed from COMPRESSED on.
    header_bytes, first_point, num_records, form, point_bytes, num_points = struct.unpack_from("<HIIBHI", head, 94)
    if head[25] >= 4 and len(head) == HEADER_1_4_BYTES:  # the minor version
        extended_at, num_extended = struct.unpack_from("<QI", head, 235)
        num_points = struct.unpack_from("<Q", head, 247)[0]
        if num_extended and extended_at + EXTENDED_RECORD_BYTES * num_extended > size:
            return f"it cannot hold {num_extended:,} extended records"
    if not header_bytes <= first_point <= size or RECORD_BYTES * num_records > first_point - header_bytes:
        return f"it cannot hold {num_records:,} records before its points"
    if form < COMPRESSED:
        fits = first_point + num_points * point_bytes <= size
        return "" if fits else f"it cannot hold {num_points:,} points of {point_bytes} bytes"
    return _chunks_damage(file, first_point, size)


def _chunks_damage(file: BinaryIO, first_point: int, size: int) -> str:
    """Return a clause about the damage of the table of compressed pieces (chunks), "" without damage.

    The table's offset is before the points, or at the file's end. first_point: offset of the points. size: of the file.
    """
    try:
        file.seek(first_point)
        (table,) = struct.unpack("<q", file.read(8))
        if table == -1:  # the writer could not go back
            file.seek(size - 8)
            (table,) = struct.unpack("<q", file.read(8))
        file.seek(max(table, 0))
        _, num_chunks = struct.unpack("<II", file.read(8))
    except struct.error:
        return "it ends before its table of pieces"
    return "" if first_point < table < size and num_chunks <= size else f"it cannot hold {num_chunks:,} pieces"
