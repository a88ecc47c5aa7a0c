# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of the header of classic netCDF files, because the library loops for minutes over a damaged one."""

import os
import struct
from collections.abc import Callable
from typing import BinaryIO

SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}  # bytes of a value by its type
DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12
MAX_AXES = 1024  # of a variable, as in the library


def netcdf_damage(file: BinaryIO) -> str:
    """Return the damage of a classic netCDF header as a clause, "" for a whole one and for any other file."""
    head = file.read(4)
    if head[:3] != b"CDF" or head[3:] not in (b"\1", b"\2", b"\5"):
        return ""
    try:
        _Header(file, head[3]).check()
    except (ValueError, struct.error):
        return f"its header is no header of netCDF from byte {file.tell():,} on"
    return ""


class _Header:
    """A header that is read from its start; all methods raise ValueError or struct.error at damage.

    Attributes:
        count_code: format of a count, for `struct.unpack`.
        offset_bytes: size of a variable's offset in the file.
    """

    def __init__(self, file: BinaryIO, version: int) -> None:
        """Begin at the file's position. Versions differ in the sizes of counts (5) and of offsets in the file (1)."""
        self.file, self.size = file, os.fstat(file.fileno()).st_size
        self.count_code = ">Q" if version == 5 else ">I"
        self.offset_bytes = 4 if version == 1 else 8

    def check(self) -> None:
        """Read all dimensions, attributes and variables."""
        self.number(self.count_code)  # number of records
        for tag, item in ((DIMENSIONS, self.dimension), (ATTRIBUTES, self.attribute), (VARIABLES, self.variable)):
            self.items(tag, item)

    def number(self, code: str = ">I") -> int:
        """Return the next number. code: its format, for `struct.unpack`."""
        return struct.unpack(code, self.file.read(struct.calcsize(code)))[0]

    def count(self) -> int:
        """Return the next count of items. Raises ValueError if the rest of the file has fewer bytes than that."""
        count = self.number(self.count_code)
        if count > self.size - self.file.tell():
            raise ValueError
        return count

    def skip_padded(self, num_bytes: int) -> None:
        """Pass over bytes and their padding to a multiple of 4."""
        padded = -(-num_bytes // 4) * 4
        if padded > self.size - self.file.tell():
            raise ValueError
        self.file.seek(padded, os.SEEK_CUR)

    def items(self, tag: int, read_item: Callable[[], None]) -> None:
        """Read a list: its tag, its length and, by `read_item`, its items. An absent list has the tag 0.

        tag: the tag that a list must have here. Raises ValueError for another one.
        """
        found_tag, length = self.number(), self.count()
        if found_tag not in (0, tag) or (length and found_tag != tag):
            raise ValueError
        for _ in range(length):
            read_item()

    def dimension(self) -> None:
        """Skip a dimension: its name and its length."""
        self.skip_padded(self.count())
        self.number(self.count_code)

    def attribute(self) -> None:
        """Skip an attribute: its name, the type of its values and the values. Raises ValueError for an unknown type."""
        self.skip_padded(self.count())
        size = SIZES.get(self.number())
        if size is None:
            raise ValueError
        self.skip_padded(size * self.count())

    def variable(self) -> None:
        """Skip a variable: its name, axes, attributes, type, size and offset."""
        self.skip_padded(self.count())
        axes = self.count()
        if axes > MAX_AXES:
            raise ValueError
        self.skip_padded(struct.calcsize(self.count_code) * axes)
        self.items(ATTRIBUTES, self.attribute)
        if self.number() not in SIZES:  # the type
            raise ValueError
        self.number(self.count_code)  # the size
        self.skip_padded(self.offset_bytes)
