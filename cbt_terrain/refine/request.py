# SPDX-License-Identifier: GPL-3.0-or-later
"""The arguments of a refinement."""

from dataclasses import dataclass

from ...kernels.field.domain import Domain
from ...kernels.refine.pixels import CriterionArrays


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
