# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as hashable values that are compared by their content."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import TerrainError
from .digests import digest_of


@dataclass(frozen=True)
class Painted:
    """An image: float32 [rows, columns], row 0 south; equal to another one with equal values."""

    values: np.ndarray = field(compare=False, repr=False)
    digest: str = ""

    def __post_init__(self) -> None:
        """Convert the values to float32, check them and compute their digest. Raises TerrainError."""
        values = np.ascontiguousarray(self.values, np.float32)
        if values.ndim != 2 or values.size == 0 or not np.isfinite(values).all():
            raise TerrainError(
                f"A painted image has shape {list(values.shape)} or values that are not finite",
                expected="rows and columns of finite numbers",
                fix="paint it again, or choose another",
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "digest", digest_of([values], repr(values.shape)))
