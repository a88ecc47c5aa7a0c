# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of a refinement, and its packing into the numbers that the kernels read.

Every criterion is a ratio, squared: how much too coarse a diamond is, 1 being exactly what was asked. Criteria combine
by max. Each ratio is nested: an error saturated from the bottom up over a distance to a box that contains the
children's boxes (Lindstrom and Pascucci 2002, sections 3 and 4), so a plain walk from the roots gives a conforming
mesh.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...kernels.refine.diamond import MAX_PLANES, LocalView
from ..errors import TerrainError
from .view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View

# What is asked is kept between these: the finest and the coarsest mesh that there can be.
SMALLEST, LARGEST = 1e-30, 1e30
# Relative; far above what rounding does to pixels and metres, far below what can be seen of them.
ROUNDING = 1e-9
# From above, errors of height move no pixel but show in shading and shadows: they count as if seen 30 degrees off.
LEAST_SLANT = 0.5
# How many times coarser a terrain may be of which nothing is in view.
HIDDEN = 1e90


@dataclass(frozen=True)
class Criterion:
    """What is asked; 0 switches a criterion off, and those that are on hold together.

    `error_px`: screen-space geometric error, pixels. `edge_px`: longest edge, pixels. `area_px`: triangle area, square
    pixels. `error_m`: vertical error, metres, independent of any view. `guard_deg`: how far outside the frame still
    counts as seen, degrees. `off_screen_factor`: how much coarser the rest may be; 1 switches culling off.
    `max_depth`: bisections of a root square (None: to what float32 holds). `max_triangles`: None is no limit.
    `meshlet`: each leaf becomes 4**meshlet triangles, 0 .. 4.
    """

    error_px: float = 1.0
    edge_px: float = 0.0
    area_px: float = 0.0
    error_m: float = 0.0
    guard_deg: float = 5.0
    off_screen_factor: float = 16.0
    max_depth: int | None = None
    max_triangles: int | None = None
    meshlet: int = 0

    def __post_init__(self):
        for name in ("error_px", "edge_px", "area_px", "error_m", "guard_deg"):
            value = getattr(self, name)
            if not (0 <= value < math.inf):
                raise TerrainError(f"The criterion's {name} is {value}; expected a finite number, 0 or more.")
        for name in ("error_px", "edge_px", "area_px", "error_m"):
            if value := getattr(self, name):  # squares of what lies outside are no numbers any more
                object.__setattr__(self, name, min(max(value, SMALLEST), LARGEST))
        if not self.off_screen_factor >= 1:
            raise TerrainError(f"The off-screen factor is {self.off_screen_factor}; expected 1 (no culling) or more.")
        if self.meshlet not in range(5):
            raise TerrainError(f"The meshlet level is {self.meshlet}; expected a whole number from 0 to 4.")
        if self.max_depth is not None and self.max_depth < 1:
            raise TerrainError(f"The depth limit is {self.max_depth}; expected 1 or more.")
        if self.max_triangles is not None and self.max_triangles < 0:
            raise TerrainError(f"The triangle limit is {self.max_triangles}; expected 0 or more.")
        if not (self.error_px or self.edge_px or self.area_px or self.error_m):
            raise TerrainError("Every criterion is 0; ask for an error, an edge length or an area.")

    @property
    def needs_view(self) -> bool:
        return bool(self.error_px or self.edge_px or self.area_px)


def unit_asked(criterion: Criterion) -> str:
    """The unit of the error that is swept and budgeted: px where a screen error is asked for, else m, else ""."""
    return "px" if criterion.error_px else "m" if criterion.error_m else ""


def localise(
    view: View, placement: np.ndarray, box: np.ndarray, criterion: Criterion, height_scale: float, off: float = 0.0
) -> LocalView:
    """The view from the terrain's own space, as the kernels read it.

    `placement` float64 [4, 4] takes the terrain's space to the world, `box` float64 [2, 3] is everything that the
    terrain may occupy in its own space. A metre of height counts as `height_scale` metres across the view. What is seen
    of true heights may be `off` metres of height from the surface; the frustum is wider by that.
    """
    to_camera = view.world_to_camera @ placement
    linear, shift = to_camera[:3, :3], to_camera[:3, 3]
    # A distance in camera space is at least sigma times the one with each axis stretched by itself; sigma is below 1
    # only under shear. The last factor keeps rounding on the safe side.
    stretch = np.linalg.norm(linear, axis=0)
    sigma = np.linalg.svd(linear / stretch, compute_uv=False)[-1]
    pixels = view.pixels_per_unit * height_scale
    # Nothing nearer than the clip start is seen; half of it leaves room for the error itself.
    start = view.clip[0] if view.clip[0] < view.clip[1] else 0.0
    near = max(start / 2, 1e-9 * float(np.linalg.norm(stretch * (box[1] - box[0]))), 1e-150)
    planes = frustum_planes(view, criterion.guard_deg) @ to_camera
    planes[:, 3] += np.abs(planes[:, 2]) * off
    # What rounding could put on the wrong side of a plane is inside.
    planes[:, 3] += 1e-12 * (np.abs(planes[:, :3]) @ np.abs(box).max(axis=0) + np.abs(planes[:, 3]))
    factor = min(criterion.off_screen_factor, LARGEST)
    if factor > 1 and _outside(planes, box):
        factor = HIDDEN  # nothing of this terrain is in view: the smallest mesh will do
    try:
        eye = -np.linalg.solve(linear, shift)
    except np.linalg.LinAlgError:
        raise TerrainError(
            "The terrain's or the camera's axes lie in one plane; give them scales and shears that keep them apart."
        ) from None
    numbers = {
        "eye": eye,
        "weight": (sigma * stretch) ** 2 * (1 - 1e-12),
        "depth": [*-linear[2], -shift[2]],
        "pixel2": 1 / (pixels**2 * stretch[2] ** 2),
        "cosine2": 1 / secant_of(view) ** 2,
        "near2": near**2,
        "off_screen2": factor**2,
        "planes": np.concatenate([planes, np.zeros((MAX_PLANES - len(planes), 4))]),
    }
    local = LocalView()
    local.kind, local.plane_count = (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC).index(view.kind), len(planes)
    for name, value in numbers.items():
        if not np.isfinite(value).all():
            raise TerrainError(
                "The camera or the terrain is so far away or so large that its numbers overflow; check both."
            )
        setattr(local, name, value)
    return local


def slant_of(view: View, placement: np.ndarray) -> float:
    """The longest that a metre of height looks anywhere in the frame, in metres across the view at a depth of 1 m.

    That is |t x u| for the direction t of a ray, 1 deep, and the unit vector u of height in camera space: convex in t,
    so largest in a corner of the frame.
    """
    up = view.world_to_camera[:3, :3] @ placement[:3, 2]
    up = up / np.linalg.norm(up)
    if view.kind == PANORAMIC:
        return 1.0
    across, along = view.bounds() if view.kind == PERSPECTIVE else ((0.0,), (0.0,))
    x, y, z = up.tolist()
    looks = (math.hypot(b * z + y, a * z + x, a * y - b * x) for a in across for b in along)
    return max(LEAST_SLANT, *looks)


def as_seen(view: View, slant: float, pixels: float) -> float:
    """Pixels that a point can be from its place in the frame where its error in height is `pixels` spans of a pixel.

    A span is taken at the reference surface, and an error towards the camera looks larger than that. Of an error e at
    depth z or more, and at distance d or more, a perspective of focal length f shows f e slant / (z - e) at most, a
    panorama the angle asin(e / d). Beyond what could ever be asked, where the mesh may reach the eye: LARGEST.
    """
    whole = view.pixels_per_unit * slant  # the error is as long as the depth or the distance
    if view.kind == PERSPECTIVE:
        return min(pixels / (1 - pixels / whole), LARGEST) if pixels < whole else LARGEST
    if view.kind == PANORAMIC:
        return whole * (math.asin(pixels / whole) if pixels < whole else math.pi)
    return pixels


def widening(view: View, slant: float, criterion: Criterion) -> float:
    """The factor, 1 or more, on spans of a pixel that makes a limit on them one on pixels as they are seen.

    `as_seen` is convex: at less than what was asked, spans times this factor are still not below it.
    """
    asked, whole = criterion.error_px, view.pixels_per_unit * slant
    if not asked or asked >= LARGEST or view.kind == ORTHOGRAPHIC:
        return 1 + ROUNDING
    if view.kind == PANORAMIC:
        angle = asked / whole
        return angle / math.sin(min(angle, math.pi / 2)) * (1 + ROUNDING)
    return (1 + asked / whole) * (1 + ROUNDING)


def secant_of(view: View) -> float:
    """The most that a point in the frame is further away than deep."""
    if view.kind != PERSPECTIVE:
        return 1.0
    return math.sqrt(1 + sum(max(abs(e) for e in ends) ** 2 for ends in view.bounds()))


def unit_lengths(view: View, placement: np.ndarray, steps: tuple[float, float]) -> tuple[float, float]:
    """Squared diagonal and squared side of a lattice unit, the longer ones, in camera space.

    `steps` are the metres of one lattice unit in x and y. In metres of the terrain's height, as all of `LocalView`.
    """
    linear = _to_camera(view, placement)
    east, north = linear[:, 0] * steps[0], linear[:, 1] * steps[1]
    diagonal2 = max(np.sum((east + north) ** 2), np.sum((east - north) ** 2))
    return float(diagonal2), float(max(np.sum(east**2), np.sum(north**2)))


def largest_offset(view: View, placement: np.ndarray, offsets: tuple[float, float, float]) -> float:
    """How far a point that is off by so many metres along each axis can be from its place, in camera space as above."""
    return float(np.linalg.norm(_to_camera(view, placement), axis=0) @ offsets)


def _to_camera(view: View, placement: np.ndarray) -> np.ndarray:
    """float64 [3, 3]: the terrain's directions in camera space, as long as metres of its height."""
    linear = (view.world_to_camera @ placement)[:3, :3]
    return linear / np.linalg.norm(linear[:, 2])


def frustum_planes(view: View, guard_deg: float) -> np.ndarray:
    """float64 [n, 4]: planes in camera space, positive towards what may be seen, n from 0 to 6.

    The guard band turns the side planes of a perspective outward by its angle; of an orthographic view it widens the
    frame by the angle's tangent. A clip range that is upside down culls nothing.
    """
    if view.kind == PANORAMIC or not view.clip[0] < view.clip[1]:
        return np.zeros((0, 4))
    guard = math.radians(min(guard_deg, 89.0))
    planes = [[0, 0, -1, 0], [0, 0, 1, view.clip[1]]]
    for axis, (low, high) in enumerate(view.bounds()):
        unit = np.eye(3)[axis]
        if view.kind == ORTHOGRAPHIC:
            margin = (high - low) / 2 * math.tan(guard)
            planes += [[*unit, margin - low], [*-unit, high + margin]]
            continue
        for tangent, sign in ((-low, 1.0), (high, -1.0)):
            angle = math.atan(tangent) + guard
            if angle < math.pi / 2:
                # inside: sign * coordinate >= -tan(angle) * depth
                planes.append([*(sign * math.cos(angle) * unit + [0, 0, -math.sin(angle)]), 0])
    if view.kind == ORTHOGRAPHIC:
        planes[0] = [0, 0, -1, -view.clip[0]]
    return np.array(planes, np.float64)


def _outside(planes: np.ndarray, box: np.ndarray) -> bool:
    """Whether the box lies wholly on the far side of one of the planes."""
    if not len(planes):
        return False
    furthest = np.where(planes[:, :3] > 0, box[1], box[0])
    return bool((np.einsum("ij,ij->i", planes[:, :3], furthest) + planes[:, 3] < 0).any())
