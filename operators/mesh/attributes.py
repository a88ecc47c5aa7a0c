# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a Surface into a Blender mesh, and back."""

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.mesh.attributes import TYPES, Attribute

KINDS = {data_type: (dtype, width, values) for (dtype, width), (data_type, values) in TYPES.items()}


def add(mesh, name: str, attribute: Attribute) -> None:
    """Make it, with any values. All are made before one is written, since Blender may move what a mesh has already."""
    made = mesh.attributes.new(name, TYPES[attribute.kind][0], attribute.domain)
    if made.name != name:
        raise TerrainError(f"Blender has no room for an attribute of the name {name!r}: give it another name.")


def write(mesh, name: str, attribute: Attribute) -> None:
    """Its values, into the attribute that `add` has made."""
    mesh.attributes[name].data.foreach_set(TYPES[attribute.kind][1], attribute.array.ravel())


def read(mesh, name: str, unit: str = "") -> Attribute:
    """The mesh's attribute of this name, in an array of its own."""
    found = mesh.attributes[name]
    dtype, width, values = KINDS[found.data_type]
    array = np.empty(len(found.data) * width, dtype)
    found.data.foreach_get(values, array)
    return Attribute(array.reshape(-1, width) if width > 1 else array, found.domain, unit)
