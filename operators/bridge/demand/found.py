# SPDX-License-Identifier: GPL-3.0-or-later
"""A demand: names of attributes, each with its readers."""

from typing import NamedTuple

# Special names: every attribute; the active ones of the mesh.
ALL, ACTIVE_COLOR, ACTIVE_UV = "*", "<active color>", "<active uv>"
VERTEX_GROUP = "vertex group "


class Reader(NamedTuple):
    """A reader of an attribute.

    Attributes:
        label: its name for people: "material Rock, node Attribute.003".
        family: PICTURE if pixels show the attribute, GEOMETRY if geometry is made from it.
        at_hit: the reader is a Raycast node, which reads the attribute where its rays hit.
    """

    label: str
    family: str
    at_hit: bool = False


class Demand(dict[str, list[Reader]]):
    """Readers by attribute name."""

    def add(self, name: str, label: str, family: str, at_hit: bool = False) -> None:
        """Add a reader of the attribute `name`, once. label: the reader's name for people.

        family: PICTURE if pixels show the attribute, GEOMETRY if geometry is made from it. at_hit: it is read where
        rays hit.
        """
        readers = self.setdefault(name, [])
        if (reader := Reader(label, family, at_hit)) not in readers:
            readers.append(reader)

    def merge(self, other: "Demand") -> None:
        """Add all readers of another demand."""
        for name, readers in other.items():
            for reader in readers:
                self.add(name, *reader)
