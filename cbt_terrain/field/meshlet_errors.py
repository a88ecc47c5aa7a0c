# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies for leaves that are drawn finer than they are, as meshlets.

They are computed on codes alone, so they take one byte a diamond. The codes are those of the exact errors, because
rounding up to the entries of a table commutes with the maximum, with halving and with coarser tables (codes.py).
"""

import numpy as np
import warp as wp

from ...kernels.field import expand as kernels
from ..run import launch
from ..run.buffers import flat
from ..run.locks import cached
from . import codes
from .derived_arrays import derive_cached
from .heightfield import HeightField
from .hierarchy import items, stored_at
from .lattice import PAGE, Lattice
from .shared_pages import Paged, read_into

# Codes of cells that are copied at once, before their neighbours change.
BAND = 1 << 22


def error_for(field: HeightField, meshlet: int) -> Paged:
    """Return the error hierarchy for leaves that are drawn as 4**meshlet triangles.

    The result is uint8 [node_count]: a code for each diamond, which the field's table turns into metres. Errors are
    smaller than those of `field.error`, so the refinement needs fewer leaves. It is computed once for each `meshlet`,
    and cached in the field's store, if it has one.
    """
    if meshlet == 0:
        return field.error
    return cached(field.cache.expanded, (field.interpolation, meshlet), lambda: _load_or_expand(field, meshlet))


def _load_or_expand(field: HeightField, meshlet: int) -> np.ndarray:
    """Return the codes for leaves drawn as 4**meshlet triangles from the field's store, or compute and write them."""
    name = f"error_m{meshlet}" if field.interpolation == "bilinear" else f"error_c_m{meshlet}"

    def expand(arrays: dict[str, np.ndarray]) -> None:
        """Fill the array with the field's codes, and raise them."""
        read_into(field.error, arrays[name])
        expand_codes(field.lattice, arrays[name], field.table, meshlet, launch.default_threads())

    return derive_cached(field.raster, {name: (field.error.shape, np.uint8)}, expand)[name]


def expand_codes(lattice: Lattice, errors: np.ndarray, table: np.ndarray, meshlet: int, threads: int) -> None:
    """Turn the codes `errors` in place into those of leaves that are drawn `2 * meshlet` bisections finer.

    Each pass gives a diamond the largest error of its children, which keeps parents above children. Curvatures of a
    bicubic surface may follow the errors (bicubic.py). table: float32 [parts, 256] metres, a row for each of
    `codes.parts`: the groups of depths, from `lattice.groups` on the cells and their curvatures.
    """
    has_curvatures = len(errors) > lattice.node_count
    out = flat(errors, wp.uint8)
    for step in range(2 * meshlet):
        for depth in range(1, lattice.cell_depth):  # from coarse to fine: a child is read before it changes
            coarser, group = stored_at(lattice, depth), lattice.group(depth)
            translated = codes.translation(table[lattice.group(depth + 1)], table[group])
            inputs = [stored_at(lattice, depth + 1), coarser, flat(translated, wp.uint8), out]
            launch.spread(kernels.raise_codes, items(coarser), inputs, step="meshlet errors", threads=threads)
        # On a bilinear surface a cell's diamond and the side diamonds one bisection below have the same error, so
        # every other pass moves cells by two bisections. On a bicubic surface curvatures, and the errors of cells with
        # them, halve with each bisection: in those passes by `_raise_cells`, in the others here.
        if step % 2 == 0:
            _raise_cells(lattice, errors, table, threads)
        elif has_curvatures:
            for group, part in list(enumerate(codes.parts(lattice, len(errors))))[lattice.groups :]:
                codes.translate(errors[part], codes.translation(table[group], table[group], factor=0.5), errors[part])


def _raise_cells(lattice: Lattice, errors: np.ndarray, table: np.ndarray, threads: int) -> None:
    """Set the codes of cells to a quarter of the largest error of themselves and their four neighbours.

    On a bicubic surface, which also stores a curvature of each cell, error and curvature become half of the largest of
    the five curvatures instead. Rows of pages are changed band by band, from a copy of their old codes. errors: codes
    of all diamonds. table: errors of the codes, metres, by group.
    """
    read_group, factor = (lattice.groups + 1, 0.5) if len(errors) > lattice.node_count else (lattice.groups, 0.25)
    parts, row_size = codes.parts(lattice, len(errors)), stored_at(lattice, lattice.cell_depth).pages * PAGE * PAGE
    rows, band = errors[parts[read_group]].reshape(-1, row_size), max(1, BAND // row_size)
    south = np.empty((0, row_size), np.uint8)  # the old codes of the row of pages south of a band
    for first in range(0, len(rows), band):
        # The band's old codes, with one row of pages before it and one after it for the neighbours.
        old_codes = np.concatenate([south, rows[first : first + band + 1]])
        old_cells = stored_at(lattice, lattice.cell_depth)
        old_cells.base = -(first - len(south)) * row_size  # entry of `old_codes` for the image's first row
        south = old_codes[len(south) :][band - 1 : band]
        for group in range(lattice.groups, read_group + 1):  # errors of cells, and their curvatures if there are any
            cells = stored_at(lattice, lattice.cell_depth)
            cells.base = parts[group].start
            # By code that is read: the code of `factor` times its error in the group's own table.
            translated = codes.translation(table[read_group], table[group], factor=factor)
            inputs = [old_cells, flat(old_codes, wp.uint8), cells, flat(translated, wp.uint8), flat(errors, wp.uint8)]
            from_row, end = first * PAGE, min((first + band) * PAGE, cells.rows)
            launch.spread(
                kernels.raise_cells,
                (end - from_row) * cells.columns,
                [from_row * cells.columns, *inputs],
                step="meshlet errors",
                threads=threads,
            )
