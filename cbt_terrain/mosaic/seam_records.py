# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks of seams of an earlier import: to find them, all files around have to be read.

A seam is where a finer file ends on a coarser one. Marks are bits that tell the seams in each square cell of a block of
the grid; each level of finer files has its own (insets.py).
"""

import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Block = tuple[int, int]  # row and column


class SeamRecords(NamedTuple):
    """Records of the marks of blocks of a grid.

    Attributes:
        find_record: find_record(row, column) returns the values of a block's record, None without one.
        note_record: note_record(row, column, **values) writes one.
        inputs_at: inputs_at(row, column) returns a digest of all that determines the marks of a block of the grid.
    """

    find_record: Callable[[int, int], dict | None]
    note_record: Callable[..., None]
    inputs_at: Callable[[int, int], str]

    def find(self, block: Block, kind: np.dtype, side: Callable[[int], int]) -> dict | None:
        """Return the marks of a block's seam cells by level, from its record; None if they are unknown.

        block: row and column of the block, counted from the grid's origin (x0, y0). kind: type of the marks.
        side(level): cells along a side.
        """
        record = self.find_record(*block)
        if record is None or record["inputs"] != self.inputs_at(*block):
            return None
        marks = {}
        try:
            for level, text in record["marks"].items():
                count = side(int(level))
                decoder = zlib.decompressobj()
                # At most the bytes of the marks, whatever a damaged record would unpack to.
                data = decoder.decompress(bytes.fromhex(text), max_length=count * count * kind.itemsize)
                marks[int(level)] = np.frombuffer(data, kind).reshape(count, count)
        except (ValueError, zlib.error):  # the record is damaged
            return None
        return marks

    def note(self, block: Block, marks: dict[int, np.ndarray]) -> None:
        """Write the record of a block: the marks of its seam cells by level.

        block: row and column of the block, counted from the grid's origin (x0, y0).
        """
        texts = {str(level): zlib.compress(level_marks.tobytes()).hex() for level, level_marks in marks.items()}
        self.note_record(*block, inputs=self.inputs_at(*block), marks=texts)
