# SPDX-License-Identifier: GPL-3.0-or-later
"""A view in terrain space, as the struct that the kernels read."""

import math

import numpy as np

from ...kernels.refine.local_view import MAX_PLANES, LocalView
from ..errors import TerrainError
from .criterion import LARGEST, Criterion
from .linear import length, lengths, min_stretch, product, round_last_bits, solve
from .spans import secant_of, slant_rows, slants_of
from .view import KINDS, ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View

# Factor by which a terrain that is wholly out of view may be coarser: its smallest mesh is enough.
OUT_OF_VIEW = 1e90
# Degrees of the field of view for which the guard band and the fringe are stated; of narrower ones both are narrower.
NORMAL_FOV = 50.0
# With geomorphing, footprints get coarser outside the frame gradually, over this fraction of the depth (11 degrees at a
# field of view of 50) or of half an orthographic frame.
FRINGE = 0.25


def localise(
    view: View,
    placement: np.ndarray,
    box: np.ndarray,
    criterion: Criterion,
    height_scale: float,
    off: float = 0.0,
    margins: tuple[float, float] | None = None,
) -> LocalView:
    """Return a view in terrain space, as the kernels read it. Raises TerrainError if its numbers overflow.

    Args:
        placement: float64 [4, 4], from terrain space to the world.
        box: float64 [2, 3], the bounding box of the terrain in terrain space, metres.
        height_scale: for footprints: metres across the view that a metre of height moves a point, see `Spans.scales`.
        off: largest distance of mesh and surface, metres of height; the frustum is wider by it, and boxes are higher.
        margins: degrees beyond the left and right sides, and beyond the top and bottom, that count as inside; by
            default those of the criterion's guard band.
    """
    to_camera = product(view.world_to_camera, placement)
    linear, shift = to_camera[:3, :3], to_camera[:3, 3]
    eye = eye_of(to_camera)
    # Shear shortens distances in camera space to sigma times those with the axes stretched alone, or more; without
    # shear sigma is 1. In `weight`, 1 - 1e-12 keeps rounding on the safe side.
    stretch = lengths(linear)
    sigma = min_stretch(linear / stretch)
    pixels = view.pixels_per_unit * height_scale
    # Nothing nearer than the clip start is seen; half of it leaves room for the error itself. It is never 0.
    start = view.clip[0] if view.clip[0] < view.clip[1] else 0.0
    near = max(start / 2, 1e-9 * length(stretch * (box[1] - box[0])), 1e-150)
    planes = product(frustum_planes(view, margins or guard_margins(view, criterion.guard_deg)), to_camera)
    planes[:, 3] += np.abs(planes[:, 2]) * off
    # Points that rounding could put on the wrong side of a plane are inside.
    planes[:, 3] += 1e-12 * (product(np.abs(planes[:, :3]), np.abs(box).max(axis=0)) + np.abs(planes[:, 3]))
    factor, fade, fringe = _off_screen(view, criterion, planes, box)
    largest, smallest = slants_of(view, placement, criterion)
    # Rows of 0 mean that one slant, the largest, serves the whole frame.
    slants = slant_rows(view, placement) / largest if largest > smallest else np.zeros((2, 2))
    numbers = {  # the fields of LocalView, squares where a name ends in 2
        "eye": eye,
        "weight": (sigma * stretch) ** 2 * (1 - 1e-12),  # from squared metres along an axis to camera space
        "unsure": off,
        "depth": [*-linear[2], -shift[2] - abs(linear[2, 2]) * off],  # times (x, y, z, 1): depth, less that of `off`
        "pixel2": 1 / (pixels * pixels * stretch[2] * stretch[2]),  # metres of height that a pixel covers at depth 1
        "slant_x": slants[0],  # times (x, y) from the eye: slant times depth, as a fraction of the largest slant
        "slant_y": slants[1],
        "max_gain2": (largest / smallest) * (largest / smallest),  # every slant is at least the largest / gain
        "cosine2": 1 / (secant_of(view) * secant_of(view)),  # smallest depth over distance in the frame
        "near2": near * near,
        "off_screen2": factor * factor,
        "fade": fade,
        "fringe": fringe,
        "planes": np.concatenate([planes, np.zeros((MAX_PLANES - len(planes), 4))]),
    }
    local = LocalView()
    local.kind, local.plane_count = KINDS.index(view.kind), len(planes)
    for name, value in numbers.items():
        if not np.isfinite(value).all():
            raise TerrainError(
                "The camera or the terrain is so far away or so large that its numbers overflow",
                fix="check the location and scale of both",
            )
        setattr(local, name, value)
    return local


def _off_screen(view: View, criterion: Criterion, planes: np.ndarray, box: np.ndarray) -> tuple[float, float, float]:
    """Return the factor by which ground outside the frustum may be coarser, and `fade` and `fringe` of `LocalView`.

    With geomorphing the factor grows gradually, as (1 + fade * t)^4 with t = 0 .. 1 over the fringe, a width beyond the
    frame in metres, or of a perspective a fraction of the depth; else fade and fringe are 0. planes: of the frustum, in
    terrain space, float64 [n, 4]. box: the terrain's bounding box, float64 [2, 3].
    """
    narrow = _narrowness(view)  # below 1 for a telephoto lens: off screen, ground is as coarse as with a normal one
    factor = min(1 + (criterion.off_screen_factor - 1) / narrow, LARGEST)
    if factor > 1 and _outside(planes, box):
        return OUT_OF_VIEW, 0.0, 0.0
    if criterion.morph_until <= 1:
        return factor, 0.0, 0.0
    fringe = FRINGE * (min(b - a for a, b in view.bounds()) / 2 if view.kind == ORTHOGRAPHIC else narrow)
    return factor, math.sqrt(math.sqrt(factor)) - 1, fringe


def eye_of(to_camera: np.ndarray) -> np.ndarray:
    """Return the eye, float64 [3], from a matrix [4, 4] to camera space. Raises TerrainError if it is singular."""
    try:
        return -solve(to_camera[:3, :3], to_camera[:3, 3:])[:, 0]
    except np.linalg.LinAlgError:
        raise TerrainError(
            "The terrain's or the camera's axes lie in one plane",
            expected="three independent axes",
            fix="change its scale or shear",
        ) from None


def guard_margins(view: View, guard_deg: float) -> tuple[float, float]:
    """Return the guard band beyond the left and right sides and beyond the top and bottom, degrees.

    A perspective frame narrower than NORMAL_FOV along an axis has a proportionally narrower band; otherwise nine tenths
    of a telephoto shot's triangles would be outside the frame.
    """
    if view.kind != PERSPECTIVE:
        return guard_deg, guard_deg
    fields = [round_last_bits(math.degrees(math.atan(high) - math.atan(low))) for low, high in view.bounds()]
    margin_x, margin_y = (guard_deg * min(1.0, field / NORMAL_FOV) for field in fields)
    return margin_x, margin_y


def _narrowness(view: View) -> float:
    """Return the tangent of half the view's wider field of view, divided by that of half NORMAL_FOV; at most 1.

    It is 1 for views without a perspective.
    """
    if view.kind != PERSPECTIVE:
        return 1.0
    half = max(high - low for low, high in view.bounds()) / 2
    return min(1.0, half / round_last_bits(math.tan(math.radians(NORMAL_FOV / 2))))


def frustum_planes(view: View, margins: tuple[float, float]) -> np.ndarray:
    """Return planes in camera space, float64 [n, 4], positive on the visible side, n from 0 to 6.

    margins: degrees beyond left and right, and beyond top and bottom. They turn the side planes of a perspective
    outward, and widen an orthographic frame by their tangents. A clip range that is upside down culls nothing.
    """
    if view.kind == PANORAMIC or not view.clip[0] < view.clip[1]:
        return np.zeros((0, 4))
    planes = [[0, 0, -1, 0], [0, 0, 1, view.clip[1]]]  # before the eye, and up to the clip end
    for axis, (low, high) in enumerate(view.bounds()):
        guard = math.radians(min(margins[axis], 89.0))
        sine, cosine = round_last_bits(math.sin(guard)), round_last_bits(math.cos(guard))
        unit = np.eye(3)[axis]
        if view.kind == ORTHOGRAPHIC:
            margin = (high - low) / 2 * sine / cosine
            planes += [[*unit, margin - low], [*-unit, high + margin]]
            continue
        for tangent, sign in ((-low, 1.0), (high, -1.0)):
            # Inside: sign * coordinate >= -tan(angle) * depth, for the angle of this tangent and the guard's.
            secant = math.sqrt(1 + tangent * tangent)
            across, ahead = (cosine - tangent * sine) / secant, (tangent * cosine + sine) / secant
            if across > 0:  # else the side is turned by more than a right angle and culls nothing
                planes.append([*(sign * across * unit + [0, 0, -ahead]), 0])
    if view.kind == ORTHOGRAPHIC:  # it has no eye: ground is seen from the clip start on
        planes[0] = [0, 0, -1, -view.clip[0]]
    return np.array(planes, np.float64)


def _outside(planes: np.ndarray, box: np.ndarray) -> bool:
    """Return whether a box is wholly on the far side of one of the planes.

    planes: float64 [n, 4], positive on the visible side. box: float64 [2, 3], its lowest and highest corner.
    """
    if not len(planes):
        return False
    furthest = np.where(planes[:, :3] > 0, box[1], box[0])
    return bool(((planes[:, :3] * furthest).sum(axis=1) + planes[:, 3] < 0).any())
