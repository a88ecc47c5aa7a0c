# SPDX-License-Identifier: GPL-3.0-or-later
"""A placed height field as kernel arguments."""

import warp as wp

from ...kernels.field.domain import Domain
from ..run.buffers import shared
from . import codes
from .depths import depth_limit
from .displacement_layers import fill_layers
from .heightfield import HeightField
from .lattice import MAX_MESHLET, Lattice
from .meshlet_errors import error_for

# Beyond all coordinates.
NO_BORDER = 2**31 - 1


def raster_border(lattice: Lattice, unit_bits: int) -> tuple[int, int]:
    """Return the lattice units at which the raster ends in the east and in the north.

    NO_BORDER stands for a side where the lattice ends with the raster.
    """
    bits, sides = unit_bits - lattice.levels, zip((lattice.cells_x, lattice.cells_y), lattice.span, strict=True)
    return tuple(NO_BORDER if cells == span else cells << bits for cells, span in sides)


def make_domain(field: HeightField, meshlet: int, height_scale: float, height_offset: float) -> Domain:
    """Return the placed field for kernels that draw its leaves as 4**meshlet triangles. Memory is shared, nothing is
    read."""
    lattice = field.lattice
    domain = Domain()
    domain.columns, domain.rows, domain.levels = lattice.columns, lattice.rows, lattice.levels
    domain.unit_bits = max(lattice.levels, depth_limit(field) // 2 + 1) + MAX_MESHLET
    unit = 2.0 ** (lattice.levels - domain.unit_bits)
    domain.unit_x, domain.unit_y = lattice.step_x * unit, lattice.step_y * unit
    domain.west, domain.south, _, _ = lattice.rectangle()
    domain.east, domain.north = raster_border(lattice, domain.unit_bits)
    domain.height_scale, domain.height_offset = height_scale, height_offset
    domain.range_base, domain.range_step = field.range_base, field.range_step
    domain.error_scale = abs(height_scale)
    domain.source = field.source_max * abs(height_scale)
    fill_layers(domain, field.detail, field.finest_edge, lattice, meshlet)
    domain.border_depth = 2 * (lattice.levels - meshlet)
    domain.bicubic = int(field.interpolation == "bicubic")
    base, pages = lattice.layout()
    domain.base, domain.pages = shared(base, wp.int64), shared(pages, wp.int32)
    domain.cell_base, domain.cell_pages = base[-2], pages[-1]
    domain.cell_columns, domain.cell_rows = lattice.extent(lattice.cell_depth)
    domain.cell_group, domain.curvature_group = lattice.groups, lattice.groups + domain.bicubic
    domain.error = shared(error_for(field, meshlet), wp.uint8)
    domain.table = shared(field.table.reshape(-1), wp.float32)
    base, pages = lattice.range_layout()
    domain.range_first, domain.range_pages = shared(base, wp.int64), shared(pages, wp.int32)
    domain.range_cells = base[-2]
    domain.ranges = shared(field.ranges.reshape(-1), wp.uint16)
    domain.samples = codes.packed(field.samples, field.steps)
    return domain
