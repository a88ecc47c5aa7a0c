# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel arguments: the height field with its lattice and placement, the criterion, and the depth limits."""

import math

import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine import curve
from ...kernels.refine.pixels import CriterionArrays, LocalView
from ..field import codes
from ..field.detail import EDGES_A_WAVE
from ..field.detail_bounds import highest, radius_at
from ..field.displacement_layers import layer_tables, layers_below, mask_levels, max_of_masks
from ..field.heightfield import PLANE_BITS, HeightField
from ..field.lattice import MAX_MESHLET, Lattice
from ..field.meshlet_errors import error_for
from ..run.buffers import shared
from ..view.criterion import Criterion
from ..view.morph import mean_ramp
from ..view.spans import Spans
from .terms import MARGIN, Rounding, weighed_as

# Depth of the tree, root squares included: 8 MB of address space; with displacement half a gigabyte. The system commits
# only pages that are used.
MAX_TREE_DEPTH, MAX_DETAIL_DEPTH = 34, curve.DEEPEST
# Default bisections below the raster's cells: a patch's twist is then 4^4 times smaller.
DEPTH_BELOW_CELLS = 8
# An error is refined until it is this fraction of the rounding of float32 and of the source: more triangles cannot make
# a bound a fifth smaller.
ENOUGH = 0.25
EXACT = Rounding()
# Beyond all coordinates.
NO_BORDER = 2**31 - 1


def depth_limit(field: HeightField) -> int:
    """Return the deepest bisection of a root square that float32 plane coordinates and the tree can represent."""
    lattice = field.lattice
    side_bits = (max(lattice.columns, lattice.rows) - 1).bit_length()
    tree_depth = MAX_DETAIL_DEPTH if field.detail else MAX_TREE_DEPTH
    return max(1, min(2 * (PLANE_BITS - side_bits), tree_depth - lattice.square_bits))


def usual_depth(field: HeightField) -> int:
    """Return the default depth at which refinement stops; with displacement it resolves the shortest wave."""
    lattice, depth = field.lattice, field.lattice.cell_depth + DEPTH_BELOW_CELLS
    edge = min((part.shortest for part in field.parts), default=0.0) / EDGES_A_WAVE
    if edge:
        longest = 2 * radius_at((lattice.step_x, lattice.step_y), lattice.levels, depth)
        depth += max(0, math.ceil(2 * math.log2(longest / edge)))
    return min(depth, depth_limit(field))


def raster_border(lattice: Lattice, unit_bits: int) -> tuple[int, int]:
    """Return the lattice units at which the raster ends in the east and in the north.

    NO_BORDER stands for a side where the lattice ends with the raster.
    """
    bits, sides = unit_bits - lattice.levels, zip((lattice.cells_x, lattice.cells_y), lattice.span, strict=True)
    return tuple(NO_BORDER if cells == span else cells << bits for cells, span in sides)


def make_domain(
    field: HeightField, meshlet: int, height_scale: float, height_offset: float, rounding: Rounding = EXACT
) -> Domain:
    """Return the height field as kernel arguments, without reading or copying its arrays.

    rounding: errors of float32 positions, see `terms.rounding`.
    """
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
    domain.rounding, domain.lean, domain.max_lean = rounding.height, rounding.lean, rounding.max_lean
    domain.source = field.source_max * abs(height_scale)
    domain.enough = ENOUGH * (domain.rounding + domain.source)
    _pack_detail(domain, field, meshlet)
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


def _pack_detail(domain: Domain, field: HeightField, meshlet: int) -> None:
    parts, ground, lattice = field.parts, field.detail, field.lattice
    domain.detailed, domain.max_detail = int(bool(parts)), highest(parts)
    tables = layer_tables(ground, field.finest_edge, lattice, meshlet)
    domain.detail = shared(tables.reshape(-1, 2), wp.vec2f)
    domain.masked = sum(int(layer.mask is not None) for layer in layers_below(ground))
    levels = mask_levels(lattice)
    domain.mask_max, domain.mask_top = shared(max_of_masks(ground), wp.uint8), len(levels) - 2
    domain.mask_first = shared(levels, wp.int64)


def pack(criterion: Criterion, views: list[LocalView], spans: Spans, source: float) -> CriterionArrays:
    """Return a criterion in the pixel footprints of the kernels.

    With geomorphing it is finer, so that the mean over the ramp meets the criterion. source: largest error of the
    source's heights, metres.
    """
    arrays, mean = CriterionArrays(), mean_ramp(criterion.morph_until)

    def squared(value: float) -> float:
        return value / mean * (value / mean) if value > 0 else math.inf

    arrays.view_count = len(views)
    arrays.measures_edges = int(criterion.measures_edges)
    arrays.error_px2, arrays.edge_px2 = squared(criterion.error_px), squared(criterion.edge_px * spans.edge)
    arrays.area_px2 = 2 * squared(math.sqrt(criterion.area_px) * spans.edge)
    arrays.metres2 = squared(weighed_as(criterion.error_m, source, mean) * mean * (1 - 2 * MARGIN))
    arrays.diagonal2, arrays.axis2 = spans.lengths
    arrays.limit = 1.0
    views = views or [LocalView()]
    arrays.view, arrays.views = views[0], wp.array(views, dtype=LocalView, device="cpu")
    return arrays
