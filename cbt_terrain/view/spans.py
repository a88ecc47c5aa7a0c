# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between pixels, as requested and reported, and pixel footprints ("spans"), as the kernels measure them.

The kernels divide metres of height, or of an edge, by the metres that a pixel spans where it is finest. The size on
screen also depends on the slant at which the height is seen, and on the angle of the ray to the view's axis.

`placement` is float64 [4, 4], from the terrain's space to the world. The unit of lengths in camera space is the length
that a metre of the terrain's height has there.

"Whole" is the size, in spans, of an error that reaches from the surface to the eye; an error of s spans takes the
fraction s / whole of that way. "Secant" is distance over depth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .criterion import LARGEST, Criterion
from .linear import add_up, length, lengths, product, round_last_bits
from .view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View

# Relative; far above the rounding of pixels and metres, far below a visible difference.
ROUNDING = 1e-9
# Without a shading floor a height counts as seen at this fraction of the frame's largest slant, or more. This refines
# a 256th of a picture that looks straight down.
MIN_SLANT = 1 / 16
# Where slants in the frame differ by less than this factor, one for all of them saves as many triangles, and time.
EVEN_SLANTS = 1.06
# The smallest slant, at which heights are invisible; it keeps all numbers finite.
NO_SLANT = 1e-6
# The request for edges is shorter by the length that float32 corners may add at the depth limit, but by at most this
# fraction: for smaller leaves the bound is larger.
MAX_STRETCH = 0.01


@dataclass(frozen=True)
class PlanUnits:
    """Lengths that edges depend on.

    `steps`: metres of a lattice unit along x and y. `unit_bits`: a root square's side is 2^unit_bits units. `depth`:
    of the deepest leaf. `off`: largest error of float32 corners along each axis, metres.
    """

    steps: tuple[float, float]
    unit_bits: int
    depth: int
    off: tuple[float, float, float]


@dataclass(frozen=True)
class Spans:
    """Factors between pixels and pixel footprints ("spans"), for each of `views`.

    `wholes`: spans of an error that reaches the eye. `widenings`: factors, 1 or more, on spans that make limits in
    spans hold in pixels on screen. `scales`: largest slant in the frame times the widening. `edge`: spans of an edge of
    one pixel. `lengths`: squared diagonal and side of a lattice unit, in camera space. `allowed`: factor by which the
    request for edges is shorter, for float32 rounding. `off`: largest error of float32 corners, in camera space.
    """

    views: tuple[View, ...] = ()
    wholes: tuple[float, ...] = ()
    widenings: tuple[float, ...] = ()
    scales: tuple[float, ...] = ()
    edge: float = 1.0
    lengths: tuple[float, float] = (0.0, 0.0)
    allowed: float = 1.0
    off: float = 0.0
    unit_bits: int = 0

    def pixels(self, spans: float) -> float:
        """Convert an error in spans (pixel footprints) to pixels on screen, in the view where it is largest."""
        by_view = zip(self.views, self.wholes, self.widenings, strict=True)
        # A widening includes a margin of ROUNDING. Half of it is left for the rounding of this conversion.
        return max(as_seen(view, whole, spans * (1 + 0.5 * ROUNDING) / wide) for view, whole, wide in by_view)

    def excess_of_edges(self, depth: int) -> float:
        """Return the factor >= 1 by which float32 corners make edges of leaves down to `depth` longer than allowed."""
        return max(1.0, _stretch(self.lengths, self.unit_bits, depth, self.off) / self.allowed)


def spans_of(criterion: Criterion, views: Sequence[View], placement: np.ndarray, plan: PlanUnits) -> Spans:
    """Return the spans (pixel footprints in the kernels' measure) of views of a terrain at `placement`.

    A view's scale is the largest length that a metre of height may have on screen, metres across the view at a depth of
    1 m: its largest slant times its widening, the factor by which an error towards the camera looks larger. With limits
    of edges or areas some scales are raised: divided by `secant_of` their view, all become equal, since edges have one
    limit for all views. plan: lengths on the ground that these limits depend on.
    """
    slants = [slants_of(view, placement, criterion) for view in views]
    wholes = [whole_of(view, placement, smallest) for view, (_, smallest) in zip(views, slants, strict=True)]
    widenings = [widening(view, whole, criterion.error_px) for view, whole in zip(views, wholes, strict=True)]
    scales = [factor * largest for factor, (largest, _) in zip(widenings, slants, strict=True)]
    by_view = tuple(views), tuple(wholes), tuple(widenings)
    if not views or not criterion.measures_edges:
        return Spans(*by_view, tuple(scales))
    # Edges have no slant: across the ray they are seen up to secant times as long as at the view's axis. All views
    # share one scale for edges, which must not depend on the widening of errors in each view.
    secants = [secant_of(v) for v in views]
    edge_spans = max(scale / secant for scale, secant in zip(scales, secants, strict=True))
    scales = [edge_spans * secant for secant in secants]
    lengths_by_view = [unit_lengths(v, placement, plan.steps) for v in views]
    longest = tuple(max(of_views) for of_views in zip(*lengths_by_view, strict=True))
    offset = max(largest_offset(v, placement, plan.off) for v in views)
    # Shifted float32 corners lengthen edges by up to this factor, so edges get a smaller limit.
    allowed = min(_stretch(longest, plan.unit_bits, plan.depth, offset), 1 + MAX_STRETCH)
    return Spans(*by_view, tuple(scales), edge_spans / allowed, longest, allowed, offset, plan.unit_bits)


def slants_of(view: View, placement: np.ndarray, criterion: Criterion) -> tuple[float, float]:
    """Return the largest and the smallest slant that counts in the frame.

    A slant is the length of a metre of height as a perspective sees it at a depth of 1 m: metres across the view. In a
    panorama it is seen at a distance of 1 m: metres across the ray. It is 0 for a ray straight down, along which
    heights are not seen. No slant counts as less than the shading floor, since shading and shadows show an error too.
    Both are equal if one slant serves the whole frame.
    """
    if view.kind == PANORAMIC:
        largest, smallest = 1.0, 0.0
    else:
        up_x, up_y, up_z = _up_in_camera(view, placement).tolist()
        # The tangents of rays at the frame's left and right border, and at the lower and upper one.
        frame = view.bounds() if view.kind == PERSPECTIVE else ((0.0, 0.0), (0.0, 0.0))
        # Each component of a slant is linear in its tangent, so its extremes (low, high) are at the borders.
        ends = [
            sorted(scale * (tangent * up_z + up_along) for tangent in tangents)
            for scale, tangents, up_along in zip(_axis_scales(view), frame, (up_x, up_y), strict=True)
        ]
        largest = max(criterion.shading_floor, NO_SLANT, length([max(-low, high) for low, high in ends]))
        smallest = length([max(low, -high, 0.0) for low, high in ends])  # 0 where a component changes its sign
    if view.kind == ORTHOGRAPHIC or not criterion.error_px:  # only errors on screen use the smallest
        return largest, largest
    smallest = max(criterion.shading_floor, MIN_SLANT * largest, smallest)
    return largest, largest if largest < EVEN_SLANTS * smallest else smallest


def slant_rows(view: View, placement: np.ndarray) -> np.ndarray:
    """Return the rows, float64 [2, 2], that times (x, y) of a point, metres from the eye, give its slant times depth.

    One row is for the picture's x, one for its y; see `slants_of`. The point's height changes nothing: it stays on its
    vertical.

    For a point c and the unit vector u of height, both in camera space, the product is f (u_z c - u c_z), f being the
    pixels of either axis over those of the larger. In a panorama it is slant times distance: the distance of c from
    the eye's vertical, in two directions at right angles to u.
    """
    up, linear = _up_in_camera(view, placement), product(view.world_to_camera, placement)[:3, :2]
    if view.kind == PANORAMIC:
        east = np.cross(np.cross(up, linear[:, 0]), up)  # the terrain's own, so that no turn of the camera counts
        east = east / length(east)
        return product(np.array([east, np.cross(up, east)]), linear)
    return np.array([f * (up[2] * linear[k] - up[k] * linear[2]) for k, f in enumerate(_axis_scales(view))])


def _up_in_camera(view: View, placement: np.ndarray) -> np.ndarray:
    """Return the unit vector of height in camera space, float64 [3]."""
    up = product(view.world_to_camera[:3, :3], placement[:3, 2])
    return up / length(up)


def _axis_scales(view: View) -> tuple[float, float]:
    """Return the pixels per unit along x and y as fractions of `pixels_per_unit`, which is the larger one."""
    assert view.projection is not None, "a panorama has no frame"
    scales, unit = view.projection, view.pixels_per_unit
    across, along = (abs(float(scales[k, k])) * view.resolution[k] / 2 / unit for k in (0, 1))
    return across, along


def whole_of(view: View, placement: np.ndarray, slant: float) -> float:
    """Return the size, in spans, of an error that reaches the eye; larger errors have no bound on screen.

    In a perspective its component along the view is as long as the depth; in a panorama it is itself as long as the
    distance. It is seen at `slant`, the smallest that counts in the frame.
    """
    if view.kind == PANORAMIC:
        return view.pixels_per_unit * slant
    return view.pixels_per_unit * slant / max(abs(float(_up_in_camera(view, placement)[2])), NO_SLANT)


def as_seen(view: View, whole: float, spans: float) -> float:
    """Return the pixels between a point and its true position on screen, if its height is wrong by `spans` footprints.

    Footprints are measured at the reference surface; an error towards the camera looks larger. At depth z or more and
    distance d or more, an error e is seen as at most
    - in a perspective of focal length f: f e slant / (z - |u_z| e) pixels, where |u_z| e / z = spans / whole; LARGEST
      if it may reach the eye;
    - in a panorama, where e / d = spans / whole and slant^2 + steep^2 = 1: the angle whose tangent is
      e slant / (d - e steep), or asin(e / d) where e > d steep; half a turn if it may reach the eye.
    """
    if view.kind == PERSPECTIVE:
        return min(spans / (1 - spans / whole), LARGEST) if spans < whole else LARGEST
    if view.kind == PANORAMIC:
        slant, fraction = whole / view.pixels_per_unit, spans / whole
        steep = math.sqrt(max(0.0, 1 - slant * slant))
        angle = round_last_bits(math.asin(fraction)) if fraction < 1 else math.pi
        if fraction < steep:
            angle = round_last_bits(math.atan2(fraction * slant, 1 - fraction * steep))
        return view.pixels_per_unit * angle
    return spans


def widening(view: View, whole: float, error_px: float) -> float:
    """Return the factor >= 1 by which an error of up to `error_px` pixels on screen may exceed its size in footprints.

    It is that of an error of just `error_px`; since `as_seen` is convex, smaller ones have smaller factors.
    """
    if not error_px or error_px >= LARGEST or view.kind == ORTHOGRAPHIC:
        return 1 + ROUNDING
    if view.kind == PANORAMIC:
        # Solve `as_seen` for the fraction of the distance, spans / whole, of an error that is seen at this angle.
        # Slant and steep are the sine and cosine of the angle between the line of sight and the vertical.
        slant, angle = whole / view.pixels_per_unit, error_px / view.pixels_per_unit
        steep = math.sqrt(max(0.0, 1 - slant * slant))
        sine, cosine = (round_last_bits(f(min(angle, math.pi / 2))) for f in (math.sin, math.cos))
        fraction = sine if sine > steep else sine / (slant * cosine + steep * sine)
        return angle / (fraction * slant) * (1 + ROUNDING)  # error_px / spans, both over pixels_per_unit
    return (1 + error_px / whole) * (1 + ROUNDING)  # pixels are spans / (1 - spans / whole)


def secant_of(view: View) -> float:
    """Return the largest ratio of distance to depth along the view of a point in the frame: that in its corner."""
    if view.kind != PERSPECTIVE:
        return 1.0
    x, y = (max(abs(end) for end in ends) for ends in view.bounds())
    return math.sqrt(1 + x * x + y * y)


def unit_lengths(view: View, placement: np.ndarray, steps: tuple[float, float]) -> tuple[float, float]:
    """Return the squared diagonal and squared side of a lattice unit, the longer ones of two, in camera space.

    steps: metres of a lattice unit in x and y.
    """
    linear = _to_camera(view, placement)
    east, north = linear[:, 0] * steps[0], linear[:, 1] * steps[1]
    diagonal2 = max(_squared(east + north), _squared(east - north))
    return diagonal2, max(_squared(east), _squared(north))


def largest_offset(view: View, placement: np.ndarray, offsets: tuple[float, float, float]) -> float:
    """Bound the length in camera space of a shift by at most `offsets` metres along x, y and z of the terrain.

    The bound is the sum of the lengths of the three shifts.
    """
    return add_up(far * off for far, off in zip(lengths(_to_camera(view, placement)).tolist(), offsets, strict=True))


def _to_camera(view: View, placement: np.ndarray) -> np.ndarray:
    """Return float64 [3, 3]: the terrain's axes in camera space, in units of a metre of its height."""
    linear = product(view.world_to_camera, placement)[:3, :3]
    return linear / length(linear[:, 2])


def _squared(vector: np.ndarray) -> float:
    """Return the squared length of a vector of three numbers."""
    x, y, z = vector.tolist()
    return x * x + y * y + z * z


def _stretch(lengths2: tuple[float, float], unit_bits: int, depth: int, off: float) -> float:
    """Bound the factor by which edges of leaves at `depth` or above are longer if corners are shifted by up to `off`.

    lengths2: squared diagonal and side of a lattice unit, in the space of `off`. unit_bits: a root square's side is
    2^unit_bits units.
    """
    diagonal2, axis2 = lengths2
    side = 2.0 ** (unit_bits - (depth - 1) // 2)
    # a leaf's legs are sides of a square at odd depths, and halves of its diagonals at even ones
    shortest = side * (math.sqrt(axis2) if depth % 2 else 0.5 * math.sqrt(diagonal2))
    return 1 + 2 * off / shortest
