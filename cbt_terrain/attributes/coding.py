# SPDX-License-Identifier: GPL-3.0-or-later
"""Encoding of an attribute's numbers in an image."""

from dataclasses import dataclass

from ..errors import TerrainError
from .attribute import LINEAR_RGB, AttributeDeclaration

FORMS = PNG, EXR = "png", "exr"
NO_UNIT = ("", "1", LINEAR_RGB)
# Bytes of a texel in Blender: 8-bit images stay so, all others become four floats.
SHALLOW_BYTES, DEEP_BYTES = 4, 16


@dataclass(frozen=True)
class Coding:
    """A format of FORMS, its channels (1, 3 or 4, the attribute's numbers first) and their depth in bits.

    A PNG file maps `low` .. `high` to 0 .. 1, by the sRGB curve if `srgb`; an EXR file has the numbers themselves.
    """

    form: str
    channels: int
    depth: int
    low: float
    high: float
    srgb: bool = False

    @property
    def texel_bytes(self) -> int:
        """Return the bytes of a texel in Blender's memory."""
        return SHALLOW_BYTES if self.depth == 8 else DEEP_BYTES


def coding_of(effect: AttributeDeclaration, form: str) -> Coding:
    """Return the coding of an attribute in a form of FORMS. effect: the attribute's declaration.

    In PNG files, attributes without a unit and colours have 8 bits, those with a unit 16 bits. In EXR files all are
    half floats. Attributes without a known span are 32-bit floats in EXR files, whatever the form. Raises TerrainError
    for another form.
    """
    if form not in FORMS:
        raise TerrainError(f"The format of the maps is {form!r}", expected=f"one of {', '.join(FORMS)}")
    channels = 3 if effect.width == 2 else effect.width  # no format has two
    if effect.span is None:
        return Coding(EXR, channels, depth=32, low=0.0, high=1.0)  # floats are written as they are
    if form == EXR:
        return Coding(EXR, channels, depth=16, low=0.0, high=1.0)
    depth, (low, high) = 8 if effect.unit in NO_UNIT else 16, effect.span
    return Coding(PNG, channels, depth, low, high, srgb=effect.unit == LINEAR_RGB)
