# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface as data: points, topology and attributes, in the arrays that Blender keeps."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import check_kind
from .attributes import CORNER, EDGE, FACE, LEVEL, NORMALS, POINT, UV, Attribute


@dataclass(frozen=True, eq=False)
class Surface:
    """A welded triangle mesh.

    The arrays of an update are read-only and stay as they are; those of a `copy` can be written.

    `positions` float32 [V, 3], metres in the terrain's own space. `corner_verts`, `corner_edges` int32 [3 T]: edge c
    of a triangle runs from its corner c to the next. `edges` int32 [E, 2]. `attributes`: what else it carries, by name;
    always `normals` (POINT, float32 [V, 3]: unit length), `uv` (POINT, float32 [V, 2]: 0 .. 1 from west to east, south
    to north) and `terrain_level` (FACE, int32 [T]: bisections of a root square).
    """

    positions: np.ndarray
    corner_verts: np.ndarray
    corner_edges: np.ndarray
    edges: np.ndarray
    attributes: dict[str, Attribute]

    @property
    def triangles(self) -> np.ndarray:
        """Return the vertices of the triangles, counter-clockwise seen from above: int32 [T, 3]."""
        return self.corner_verts.reshape(-1, 3)

    @property
    def normals(self) -> np.ndarray:
        """Return the unit normals of the vertices: float32 [n, 3]."""
        return self.attributes[NORMALS].array

    @property
    def uv(self) -> np.ndarray:
        """Return the texture coordinates of the vertices: float32 [n, 2]."""
        return self.attributes[UV].array

    @property
    def level(self) -> np.ndarray:
        """Return the levels of the triangles, bisections of a root square: int32 [T]."""
        return self.attributes[LEVEL].array

    @property
    def sizes(self) -> dict[str, int]:
        """Return the number of elements of each domain."""
        corners = len(self.corner_verts)
        return {POINT: len(self.positions), EDGE: len(self.edges), FACE: corners // 3, CORNER: corners}

    def with_attributes(self, attributes: dict[str, Attribute]) -> "Surface":
        """Return the mesh with added or replaced attributes. Raises TerrainError if one does not fit."""
        for name, attribute in attributes.items():
            attribute.check(name, self.sizes)
        return replace(self, attributes=self.attributes | attributes)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays by name: positions, topology and attributes."""
        topology = {name: array for name, array in vars(self).items() if name != "attributes"}
        return topology | {name: attribute.array for name, attribute in self.attributes.items()}

    def with_arrays(self, arrays: dict[str, np.ndarray]) -> "Surface":
        """Return the mesh with other arrays. arrays: by name, all that `arrays()` has."""
        attributes = {name: replace(a, array=arrays[name]) for name, a in self.attributes.items()}
        return replace(self, attributes=attributes, **{name: arrays[name] for name in arrays.keys() - attributes})

    def copy(self) -> "Surface":
        """Return the same mesh in new arrays, which can be written."""
        return self.with_arrays({name: array.copy() for name, array in self.arrays().items()})

    def __repr__(self) -> str:
        return f"<Surface: {len(self.triangles):,} triangles, {len(self.positions):,} vertices>"


def check_surface(surface: object) -> None:
    """Raise TerrainError unless a caller's surface is one, as for an `Update`."""
    check_kind(surface, Surface, "The surface", "a Surface, as the `surface` of an update")
