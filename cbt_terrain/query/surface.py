# SPDX-License-Identifier: GPL-3.0-or-later
"""A height field as the kernels of queries read it, and the check that all queries share."""

import numpy as np
import warp as wp

from ...kernels.query import crossing
from ...kernels.query import rays as ray_kernels
from ...kernels.query import surface as kernels
from ..field import codes, displacement_layers
from ..field.domain import box_of
from ..field.heightfield import PLANE_BITS, HeightField, check_field
from ..field.shared_pages import pack_pages
from ..plain_numbers import vertical
from ..run.buffers import flat, shared
from ..view.linear import add_up

# Of the longer half side: the rounding error of a float32 position on the border.
ROUNDED = 2.0 ** -(PLANE_BITS + 1)

# Of the greatest height: more than float64 rounds off a sum of heights.
ROUNDED_HEIGHT = 1e-12
# Of the relief plus the greatest height: far more than the rounding of the lowest and the highest height.
SPARE = 1e-3


def pack_surface(field: HeightField, vertical_scale: float, vertical_offset: float) -> kernels.QueriedSurface:
    """Return the surface `height * vertical_scale + vertical_offset` as the kernels of queries read it.

    Memory is shared, nothing is read. Raises TerrainError for a scale that a mesh cannot have.
    """
    check_field(field)
    vertical_scale, vertical_offset = vertical(vertical_scale, vertical_offset)
    box_of(field, vertical_scale, vertical_offset)  # refuses numbers that cannot be used
    lattice, surface = field.lattice, kernels.QueriedSurface()
    surface.west, surface.south, east, north = lattice.rectangle()
    surface.step_x, surface.step_y = lattice.step_x, lattice.step_y
    surface.per_x, surface.per_y = 1.0 / lattice.step_x, 1.0 / lattice.step_y
    # Cells by which a position that float32 has rounded may be beyond the border.
    surface.border_x = ROUNDED * max(-surface.west, east) / lattice.step_x
    surface.border_y = ROUNDED * max(-surface.south, north) / lattice.step_y
    surface.scale, surface.offset = vertical_scale, vertical_offset
    surface.bicubic = int(field.interpolation == "bicubic")
    surface.samples = codes.pack_samples(field.samples, field.steps)
    surface.layers = displacement_layers.pack_layers(field.detail, field.finest_edge, lattice)
    if field.finer is not None:
        surface.has_finer, surface.finer = 1, field.finer.packed
    surface.holed = int(field.valid is not None)
    surface.valid = flat(np.ones(1, np.uint8) if field.valid is None else field.valid, wp.uint8)
    return surface


def height_ranges_of(field: HeightField, surface: kernels.QueriedSurface) -> crossing.HeightRanges:
    """Return the ranges of heights, in metres after the scaling of `surface`, by which rays skip whole blocks of cells.

    Ranges are stored for blocks of 2^2, 2^4 .. 2^top cells a side, as codes: a height is base + code * step metres.
    Memory is shared, nothing is read.
    """
    lattice, ranges = field.lattice, crossing.HeightRanges()
    ranges.top = lattice.levels // ray_kernels.STEP * ray_kernels.STEP
    ranges.low_z, ranges.high_z = sorted(
        h * surface.scale + surface.offset for h in (field.min_height, field.max_height)
    )
    ranges.spare = SPARE * (ranges.high_z - ranges.low_z + max(abs(ranges.low_z), abs(ranges.high_z)))
    ranges.base, ranges.step = field.range_base * surface.scale + surface.offset, field.range_step * surface.scale
    ranges.widening = widening_of(field, surface, field.max_change)
    first, pages = lattice.range_layout()
    ranges.first, ranges.pages = shared(first, wp.int64), shared(pages, wp.int32)
    ranges.ranges, ranges.range_places = pack_pages(field.ranges, wp.uint16)
    # First entries of the ranges of cells (behind those of all blocks), and of the curvatures (behind all errors).
    # `table` has metres of the codes by group: `groups` groups of depths, then the cells, then the curvatures.
    ranges.cells, ranges.curvatures = first[-2], lattice.node_count
    ranges.cell_pages, ranges.curvature_group = pages[-1], lattice.groups + 1
    ranges.error, ranges.error_places = pack_pages(field.error, wp.uint8)
    ranges.table = flat(field.table, wp.float32)
    # Each term of the displacement is bounded in several ways as a smooth part, whose curvature is known, plus a
    # remainder. In the first way there is no remainder, so its curvature bounds that of the whole term.
    ranges.detail_curvature = add_up(part.splits[0].curvature for part in field.parts)
    return ranges


def widening_of(field: HeightField, surface: kernels.QueriedSurface, change: float) -> float:
    """Return the metres by which ranges of heights are widened, since they leave out displacement and are rounded.

    change: largest displacement, metres before the scaling of `surface`.
    """
    ends = (abs(height * surface.scale + surface.offset) for height in (field.min_height, field.max_height))
    return change * abs(surface.scale) + ROUNDED_HEIGHT * max(ends)
