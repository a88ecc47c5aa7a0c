# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the OpenEXR channel that holds heights: by a given name, or the one with the likeliest name."""

import re
from dataclasses import dataclass

HEIGHT = re.compile(
    r"height|elevation|displace|terrain|altitude|relief|(?<![a-z])(dem|dtm|dsm|elev|disp|alt|h|hgt|bump)(?![a-z])"
)
DEPTH = re.compile(r"depth")
VECTOR = re.compile(r"normal|vector|position|motion|velocity|tangent|(?<![a-z])(uv|n|p|st)(?![a-z])")
OTHER = re.compile(r"mask|alpha|crypto|matte|variance|noise|sample|(?<![a-z])(a|id|index)(?![a-z])")
COMPONENTS = ("z", "y", "v", "r", "red", "x")  # preferred in this order within a layer, after all others


@dataclass(frozen=True)
class ExrChannel:
    """One channel of one part of a file.

    part: its number. part_name: "" in files of one part. sampling: pixels for each sample along x and y.
    """

    part: int
    part_name: str
    name: str
    sampling: tuple[int, int] = (1, 1)

    @property
    def layer(self) -> str:
        """Return the name of the channel's layer, "" for a channel outside layers."""
        return self.name.rpartition(".")[0]

    @property
    def component(self) -> str:
        """Return the last part of the channel's name, in lower case: "r", "z"."""
        return self.name.rpartition(".")[2].casefold()

    @property
    def full_name(self) -> str:
        """Return PART.CHANNEL, or the channel's name if that begins with the part's or there is only one part."""
        if not self.part_name or self.name.startswith(self.part_name + "."):
            return self.name
        return f"{self.part_name}.{self.name}"


def channels_by_name(channels: list[ExrChannel], name: str) -> list[ExrChannel]:
    """Return the channels that a user may mean by a name, the likeliest first.

    name: CHANNEL, LAYER.CHANNEL, PART.CHANNEL, LAYER or PART. Upper and lower case count only if that finds a
    channel. A layer or a part stands for its likeliest channel, unless a channel has that name. [] without any.
    """
    for fold in (str, str.casefold):
        sought = fold(name)
        candidates = [
            [channel]
            for channel in channels
            if sought in map(fold, (channel.name, channel.full_name, f"{channel.part_name}.{channel.name}"))
        ]
        if not candidates:
            groups: dict[tuple, list[ExrChannel]] = {}
            for channel in channels:
                if sought in (fold(channel.part_name), fold(channel.layer)):
                    # A part is one group, whatever layers it has.
                    layer = channel.layer if sought != fold(channel.part_name) else None
                    groups.setdefault((channel.part, layer), []).append(channel)
            candidates = list(groups.values())
        if candidates:
            meant = [likeliest(group, channels) for group in candidates]
            return sorted(meant, key=lambda channel: _rank(channel, channels))
    return []


def likeliest(choice: list[ExrChannel], channels: list[ExrChannel]) -> ExrChannel:
    """Return the channel of `choice` that most likely holds heights, by its name. channels: all of the file."""
    return min(choice, key=lambda channel: _rank(channel, channels))


def _rank(channel: ExrChannel, channels: list[ExrChannel]) -> tuple[int, int, int]:
    """Return a sort key of a channel, the smallest for the likeliest: kind of name, component, position in the file.

    Names of heights come first, colours, vectors and other quantities last. Of several channels of a kind, one that is
    no usual component (r, x, ...) is preferred, then the components in the order of COMPONENTS.
    """
    text, component = channel.full_name.casefold(), channel.component
    components = {c.component for c in channels if (c.part, c.layer) == (channel.part, channel.layer)}
    is_vector = {"x", "y", "z"} <= components or VECTOR.search(text) is not None
    # 0: named as heights; 1: as depths; 2 to 4: perhaps grey values; 5: colours and vectors; 6: other quantities.
    if OTHER.search(text):
        rank = 6
    elif HEIGHT.search(text):
        rank = 0
    elif DEPTH.search(text):
        rank = 1
    elif is_vector or component in ("g", "b", "green", "blue", "u", "ry", "by"):
        rank = 5
    else:
        rank = {"z": 1, "y": 2, "v": 2, "r": 3, "red": 3}.get(component, 4)
    if component in ("g", "b", "green", "blue", "u"):
        order = len(COMPONENTS) + 1
    else:
        order = COMPONENTS.index(component) + 1 if component in COMPONENTS else 0
    return rank, order, channels.index(channel)
