# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy of the bicubic surface (bicubic.py), computed tile by tile, so that memory has a bound.

A tile computes its cells and the TILE_DEPTHS bisections above them, in a window with the cells around it that they
depend on. Coarser diamonds, one for 256 cells, are computed for the whole raster at once. Results are codes, in place.
A tile with a larger error than all earlier ones raises the exponent of a group, and the codes so far are translated,
which gives the codes of the errors themselves (codes.py).

A cell's curvature is at least that of a cell n steps away times 2^-n, so any cell of the raster may count. If no
curvature of the tile is below a bound of all curvatures times 2^-n, cells n steps away have no effect. A tile with
planar parts fails this test; then its window includes all cells for which 2^-n times the bound is not 0 in float32.

`off` is the largest distance of the bicubic surface from the bilinear one.

Codes have a table of metres for each *group*, in this order (`codes.parts`): groups of four depths of diamonds, from
fine to coarse (0 to lattice.groups - 1), then the cells (lattice.groups), then the curvatures (lattice.groups + 1).
A `Depth` is the layout of the diamonds of one depth in an array. Diamonds are cells (`sides` 0) or sides of cells
(`sides` 1, with one more row and column); (x, y) has the entry at vertex (first + x step, first + y step) of an image
in pages of PAGE x PAGE entries, which begins at the entry `base`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import warp as wp

from ...kernels.bicubic import hierarchy as kernels
from ...kernels.bicubic import patches
from ...kernels.field.layout import Depth
from ..run import launch
from ..run.buffers import flat
from . import codes, hierarchy
from .codes import MIN_EXPONENT
from .heightfield import HeightField
from .hierarchy import items, stored_at
from .lattice import PAGE, Lattice, rows_of
from .shared_pages import pack_pages

# Cells along the side of a tile, a multiple of ALIGNED.
TILE = 2048
# Bisections above the cells that tiles compute: the groups 0 and 1, and the first depth of group 2.
TILE_DEPTHS, FIRST_WHOLE = 9, 2
# Cells around a tile on which its diamonds depend; corners of windows are multiples, so that depths are aligned.
ALIGNED = 32
# Curvatures are at most this factor times the relief, and 2^-SMALLEST is 0 in float32.
STEEPEST, SMALLEST = 1024.0, 151

Box = tuple[tuple[int, int], tuple[int, int]]  # first and end, of columns and of rows


@dataclass(frozen=True)
class _Window:
    """Errors of a tile in a window of cells of a raster.

    Attributes:
        tile: cells of the tile.
        box: cells of the window. A raster's cell beyond is missing.
        depths: layouts of the arrays, from the cells (0) to TILE_DEPTHS bisections above them, fewer for a small
            raster.
        errors, off: float32 metres, of all depths; `off` is the largest distance to the bilinear surface.
        curvatures: float32 metres, of the cells alone.
    """

    lattice: Lattice
    tile: Box
    box: Box
    depths: list[Depth]
    errors: np.ndarray
    off: np.ndarray
    curvatures: np.ndarray

    def corner(self, bisections: int) -> wp.vec2i:
        """Return the first diamond of the window in the raster, `bisections` above the cells."""
        return wp.vec2i(*(first >> bisections // 2 for first, _ in self.box))


def fill_errors(field: HeightField, out: np.ndarray, threads: int) -> list[int]:
    """Fill the codes of errors and curvatures; return the exponents of their tables, by group.

    A table of codes reaches 2^exponent metres. field: the bilinear one. out: uint8 [nodes + cells], zeroed.
    """
    lattice = field.lattice
    bases, parts = lattice.layout()[0], codes.parts(lattice, len(out))
    first = int(bases[min(FIRST_WHOLE, lattice.groups)])
    # Errors, and distances to the bilinear surface, at the depths that no tile computes: from entry `first` of the
    # error hierarchy on, where the group FIRST_WHOLE begins.
    errors, off = (np.zeros(max(lattice.cell_base - first, 1), np.float32) for _ in range(2))
    largest, exponents = [0.0] * len(parts), [MIN_EXPONENT] * len(parts)  # by group, of the tiles so far

    def raise_to(by_group: dict[int, float], unused: int = MIN_EXPONENT) -> None:
        """Raise the exponents for further errors, and translate the codes so far.

        by_group: largest of these errors by number of a group, metres. unused: exponent of a group without errors. At
        the end it is 0, that of `exponent_of(0)`, as in other fields.
        """
        for group, error in by_group.items():
            largest[group] = max(largest[group], error)
        exponents_of_groups = [codes.exponent_of(error) if error > 0.0 else unused for error in largest]
        # `nested`: no coarser group has a smaller exponent.
        for group, (before, after) in enumerate(
            zip(exponents, codes.nested(lattice, exponents_of_groups), strict=True)
        ):
            if after != before:
                translated = codes.translation(*codes.tables([before, after]))
                codes.translate(out[parts[group]], translated, out[parts[group]])
            exponents[group] = after

    # The cells and the finer depths, tile by tile.
    for tile in _tiles(lattice):
        window = _compute_tile(field, tile, threads)
        raise_to(_largest(window))
        _encode(window, codes.tables(exponents), out, threads)
        if len(window.depths) > TILE_DEPTHS:  # keep the coarsest depth of the tile: the coarser ones depend on it
            whole = _layout_from(lattice, TILE_DEPTHS, first)
            for values, target in ((window.errors, errors), (window.off, off)):
                _launch_rows(kernels.keep_rows, window, TILE_DEPTHS, whole, values, [flat(target, wp.float32)], threads)
        del window  # before the next one takes its memory
    # The coarser depths of the whole raster, each from the one below it; at the end their codes.
    for bisections in range(TILE_DEPTHS + 1, lattice.cell_depth):
        below, above = _layout_from(lattice, bisections - 1, first), _layout_from(lattice, bisections, first)
        _add_errors(field, bisections, below, above, wp.vec2i(0, 0), off, errors, threads)
    # The largest error of each coarser group.
    raise_to(
        {g: float(errors[p.start - first : p.stop - first].max()) for g, p in _whole_groups(lattice, parts)}, unused=0
    )
    table = codes.tables(exponents)
    for group, part in _whole_groups(lattice, parts):
        codes.encode_part(errors[part.start - first : part.stop - first], table[group], out[part], threads)
    return exponents


def _tiles(lattice: Lattice) -> Iterator[Box]:
    """Yield the cells of all tiles, row by row; the last of a row or column may have fewer than TILE a side."""
    across, up = (
        [(first, min(first + TILE, cells)) for first in range(0, cells, TILE)]
        for cells in (lattice.cells_x, lattice.cells_y)
    )
    yield from ((columns, rows) for rows, columns in product(up, across))


def _compute_tile(field: HeightField, tile: Box, threads: int) -> _Window:
    """Return the errors of a tile in a window that is large enough for it.

    The second window, which has all cells that can count, is used only if cells outside the first one may count.
    """
    # A bound of all curvatures, metres: a multiple of the range of heights. One that is n cells away counts 2^-n of it;
    # `far` cells away, a multiple of ALIGNED, this is 0 in float32, since 2^-SMALLEST is.
    bound = STEEPEST * (float(field.max_height) - float(field.min_height))
    far = ALIGNED * (1 + -(-(SMALLEST + int(np.ceil(np.log2(max(bound, 1.0))))) // ALIGNED))
    for around in (2 * ALIGNED, far):
        window = _make_window(field.lattice, tile, around)
        cells = window.depths[0]
        (west, east), (south, north) = window.box
        # Fill the three arrays for the window's cells, each from its own patch.
        inputs = [codes.pack_samples(field.samples, field.steps), wp.vec2i(west, south), east - west, cells]
        inputs += [flat(array, wp.float32) for array in (window.off, window.errors, window.curvatures)]
        launch_step(patches.patch_errors, north - south, inputs, threads, 20.0 * (east - west))
        curvatures = flat(window.curvatures, wp.float32)
        # Half of each neighbour's curvature, a quarter of those after it, and so on.
        hierarchy.saturate_cells(cells, part=0.5, out=curvatures, step="bicubic hierarchy", threads=threads)
        # Cells outside the window are more than `around` - ALIGNED steps away from those that count.
        if _smallest(window) >= np.float32(np.ldexp(bound, ALIGNED - around)):
            break
    # A cell's error also bounds triangles whose longest edge is a side of the cell.
    inputs = [cells, curvatures, flat(window.errors, wp.float32)]
    launch_step(kernels.cover_sides, items(cells), inputs, threads)
    for bisections in range(1, len(window.depths)):
        below, above = window.depths[bisections - 1 : bisections + 1]
        _add_errors(field, bisections, below, above, window.corner(bisections), window.off, window.errors, threads)
    return window


def _make_window(lattice: Lattice, tile: Box, around: int) -> _Window:
    """Return the window of a tile and `around` cells on its sides, less at the border, with arrays of zeros."""
    ends = lattice.cells_x, lattice.cells_y
    across, up = (
        (max(first - around, 0), min(end + around, last)) for (first, end), last in zip(tile, ends, strict=True)
    )
    box = across, up
    depths, base = [], 0
    for bisections in range(min(TILE_DEPTHS, lattice.cell_depth - 1) + 1):
        whole, shift, depth = stored_at(lattice, lattice.cell_depth - bisections), bisections // 2, Depth()
        # The layout is that of the raster, cut to the window, and with an image for this depth alone. It has the cells
        # of 2^shift raster cells a side that cover the window, and one more row and column, as far as the raster's
        # layout has them: that also holds diamonds beyond the raster's border.
        max_counts = [-(-(end - first) >> shift) + 1 for first, end in box]
        depth.columns = min(max_counts[0], whole.columns - (box[0][0] >> shift))
        depth.rows = min(max_counts[1], whole.rows - (box[1][0] >> shift))
        depth.sides, depth.first, depth.step, depth.base = whole.sides, 0, 1, base
        depth.pages = -(-(depth.columns + depth.sides) // PAGE)
        base += depth.pages * -(-(depth.rows + depth.sides) // PAGE) * PAGE * PAGE
        depths.append(depth)
    cell_entries = depths[1].base if len(depths) > 1 else base  # the cells' image is the first one
    errors, off = np.zeros(base, np.float32), np.zeros(base, np.float32)
    return _Window(lattice, tile, box, depths, errors, off, np.zeros(cell_entries, np.float32))


def _smallest(window: _Window) -> np.float32:
    """Return the smallest curvature, metres, of the cells on which the tile's diamonds depend; to test the window.

    These are its own and ALIGNED more on each side. Infinity if the window has all cells of the raster.
    """
    if window.box == ((0, window.lattice.cells_x), (0, window.lattice.cells_y)):
        return np.float32(np.inf)
    (rows, columns) = (
        slice(max(first - ALIGNED, low) - low, min(end + ALIGNED, high) - low)
        for (first, end), (low, high) in zip(reversed(window.tile), reversed(window.box), strict=True)
    )
    return rows_of(window.curvatures, window.depths[0].pages)[rows, columns].min()


def _largest(window: _Window) -> dict[int, float]:
    """Return the largest errors of a window, metres, by the numbers of the groups that tiles encode.

    Diamonds at its sides lack the errors outside, so none of the found errors is larger than the raster's.
    """
    lattice = window.lattice
    by_group = {lattice.groups + 1: float(window.curvatures.max())}
    ends = [depth.base for depth in window.depths[1:]] + [len(window.errors)]
    for bisections, (depth, end) in enumerate(zip(window.depths, ends, strict=True)):
        if bisections < TILE_DEPTHS:
            group = lattice.group(lattice.cell_depth - bisections)
            by_group[group] = max(by_group.get(group, 0.0), float(window.errors[depth.base : end].max()))
    return by_group


def _encode(window: _Window, table: np.ndarray, out: np.ndarray, threads: int) -> None:
    """Write the tile's results as codes into `out`, the codes of the whole raster (uint8).

    They are the errors of its cells and of the diamonds less than TILE_DEPTHS bisections above them (`fill_errors`
    encodes that depth with the coarser ones), and its curvatures. table: float32 [groups, 256] metres, for each group
    what a code stands for.
    """
    lattice, packed_table = window.lattice, flat(table, wp.float32)
    for bisections in range(min(TILE_DEPTHS, len(window.depths))):
        depth = lattice.cell_depth - bisections
        whole, more = stored_at(lattice, depth), [packed_table, lattice.group(depth), flat(out, wp.uint8)]
        _launch_rows(kernels.encode_rows, window, bisections, whole, window.errors, more, threads)
    whole = stored_at(lattice, lattice.cell_depth)
    whole.base = lattice.node_count  # curvatures follow the errors
    more = [packed_table, lattice.groups + 1, flat(out, wp.uint8)]
    _launch_rows(kernels.encode_rows, window, 0, whole, window.curvatures, more, threads)


def _launch_rows(
    kernel: wp.Kernel,
    window: _Window,
    bisections: int,
    whole: Depth,
    values: np.ndarray,
    more: list,
    threads: int,
) -> None:
    """Launch a kernel over the rows of the tile's diamonds `bisections` above the cells.

    The diamonds on a tile's western and southern side belong to it. The last tiles have those at the border and beyond.
    whole: layout of this depth in the raster's array that the kernel writes. values: array of the window that it
    reads. more: its other arguments, the written array last.
    """
    shift, in_window, lattice = bisections // 2, window.depths[bisections], window.lattice
    axes = (lattice.cells_x, in_window.columns), (lattice.cells_y, in_window.rows)
    first, counts = [], []  # the tile's first diamond in the window, and their number, along x and y
    for (low, high), (window_start, _), (cells, count) in zip(window.tile, window.box, axes, strict=True):
        is_last_tile = high == cells  # it also has the sides on the raster's border
        end = count + in_window.sides if is_last_tile else (high - window_start) >> shift
        first.append((low - window_start) >> shift)
        counts.append(end - first[-1])
    corner = window.corner(bisections)  # the window's first diamond in the raster
    inputs = [wp.vec2i(*first), counts[0], in_window, whole, corner, flat(values, wp.float32), *more]
    launch_step(kernel, counts[1], inputs, threads, 2.0 * counts[0])


def _add_errors(
    field: HeightField,
    bisections: int,
    below: Depth,
    above: Depth,
    corner: wp.vec2i,
    off: np.ndarray,
    errors: np.ndarray,
    threads: int,
) -> None:
    """Compute `off` and `errors` of the depth `bisections` above the cells from those of the depth below it.

    A diamond's error is its bilinear error, from the codes of `field`, plus `off`, and never less than its children's.
    Its `off`, the largest distance of the bicubic surface from the bilinear one, is the largest of its children. Both
    in metres. below, above: layouts of both depths in `off` and `errors`. corner: the first diamond of `above` in the
    raster.
    """
    depth = field.lattice.cell_depth - bisections
    inputs = [below, above, stored_at(field.lattice, depth), corner, flat(field.table, wp.float32)]
    inputs += [field.lattice.group(depth), *pack_pages(field.error, wp.uint8)]
    inputs += [flat(off, wp.float32), flat(errors, wp.float32)]
    launch_step(kernels.add_errors, items(above), inputs, threads)


def _layout_from(lattice: Lattice, bisections: int, first: int) -> Depth:
    """Return the layout of a depth in arrays that begin with entry `first` of the error hierarchy.

    bisections: number of bisections above the cells.
    """
    depth = stored_at(lattice, lattice.cell_depth - bisections)
    depth.base -= first
    return depth


def _whole_groups(lattice: Lattice, parts: list[slice]) -> list[tuple[int, slice]]:
    """Return the groups that no tile encodes, with their parts of the arrays."""
    return [(group, parts[group]) for group in range(FIRST_WHOLE, lattice.groups)]


def launch_step(kernel: wp.Kernel, count: int, inputs: list, threads: int, cost: float = 1.0) -> None:
    """Launch a kernel over `count` items as the step "bicubic hierarchy". cost: of an item, in units of about 15 ns."""
    launch.spread(kernel, count, inputs, step="bicubic hierarchy", threads=threads, cost=cost)
