# SPDX-License-Identifier: GPL-3.0-or-later
"""The codes of errors from which a fit walks its meshes (kernels/fitting/raising.py).

Here each diamond of the error hierarchy has a code of one byte, on a logarithmic scale with a fixed number of codes in
an octave (a factor of two). The walk splits diamonds whose error exceeds the request. To split a triangle, a fit raises
the code of its diamond, and those of the diamond's ancestors, to the code `split`. Errors inside a raster cell are not
stored, but fall to a quarter with each halving of its side: for a split after n halvings the cell's code is raised to n
times two octaves above `split`.
"""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.fitting import finer as finer_kernels
from ...kernels.fitting import raising
from ..field import codes, hierarchy
from ..field.finer_tiles import FinerTiles
from ..field.heightfield import HeightField
from ..field.shared_pages import read_into
from ..run import launch
from ..run.buffers import flat

# The first mesh interpolates the surface for START times the requested error: a smaller factor leaves triangles that
# could be merged, a larger one needs many splits, which also split the neighbours of the triangles that need them.
START = 1.7


def raised_codes(finer: FinerTiles | None, halvings: int) -> raising.RaisedCodes:
    """Return the number of error codes in an octave, and the code that makes a split, for kernels.

    finer: the raster's finer tiles, or None. halvings: largest number of halvings of a cell's side after which a fit
    splits a triangle. With finer tiles there may be many; then `split` is so low that the last one's code is 254.
    """
    raised = raising.RaisedCodes()
    if finer is None:
        assert halvings <= raising.MAX_HALVINGS
        raised.per_octave, raised.split = raising.PER_OCTAVE, raising.RAISED
    else:
        # Errors of neighbouring cells differ by a factor of four at most: two octaves of codes.
        per_cell = 2 * raising.FINER_PER_OCTAVE
        raised.per_octave, raised.split = raising.FINER_PER_OCTAVE, 254 - per_cell * halvings
        assert raised.split > per_cell
        raised.more = raised.split // per_cell  # further cells, each with a code two octaves lower, before code 0
    return raised


def make_codes(
    field: HeightField, plain: Domain, raised: raising.RaisedCodes, error: float, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors for the first mesh as codes that may be raised, and the errors of these codes by group.

    Codes are evenly spaced in the logarithm of the error, with `raised.split` at twice the requested error. Errors are
    rounded to the nearest code, not up, since the fit measures its result. With finer tiles no error becomes 0 but the
    first code: the error of their change is added to it, and zeros would break nesting. plain: domain of the field with
    its own errors. error: the requested one, metres before scaling.
    """
    per_octave, steps = raised.per_octave, np.arange(255)
    first = 2.0 * error * 2.0 ** (-(raised.split - 1) / per_octave)  # of code 1, so that `split` is twice the error
    values = np.concatenate([[0.0], np.ldexp(first * 2.0 ** (steps % per_octave / per_octave), steps // per_octave)])
    # Errors up to code_ends[n] get code n.
    code_ends = np.concatenate([[0.0], values[1:-1] * 2.0 ** (0.5 / per_octave)])  # geometric means with the next code
    diamond_codes = np.empty(field.error.shape, np.uint8)
    read_into(field.error, diamond_codes)
    # Of each group of depths: the errors of its old codes, float32 [256], and its slice of the array of codes.
    for group_errors, part in zip(field.table, codes.parts(field.lattice, len(diamond_codes)), strict=True):
        new = np.searchsorted(code_ends, group_errors / START)
        # With finer tiles `has_finer` is 1, which is also the first code: none is 0.
        new = np.maximum(new, int(plain.has_finer))
        codes.translate(diamond_codes[part], new, diamond_codes[part])
    values = values.astype(np.float32)
    if plain.has_finer:
        _restore_in_tiles(field, plain, diamond_codes, values, threads)
    return diamond_codes, np.tile(values, len(field.table))


def _restore_in_tiles(
    field: HeightField, plain: Domain, diamond_codes: np.ndarray, values: np.ndarray, threads: int
) -> None:
    """Raise codes of cells in finer tiles to those of their stored errors, rounded up, and others as nesting requires.

    So the walk splits in tiles what interpolation splits there. The fit cannot split there later: it could only raise
    the code of a raster cell, and that would split all finer cells in it. plain: domain of the field with its own
    errors. diamond_codes: those of all diamonds, changed in place. values: float32 [256], metres of the codes.
    """
    lattice, stack = field.lattice, wp.zeros(1024, wp.vec3i, device="cpu")
    part = slice(lattice.cell_base, lattice.node_count)
    cells = hierarchy.stored_at(lattice, lattice.cell_depth)
    cells.base = 0  # in arrays of cells alone
    # Of the cells alone: stored errors, and those of the new codes, which are raised to the stored ones in tiles.
    errors, metres = field.table[lattice.groups][field.error[part]], values[diamond_codes[part]]
    inputs = [plain, cells, flat(errors, wp.float32), flat(metres, wp.float32)]
    cost = 2.0 * cells.columns
    launch.spread(finer_kernels.restore_in_tiles, cells.rows, inputs, step="fit codes", threads=threads, cost=cost)
    # The stored errors of neighbouring cells differ by a factor of four at most, too.
    hierarchy.saturate_cells(cells, 0.25, flat(metres, wp.float32), "fit codes", threads)
    # Write the raised errors back as codes, and raise the codes of the cells' ancestors to them.
    cell_codes = np.zeros(len(metres), np.uint8)
    codes.encode_part(metres, values, cell_codes, threads)
    inputs = [plain, cells, flat(cell_codes, wp.uint8), flat(diamond_codes, wp.uint8), stack]
    launch.once(finer_kernels.raise_to_cells, inputs, step="fit codes")
