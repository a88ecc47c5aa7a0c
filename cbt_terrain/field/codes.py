# SPDX-License-Identifier: GPL-3.0-or-later
"""Compact storage of a height field: errors as bytes, heights as 16-bit numbers of the source.

A byte is the index of an entry in a table; entry 0 is 0. Errors are rounded up, so bounds hold. A mesh has no cracks
only if the rounded errors are nested, too, also below the raster's cells, where an error is a quarter (for a bicubic
surface half) of another cell's. Rounding keeps the order of two errors, and it commutes with halving if twice an entry
is an entry. So no octave of the table has fewer entries than the octave below. The seven octaves under the largest
error decide most meshes and have 28 entries each, which round an error up by 1.2 % in the mean. The 26 octaves below,
which only a spike needs, have fewer and fewer.

Each group of depths (lattice.py) multiplies its table by a power of two, the smallest that covers its largest error. A
coarser group's power is never smaller, so its entries are also in the finer groups' tables, and a parent's error stays
at or above its children's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..run import launch
from ..run.buffers import flat
from .lattice import Lattice

if TYPE_CHECKING:
    from ...kernels.field import codes as kernels

# Entries of each octave, upwards; with 0 and the largest they are 256.
PER_OCTAVE = (1,) * 18 + (2,) * 6 + (14,) * 2 + (28,) * 7
# Exponents of the tables keep all entries between the smallest normal float32 and the largest.
MIN_EXPONENT, MAX_EXPONENT = -93, 112
BLOCK = 1 << 14  # codes that are computed together
ROWS = 256  # rows of heights that are numbered together
DECODED = 1 << 20  # numbers that become heights together


def _table_shape() -> np.ndarray:
    """Return the errors that the 256 codes stand for if the largest one is 1: float32 [256], rising.

    Entry 0 is 0, the others are about even steps of log2: PER_OCTAVE of them in each octave, from below.
    """
    entries = [0.0]
    for octave, count in enumerate(PER_OCTAVE):
        # even steps of log2 within the octave, rounded up
        above = np.nextafter((2.0 ** (np.arange(1, count) / count)).astype(np.float32), np.float32(2.0))
        entries += np.ldexp([1.0, *above], octave - len(PER_OCTAVE)).tolist()
    return np.array([*entries, 1.0], np.float32)


SHAPE = _table_shape()


def tables(exponents: Sequence[int]) -> np.ndarray:
    """Return the values of all codes in metres, float32 [len(exponents), 256], rising in each row.

    exponents: of each table, whose largest error is 2^exponent; in the order of `parts` for a whole hierarchy.
    """
    return np.ldexp(SHAPE, np.asarray(exponents)[:, None]).astype(np.float32)


def exponent_of(largest: float) -> int:
    """Return the exponent of the smallest power of two, within limits, that is not below an error in metres.

    It is 0 for an error of 0.
    """
    part, exponent = np.frexp(largest)
    return int(np.clip(exponent - (part == 0.5), MIN_EXPONENT, MAX_EXPONENT))


def parts(lattice: Lattice, count: int) -> list[slice]:
    """Return the slices of an array of `count` errors: of each group of depths, from fine to coarse, then of the cells.

    Each slice has its own table of codes. Entries beyond `lattice.node_count` are a last slice, the curvatures of a
    bicubic surface.
    """
    ends = lattice.layout()[0].tolist()
    ends += [count] if count > ends[-1] else []
    return [slice(first, end) for first, end in pairwise(ends)]


def encode(lattice: Lattice, errors: np.ndarray, codes: np.ndarray, threads: int) -> list[int]:
    """Fill `codes` with the smallest codes that are not below `errors`; return the exponents in the order of `parts`.

    Each part has a table of codes that reaches 2^exponent metres. errors: float32 metres, nested (none is below its
    children's). codes: uint8, zeroed.
    """
    exponents = nested(lattice, [exponent_of(float(errors[part].max())) for part in parts(lattice, len(errors))])
    encode_with_table(lattice, errors, tables(exponents), codes, threads)
    return exponents


def nested(lattice: Lattice, exponents: list[int]) -> list[int]:
    """Return the exponents of groups, raised so that no coarser group has a smaller one.

    A group's codes reach 2^exponent metres. The cells' exponent is also at least that of the curvatures, if there are
    any, minus 1, since errors of cells are at least half of them. exponents: each group's own, in the order of `parts`.
    """
    exponents, cells = list(exponents), lattice.groups
    finer = exponents[cells + 1] - 1 if len(exponents) > cells + 1 else MIN_EXPONENT
    for group in (cells, *range(cells)):  # from fine to coarse
        exponents[group] = finer = max(exponents[group], finer)
    return exponents


def encode_with_table(lattice: Lattice, errors: np.ndarray, table: np.ndarray, codes: np.ndarray, threads: int) -> None:
    """Fill `codes` (uint8, zeroed) with the smallest entries of `table` that are not below `errors`.

    table: float32 [parts, 256] metres, in the order of `parts`; each must reach the largest error of its part.
    """
    for values, part in zip(table, parts(lattice, len(errors)), strict=True):
        encode_part(errors[part], values, codes[part], threads)


def encode_part(errors: np.ndarray, values: np.ndarray, codes: np.ndarray, threads: int) -> None:
    """Write the codes of one group's errors: for each the first value of the table that is not below it.

    errors: float32 metres; one above the last value gets the last code. values: the group's table, float32 [256]
    metres, rising. codes: uint8, zeroed, because zeros are not written.
    """
    from ...kernels import wp
    from ...kernels.field import codes as kernels

    arrays = [flat(array, wp.float32) for array in (values, errors)]
    # The search for a code starts at that of the error with its lowest bits cleared.
    start_codes = flat(_first_codes(values.tobytes(), kernels.CODE_BITS), wp.uint8)
    inputs = [BLOCK, wp.int64(len(errors)), arrays[0], start_codes, arrays[1], flat(codes, wp.uint8)]
    launch.spread(
        kernels.encode_errors, -(-len(errors) // BLOCK), inputs, step="error codes", threads=threads, cost=BLOCK
    )


@lru_cache(maxsize=64)
def _first_codes(values: bytes, bits: int) -> np.ndarray:
    """Return the code, uint8, of each float32 number from 0 to infinity whose lowest `bits` bits are 0.

    values: bytes of the group's table, float32 [256] metres, rising; a code is its first entry not below the number.
    """
    numbers = np.arange(0, np.float32(np.inf).view(np.int32) + 1, 1 << bits, np.int32).view(np.float32)
    codes = np.searchsorted(np.frombuffer(values, np.float32), numbers, side="left")
    return np.minimum(codes, 255).astype(np.uint8)


def decode(lattice: Lattice, codes: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return the errors that codes stand for, float32 [len(codes)] metres. table: metres, a row for each of `parts`."""
    errors = np.empty(len(codes), np.float32)
    for values, part in zip(table, parts(lattice, len(codes)), strict=True):
        translate(codes[part], values, errors[part])
    return errors


def translation(old: np.ndarray, new: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Return for each code of the table `old` the code of its error times `factor` in the table `new`: uint8 [256].

    old, new: float32 [256] metres. If the largest entry of `new` is not below that of `old` times `factor`, no error is
    rounded down, and one that was rounded up to `old` before gets the code of the error itself. Errors above the
    largest entry get the last code.
    """
    return np.minimum(np.searchsorted(new, old * np.float32(factor)), len(new) - 1).astype(np.uint8)


def translate(codes: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
    """Fill `out`, which may be `codes`, with values[codes], in blocks, because numpy makes 64-bit copies of indices."""
    for first in range(0, len(codes), BLOCK):
        out[first : first + BLOCK] = values[codes[first : first + BLOCK]]


@dataclass(frozen=True)
class Steps:
    """Conversion of a source's numbers, uint16, to heights: (number + first) * scale + offset metres, in float64."""

    first: int
    scale: float
    offset: float

    @property
    def is_plain(self) -> bool:
        """Return whether heights are whole numbers of metres."""
        return self.scale == 1.0 and self.offset == 0.0

    def heights(self, numbers: np.ndarray) -> np.ndarray:
        """Return heights, float32: the same bits as an import of floats.

        Blocks of rows, of about DECODED samples each, limit the memory for float64.
        """
        if numbers.size <= DECODED:
            return self._heights_of_block(numbers)
        heights, rows = np.empty(numbers.shape, np.float32), max(1, DECODED * len(numbers) // numbers.size)
        for first in range(0, len(numbers), rows):
            heights[first : first + rows] = self._heights_of_block(numbers[first : first + rows])
        return heights

    def _heights_of_block(self, numbers: np.ndarray) -> np.ndarray:
        """Return heights, float32, computed in float64."""
        if self.is_plain:  # all numbers and heights are exact in float32
            return numbers.astype(np.float32) + np.float32(self.first)
        return ((numbers.astype(np.float64) + self.first) * self.scale + self.offset).astype(np.float32)


def pack_samples(samples: np.ndarray, steps: Steps | None) -> "kernels.Samples":
    """Return the samples of a height field as kernels read them; memory is shared.

    steps: how 16-bit samples convert to metres, None for float32 samples.
    """
    from ...kernels import wp
    from ...kernels.field import codes as kernels

    s = kernels.Samples()
    s.rows, s.columns = samples.shape
    s.coded = int(steps is not None)
    s.first, s.scale, s.offset = (0, 1.0, 0.0) if steps is None else (steps.first, steps.scale, steps.offset)
    s.floats = flat(samples if steps is None else np.zeros(1, np.float32), wp.float32)
    s.numbers = flat(np.zeros(1, np.uint16) if steps is None else samples, wp.uint16)
    return s


def steps_of(stored: np.dtype, scale: float, offset: float) -> Steps | None:
    """Return the conversion of a source of integers with 16 bits or fewer; None for any other source or a scale of 0.

    stored: type of the source's numbers. A height is number * scale + offset, metres.
    """
    if stored.kind not in "iu" or stored.itemsize > 2 or not np.isfinite([scale, offset]).all() or scale == 0.0:
        return None
    return Steps(int(np.iinfo(stored).min), float(scale), float(offset))


def number(heights: np.ndarray, steps: Steps, numbers: np.ndarray) -> bool:
    """Fill `numbers` (uint16) with those from which `steps` gives the same bits as `heights`, float32 metres.

    Return False, with some rows filled, as soon as a height has no such number.
    """
    for row in range(0, len(heights), ROWS):
        block = heights[row : row + ROWS]
        with np.errstate(over="ignore"):  # infinity is out of range, too
            # Plain steps are whole metres: scale 1, offset 0.
            values = block if steps.is_plain else (block.astype(np.float64) - steps.offset) / steps.scale
            values = np.rint(values) - np.float32(steps.first)
        if not (0 <= values.min() and values.max() <= 65535):
            return False
        numbers[row : row + ROWS] = values
        if not np.array_equal(steps.heights(numbers[row : row + ROWS]), block):
            return False
    return True
