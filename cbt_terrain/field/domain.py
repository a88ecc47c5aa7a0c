# SPDX-License-Identifier: GPL-3.0-or-later
"""A placed height field: its kernel arguments and its bounding box."""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ..errors import TerrainError
from ..run.buffers import flat, shared
from . import codes
from .depths import depth_limit
from .displacement_layers import fill_layers
from .heightfield import HeightField
from .lattice import MAX_MESHLET
from .meshlet_errors import error_for
from .shared_pages import pack_pages

# Beyond all coordinates: the lattice ends with the raster.
NO_BORDER = 2**31 - 1


def make_domain(field: HeightField, meshlet: int, height_scale: float, height_offset: float) -> Domain:
    """Return the field, scaled and shifted in height, as the kernels of a frame read it.

    meshlet: leaves are drawn as 4**meshlet triangles; its errors are loaded or computed on first use (`error_for`).
    height_scale: factor, height_offset: metres. Memory is shared, no sample is read.
    """
    lattice = field.lattice
    domain = Domain()
    domain.columns, domain.rows, domain.levels = lattice.columns, lattice.rows, lattice.levels
    # Corners of triangles are integers: a unit is a cell halved `unit_bits - levels` times. Two bisections halve a
    # side, and so does each step of a meshlet.
    wanted_bits = max(lattice.levels, depth_limit(field) // 2 + 1) + MAX_MESHLET
    domain.unit_bits = min(wanted_bits, lattice.unit_bits)
    unit = 2.0 ** (lattice.levels - domain.unit_bits)
    domain.unit_x, domain.unit_y = lattice.step_x * unit, lattice.step_y * unit
    domain.west, domain.south, _, _ = lattice.rectangle()
    # Cells of the raster, and with padding. If they are equal, no triangle crosses the raster's border.
    sides = (lattice.cells_x, lattice.span[0]), (lattice.cells_y, lattice.span[1])
    cell_bits = domain.unit_bits - lattice.levels  # log2 of a cell's units
    domain.east, domain.north = (NO_BORDER if cells == padded else cells << cell_bits for cells, padded in sides)
    domain.height_scale, domain.height_offset = height_scale, height_offset
    domain.range_base, domain.range_step = field.range_base, field.range_step
    domain.error_scale = abs(height_scale)
    domain.source = field.source_max * abs(height_scale)
    fill_layers(domain, field.detail, field.finest_edge, lattice, meshlet)
    finer = field.finer
    if finer is not None:
        # `detailed`: displacement layers or finer tiles add to the raster's errors.
        domain.has_finer, domain.finer, domain.detailed = 1, finer.packed, 1
    domain.max_change = field.max_change
    # Depth of the deepest leaves with triangles across the raster's border: a leaf of this depth is drawn as triangles
    # of a cell's size.
    domain.border_depth = 2 * (lattice.levels - meshlet)
    domain.bicubic = int(field.interpolation == "bicubic")
    base, pages = lattice.layout()  # first entries of the groups of depths, of the cells, and the end; pages in a row
    domain.base, domain.pages = shared(base, wp.int64), shared(pages, wp.int32)
    domain.cell_base, domain.cell_pages = base[-2], pages[-1]
    domain.cell_columns, domain.cell_rows = lattice.extent(lattice.cell_depth)
    # Numbers of the cells' and the curvatures' tables of codes, which follow those of the groups.
    domain.cell_group, domain.curvature_group = lattice.groups, lattice.groups + domain.bicubic
    domain.error, domain.error_places = pack_pages(error_for(field, meshlet), wp.uint8)
    domain.table = flat(field.table, wp.float32)
    base, pages = lattice.range_layout()
    domain.range_first, domain.range_pages = shared(base, wp.int64), shared(pages, wp.int32)
    domain.range_cells = base[-2]
    domain.ranges, domain.range_places = pack_pages(field.ranges, wp.uint16)
    # `steps`: how 16-bit samples convert to metres, None for float32.
    domain.samples = codes.pack_samples(field.samples, field.steps)
    return domain


def box_of(field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """Return float64 [2, 3]: lowest and highest corner of the terrain's bounding box in its own space, metres.

    Heights are those of `field`, its detail included, times `vertical_scale` plus `vertical_offset` metres.
    Raises TerrainError if a mesh, which has float32 positions, cannot hold it.
    """
    west, south, east, north = field.lattice.rectangle()
    z = sorted(h * vertical_scale + vertical_offset for h in (field.min_height, field.max_height))
    box = np.array([[west, south, z[0]], [east, north, z[1]]])
    largest = float(np.finfo(np.float32).max)
    if not np.abs(box[:, :2]).max() < largest:
        raise TerrainError(
            f"The terrain is {east - west:g} x {north - south:g} m",
            expected="a size that float32 can hold",
            fix="import it smaller",
        )
    if not np.abs(box).max() < largest:
        raise TerrainError(
            f"The vertical scale {vertical_scale} and offset {vertical_offset} give heights that no mesh can hold",
            expected="less than 3e38 metres",
            fix="check both, and drivers that set them",
        )
    return box
