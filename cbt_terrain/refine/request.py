# SPDX-License-Identifier: GPL-3.0-or-later
"""The arguments of a refinement."""

from dataclasses import dataclass

from ...kernels.field.domain import Domain
from ...kernels.refine.pixels import CriterionArrays


@dataclass(frozen=True)
class RefinementRequest:
    """What to refine: the criterion `asked` on a placed field, down to `max_depth`, to at most `max_leaves`.

    `is_limited`: a user has limited the triangles, so that `max_leaves` may well be too few. Vertices morph until the
    ratio `morph_until`: then the mesh may be off by so many times the criterion. Fewer leaves than two a root square
    are impossible.
    """

    domain: Domain
    asked: CriterionArrays
    max_depth: int
    max_leaves: int
    is_limited: bool = False
    morph_until: float = 1.0
