# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors as bytes and heights as the source's own 16-bit numbers: what a height field keeps of its floats.

A byte stands for an entry of a table, 0 for 0. Errors are rounded up, so bounds hold. A mesh has no cracks if they are
nested after rounding, too, also below the raster's cells, where an error is a quarter (of a bicubic surface a half) of
another cell's. Rounding never changes the order of two errors; and it commutes with halving where twice an entry
is an entry. So no octave of the table has fewer entries than the one below: the seven under the largest error, where
meshes are decided, have 28 each, which round an error up by 1.2 % in the mean; the 26 below those, which only a spike
calls for, have ever fewer.

Each group of depths (lattice.py) has its own power of two by which its table is multiplied, the least that holds its
largest error. A coarser group's is never smaller, so its entries are entries of the finer groups' tables, and a parent
stays at or above its children.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import warp as wp

from ...kernels.field import codes as kernels
from ..run import launch
from ..run.buffers import flat
from .lattice import Lattice

# Entries in each octave, upwards; with 0 and the largest they are 256.
PER_OCTAVE = (1,) * 18 + (2,) * 6 + (14,) * 2 + (28,) * 7
# Exponents of the tables: all entries are between the least normal float32 and the largest.
LEAST_EXPONENT, MOST_EXPONENT = -93, 112
BLOCK = 1 << 14


# Rows of heights that are looked at together.
ROWS = 256


def _shape() -> np.ndarray:
    """float32 [256]: the table of a largest error of 1."""
    entries = [0.0]
    for octave, count in enumerate(PER_OCTAVE):
        above = np.nextafter((2.0 ** (np.arange(1, count) / count)).astype(np.float32), np.float32(2.0))
        entries += np.ldexp([1.0, *above], octave - len(PER_OCTAVE)).tolist()
    return np.array([*entries, 1.0], np.float32)


SHAPE = _shape()


def tables(exponents) -> np.ndarray:
    """float32 [len(exponents), 256] metres: what each code stands for, by group."""
    return np.ldexp(SHAPE, np.asarray(exponents)[:, None]).astype(np.float32)


def exponent_of(largest: float) -> int:
    """The least power of two, as an exponent of tables, that is not below an error in metres."""
    part, exponent = np.frexp(largest)
    return int(np.clip(exponent - (part == 0.5), LEAST_EXPONENT, MOST_EXPONENT))


def parts(lattice: Lattice, count: int) -> list[slice]:
    """Where the arrays hold each group, the cells, and behind those the bends of a bicubic surface."""
    ends = lattice.layout()[0].tolist()
    ends += [count] if count > ends[-1] else []
    return [slice(first, end) for first, end in pairwise(ends)]


def encode(lattice: Lattice, errors: np.ndarray, codes: np.ndarray, threads: int) -> list[int]:
    """Fill `codes` (uint8, zeroed) with `errors` (float32, as long, nested, metres); returns the exponents by group."""
    own = [exponent_of(float(errors[part].max())) for part in parts(lattice, len(errors))]
    cells, bends = lattice.groups, own[lattice.groups + 1 :]
    finer = bends[0] - 1 if bends else LEAST_EXPONENT
    for group in (cells, *range(cells)):  # from fine to coarse
        own[group] = finer = max(own[group], finer)
    put(lattice, errors, tables(own), codes, threads)
    return own


def put(lattice: Lattice, errors: np.ndarray, table: np.ndarray, codes: np.ndarray, threads: int) -> None:
    """Fill `codes` (uint8, zeroed) with the least entries of `table` that are not below `errors`."""
    arrays = [flat(table, wp.float32), flat(errors, wp.float32), flat(codes, wp.uint8)]
    for group, part in enumerate(parts(lattice, len(errors))):
        blocks = -(-(part.stop - part.start) // BLOCK)
        inputs = [BLOCK, wp.int64(part.start), wp.int64(part.stop), len(SHAPE) * group, *arrays]
        launch.spread(kernels.encode_errors, blocks, inputs, step="error codes", threads=threads, cost=BLOCK)


def decode(lattice: Lattice, codes: np.ndarray, table: np.ndarray) -> np.ndarray:
    """float32 [len(codes)] metres: what codes stand for."""
    errors = np.empty(len(codes), np.float32)
    for values, part in zip(table, parts(lattice, len(codes)), strict=True):
        translate(codes[part], values, errors[part])
    return errors


def translate(codes: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` with values[codes]; numpy's own makes indices of 64 bits of all codes at once."""
    for first in range(0, len(codes), BLOCK):
        out[first : first + BLOCK] = values[codes[first : first + BLOCK]]


@dataclass(frozen=True)
class Steps:
    """Heights as a source has stored them: (number + first) * scale + offset metres, of numbers uint16, in float64."""

    first: int
    scale: float
    offset: float

    def heights(self, numbers: np.ndarray) -> np.ndarray:
        """float32: the bits that an import of floats would hold."""
        return ((numbers.astype(np.float64) + self.first) * self.scale + self.offset).astype(np.float32)


def packed(samples: np.ndarray, steps: Steps | None) -> kernels.Samples:
    """The samples of a height field as kernels read them; memory is shared."""
    made, coded = kernels.Samples(), steps is not None
    made.rows, made.columns = samples.shape
    made.coded = int(coded)
    made.first, made.scale, made.offset = (steps.first, steps.scale, steps.offset) if coded else (0, 1.0, 0.0)
    made.floats = flat(np.zeros(1, np.float32) if coded else samples, wp.float32)
    made.numbers = flat(samples if coded else np.zeros(1, np.uint16), wp.uint16)
    return made


def steps_of(stored: np.dtype, scale: float, offset: float) -> Steps | None:
    """How a source of integers of 16 bits or fewer stores heights; None of any other."""
    if stored.kind not in "iu" or stored.itemsize > 2 or not np.isfinite([scale, offset]).all() or scale == 0.0:
        return None
    return Steps(int(np.iinfo(stored).min), float(scale), float(offset))


def number(heights: np.ndarray, steps: Steps, numbers: np.ndarray) -> bool:
    """Fill `numbers` (uint16) with those that stand for `heights`; False if there is one that none stands for."""
    for row in range(0, len(heights), ROWS):
        block = heights[row : row + ROWS]
        with np.errstate(over="ignore"):  # infinity is out of range, too
            found = np.rint((block.astype(np.float64) - steps.offset) / steps.scale) - steps.first
        if not (0 <= found.min() and found.max() <= 65535):
            return False
        numbers[row : row + ROWS] = found
        if not np.array_equal(steps.heights(numbers[row : row + ROWS]), block):
            return False
    return True
