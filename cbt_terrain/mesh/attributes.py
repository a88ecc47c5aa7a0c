# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a mesh: named arrays, each with a domain and a unit.

The welding, an overlay or an effect adds one to a Surface by name. The mesh writer, the archive and the exporters write
all attributes of a Surface. Names, domains and data types are Blender's.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError

DOMAINS = POINT, EDGE, FACE, CORNER = "POINT", "EDGE", "FACE", "CORNER"
# The attributes that every Surface has.
NORMALS, UV, LEVEL = "normals", "uv", "terrain_level"
# dtype and numbers an element -> Blender's data type, and the property of its elements that has the numbers.
TYPES = {
    ("float32", 1): ("FLOAT", "value"),
    ("float32", 2): ("FLOAT2", "vector"),
    ("float32", 3): ("FLOAT_VECTOR", "vector"),
    ("float32", 4): ("FLOAT_COLOR", "color"),  # scene-linear RGBA
    ("int32", 1): ("INT", "value"),
    ("int8", 1): ("INT8", "value"),
    ("bool", 1): ("BOOLEAN", "value"),
}


@dataclass(frozen=True)
class Attribute:
    """A value for each element of a domain.

    `array`: [n], or [n, width] for several numbers each, of a dtype and width in TYPES. `domain`: one of DOMAINS.
    `unit`: the numbers' unit, as "m" or "px"; "" where they have none.
    """

    array: np.ndarray
    domain: str
    unit: str = ""

    @property
    def kind(self) -> tuple[str, int]:
        """Return the key in TYPES: the dtype, and how many numbers an element has."""
        return self.array.dtype.name, math.prod(self.array.shape[1:])

    def check(self, name: str, sizes: dict[str, int]) -> None:
        """Raise TerrainError unless a mesh can carry the attribute.

        Its `kind` (dtype and width) must be one of TYPES. sizes: number of elements of the mesh, by domain.
        """
        what = f"The attribute {name!r} is {self.array.dtype} {list(self.array.shape)} of the domain {self.domain!r}"
        if self.domain not in sizes:
            raise TerrainError(what, expected=f"one of {', '.join(DOMAINS)}")
        if self.kind not in TYPES or self.array.ndim != (2 if self.kind[1] > 1 else 1):
            known = ", ".join(f"{width} {dtype}" for dtype, width in TYPES)
            raise TerrainError(what, expected=f"for each element one of these: {known}")
        if len(self.array) != sizes[self.domain]:
            raise TerrainError(what, expected=f"{sizes[self.domain]} elements, the number of the mesh")
