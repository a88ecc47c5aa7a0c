# SPDX-License-Identifier: GPL-3.0-or-later
"""The arguments of an update: besides its height field, a terrain's mesh depends on nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError
from .criterion import Criterion
from .linear import determinant
from .view import View


@dataclass(frozen=True, eq=False)
class UpdateRequest:
    """Arguments of one update.

    `placement`: float64 [4, 4], terrain to world. Heights become `height * vertical_scale + vertical_offset` metres.
    """

    criterion: Criterion
    views: Sequence[View]
    placement: np.ndarray
    vertical_scale: float
    vertical_offset: float

    def key(self) -> tuple:
        """Return a value that is equal for requests with the same result."""
        views = tuple(view.key() for view in self.views)
        return self.criterion, views, self.placement.tobytes(), self.vertical_scale, self.vertical_offset

    def check(self) -> None:
        """Raise TerrainError for a criterion, views or a placement that an update cannot use."""
        if self.placement.shape != (4, 4) or not np.isfinite(self.placement).all():
            raise TerrainError(
                "The terrain's matrix has a value that is not finite",
                expected="4 x 4 finite numbers",
                fix="check its location and its parents",
            )
        if not abs(determinant(self.placement[:3, :3])) > 0:
            raise TerrainError("The terrain is scaled to zero in some direction", fix="give it a scale other than 0")
        if self.criterion.needs_view and not self.views:
            raise TerrainError(
                "The criterion is measured in pixels and there is no camera",
                fix="add a camera, or use a criterion in metres",
            )
