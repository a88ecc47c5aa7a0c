# SPDX-License-Identifier: GPL-3.0-or-later
"""How the numbers of an effect are kept in an image."""

from dataclasses import dataclass

from ..effects.effect import LINEAR_RGB, Effect
from ..errors import TerrainError

FORMS = PNG, EXR = "png", "exr"
NO_UNIT = ("", "1", LINEAR_RGB)
# Channels of an image -> bytes of a texel in Blender: bytes stay bytes, everything else becomes four floats.
SHALLOW_BYTES, DEEP_BYTES = 4, 16


@dataclass(frozen=True)
class Coding:
    """`form`: one of FORMS. `channels`: 1, 3 or 4, of which the effect's numbers are the first. `depth`: bits of each.

    In a PNG file a channel's 0 .. 1 stands for `low` .. `high`, by the curve of sRGB where `srgb`; an EXR file has the
    numbers themselves.
    """

    form: str
    channels: int
    depth: int
    low: float
    high: float
    srgb: bool = False

    @property
    def texel_bytes(self) -> int:
        return SHALLOW_BYTES if self.depth == 8 else DEEP_BYTES


def coding_of(effect: Effect, form: str = PNG) -> Coding:
    """Bytes for what has no unit (directions, shares, weights) and for colours, 16 bits for measures; halves where EXR
    is asked for.

    What has no known span is kept as floats of 32 bits in EXR files, whatever is asked for.
    """
    if form not in FORMS:
        raise TerrainError(f"The format of the maps is {form!r}; expected one of {', '.join(FORMS)}.")
    channels = 3 if effect.width == 2 else effect.width  # no format has two
    if effect.span is None:
        return Coding(EXR, channels, 32, 0.0, 1.0)
    if form == EXR:
        return Coding(EXR, channels, 16, 0.0, 1.0)
    return Coding(PNG, channels, 8 if effect.unit in NO_UNIT else 16, *effect.span, effect.unit == LINEAR_RGB)
