# SPDX-License-Identifier: GPL-3.0-or-later
"""What a demand is: names of attributes, each with who reads it."""

from typing import NamedTuple

# Names beside those of attributes: every attribute there is; what the mesh has as its active ones.
ALL, ACTIVE_COLOR, ACTIVE_UV = "*", "<active color>", "<active uv>"
VERTEX_GROUP = "vertex group "


class Reader(NamedTuple):
    """Who reads an attribute. `words`: for people, as "material Rock, node Attribute.003". `family`: PICTURE for what
    pixels show, GEOMETRY for what geometry is made from (cbt_terrain/effects/effect.py)."""

    words: str
    family: str


class Demand(dict[str, list[Reader]]):
    """Readers by the name of what they read."""

    def add(self, name: str, words: str, family: str) -> None:
        readers = self.setdefault(name, [])
        if (reader := Reader(words, family)) not in readers:
            readers.append(reader)

    def merge(self, other: "Demand") -> None:
        for name, readers in other.items():
            for reader in readers:
                self.add(name, *reader)
