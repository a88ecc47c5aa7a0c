# SPDX-License-Identifier: GPL-3.0-or-later
"""The arguments of a refinement.

A Domain is the height field and CriterionArrays are the criterion with its views, both as the kernels read them.
"""

import math
from dataclasses import dataclass

import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine.local_view import LocalView
from ...kernels.refine.pixels import CriterionArrays
from ..field.domain import make_domain
from ..field.heightfield import HeightField
from ..view.criterion import Criterion
from ..view.morph import mean_ramp
from ..view.spans import Spans
from .terms import MARGIN, Rounding, weighed_as

# An error is refined until it is this fraction of the rounding of float32 and of the source: more triangles cannot make
# a bound a fifth smaller.
ENOUGH = 0.25


@dataclass(frozen=True)
class RefinementRequest:
    """The criterion on a placed field, the depth limit, and the largest number of leaves.

    `is_limited`: the user has limited the triangles, so `max_leaves` is often exceeded. `morph_until`: ratio at which
    vertices finish morphing; the mesh's error may be that many times the criterion. A mesh has at least two leaves per
    root square.
    """

    domain: Domain
    criterion: CriterionArrays
    max_depth: int
    max_leaves: int
    is_limited: bool = False
    morph_until: float = 1.0


def refinable_domain(
    field: HeightField, meshlet: int, height_scale: float, height_offset: float, rounding: Rounding
) -> Domain:
    """Return the placed field as a refinement reads it.

    Heights become height * height_scale + height_offset metres. rounding: how far float32 positions can move the mesh.
    meshlet: leaves are drawn as 4**meshlet triangles.
    """
    domain = make_domain(field, meshlet, height_scale, height_offset)
    # For `lean` and `near`, by which plane coordinates count, see `Rounding`.
    domain.rounding, domain.lean, domain.max_lean = rounding.height, rounding.lean, rounding.max_lean
    domain.near_x, domain.near_y = rounding.near
    domain.enough = ENOUGH * (domain.rounding + domain.source)  # smaller errors are not refined further
    return domain


def pack(criterion: Criterion, views: list[LocalView], spans: Spans, source: float) -> CriterionArrays:
    """Return a criterion in the pixel footprints of the kernels.

    With geomorphing it is finer, so that the mean over the ramp meets the criterion. source: largest error of the
    source's heights, metres.
    """
    arrays, mean = CriterionArrays(), mean_ramp(criterion.morph_until)

    def squared(value: float) -> float:
        """Return the square of a limit divided by the mean of the ramp; infinity for 0, which switches it off."""
        return value / mean * (value / mean) if value > 0 else math.inf

    arrays.view_count = len(views)
    arrays.measures_edges = int(criterion.measures_edges)
    arrays.error_px2, arrays.edge_px2 = squared(criterion.error_px), squared(criterion.edge_px * spans.edge)
    # Twice the area is the squared leg of a right triangle of two equal legs.
    arrays.area_px2 = 2 * squared(math.sqrt(criterion.area_px) * spans.edge)
    # `weighed_as` has divided by the mean already; the margin covers the rounding of the bound.
    arrays.metres2 = squared(weighed_as(criterion.error_m, source, mean) * mean * (1 - 2 * MARGIN))
    arrays.diagonal2, arrays.axis2 = spans.lengths  # of a lattice unit, squared already
    arrays.limit = 1.0  # factor on all squared limits: not relaxed yet
    views = views or [LocalView()]  # kernels get an array that is not empty
    arrays.view, arrays.views = views[0], wp.array(views, dtype=LocalView, device="cpu")
    return arrays
