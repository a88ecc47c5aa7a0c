# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement below the raster's cells: octaves of noise.

Octave k (0 ..) is quintic value noise n with the amplitude a = a_0 roughness^k and the wavelength l = l_0 2^-k, so the
height a n(x / l) metres; the amplitudes add up to that of the detail. It is between -a and a and twice differentiable,
also where lattice cells meet: its second derivative is at most a c / l^2 in any direction. detail_bounds.py bounds its
distance from a triangle.

The constant c. Between lattice values in [-1, 1], n is linear in each value, and so is its second derivative in a given
direction. It is therefore largest if all four values are 1 or -1. With the fade f(u) = 6 u^5 - 15 u^4 + 10 u^3 the
largest is that of the checkerboard F(u) F(v), F = 1 - 2 f, in a cell's middle along a diagonal: 4 f'(1/2)^2 =
4 (15/8)^2 = 225/16. The largest slope in any direction is 2 f'(1/2) = 15/4. tests/cbt_terrain/field/test_detail.py
proves c <= 14.1 and slopes <= 3.8 for all cells by interval arithmetic.
"""

import hashlib
import operator
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

from ..errors import check_number, check_seed
from ..plain_numbers import keep_plain_numbers
from ..view.linear import add_up
from .detail_bounds import DetailTerm, Split

if TYPE_CHECKING:
    from ...kernels.field import detail as kernels

MAX_OCTAVES = 9
# Upper bounds of the second derivative and the slope of the noise, see above.
CURVATURE, SLOPE = 14.1, 3.8
# Edges of the finest leaf in the shortest wave; the mesh then misses 0.11 of its amplitude.
EDGES_A_WAVE = 4
LARGEST = 1e6  # metres, of amplitudes and wavelengths


@dataclass(frozen=True)
class Detail:
    """Octaves of noise, together at most `amplitude` metres above or below the surface.

    The longest waves have `wavelength` metres. Each octave has half the wavelength and `roughness` (0 .. 1) times the
    amplitude of the one before. `seed` selects the pattern.
    """

    amplitude: float
    wavelength: float = 4.0
    roughness: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise TerrainError for a number outside of its range."""
        keep_plain_numbers(self, "The detail's")
        check_number("The detail's amplitude", self.amplitude, 0.0, LARGEST, "metres")
        check_number("The detail's wavelength", self.wavelength, 1e-3, LARGEST, "metres")
        check_number("The detail's roughness", self.roughness, 0.0, 1.0, "parts of the octave before")
        check_seed("The detail's seed", self.seed)

    @property
    def key(self) -> str:
        """Return a hex digest of the detail's parameters, by which surfaces and results are cached."""
        text = repr((float(self.amplitude), float(self.wavelength), float(self.roughness), self.seed))
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()

    def waves(self, finest: float) -> list[tuple[float, float]]:
        """Return the (amplitude, wavelength), metres, of the octaves that leaves with edges of `finest` metres resolve.

        A wave has to have at least EDGES_A_WAVE edges, but the longest octave is always there. Octaves without
        amplitude are left out. The amplitudes add up to that of the detail.
        """
        lengths = [self.wavelength * 0.5**k for k in range(MAX_OCTAVES)]
        shown = [length for k, length in enumerate(lengths) if k == 0 or length >= EDGES_A_WAVE * finest]
        ratios = list(accumulate([1.0] + [self.roughness] * (len(shown) - 1), operator.mul))  # to the first amplitude
        first = self.amplitude / add_up(ratios)
        return [(first * ratio, length) for ratio, length in zip(ratios, shown, strict=True) if first * ratio > 0.0]

    def parts(self, finest: float) -> list[DetailTerm]:
        """Return the octaves that `waves` lists, each as a summand from which bounds are computed.

        finest: metres of the shortest edges of meshes.
        """
        terms = []
        for amplitude, length in self.waves(finest):
            # CURVATURE (c above) and SLOPE bound the derivatives for an amplitude and a wavelength of 1.
            curvature, slope = CURVATURE * amplitude / (length * length), SLOPE * amplitude / length
            # Bounds split a height into a smooth part and a remainder, of which only the range counts (`far`).
            all_smooth = Split(far=0.0, curvature=curvature, steep=slope, highest=amplitude)
            not_smooth = Split(far=2 * amplitude, curvature=0.0, steep=0.0, highest=0.0)
            terms.append(DetailTerm(highest=amplitude, steep=slope, shortest=length, splits=(all_smooth, not_smooth)))
        return terms

    def packed(self, finest: float) -> "kernels.PackedDetail":
        """Return the octaves with waves long enough for a mesh, as a structure of kernels.

        finest: metres of the mesh's shortest edges; `waves` lists (amplitude, wavelength) of the octaves for it.
        """
        from ...kernels.field import detail as kernels

        d = kernels.PackedDetail()
        waves = self.waves(finest)
        d.octaves, d.seed = len(waves), self.seed
        d.amplitude = waves[0][0] if waves else 0.0
        d.gain, d.frequency = self.roughness, 1.0 / self.wavelength
        return d
