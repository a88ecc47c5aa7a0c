# SPDX-License-Identifier: GPL-3.0-or-later
"""A view: a camera as float64 numbers, independent of its origin."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TerrainError, check_kind, shown
from ..plain_numbers import keep_plain_numbers, matrix, plain_number, vectors
from .linear import length, product, round_last_bits

PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC = "PERSPECTIVE", "ORTHOGRAPHIC", "PANORAMIC"
KINDS = (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)
MAX_PIXELS = 1_000_000


@dataclass(frozen=True, eq=False)
class View:
    """One camera.

    `world_to_camera` float64 [4, 4]: x right, y up, looking along -z; it need not be rigid (a sheared camera).
    `projection` float64 [4, 4]: camera space to normalised device coordinates, as OpenGL; None for a panorama.
    `resolution`: pixels across and up, of the whole frame. `clip`: start and end in metres along the view.
    `radians_per_pixel`: angle of a pixel of a panorama, which has no projection matrix.
    """

    world_to_camera: np.ndarray
    projection: np.ndarray | None
    resolution: tuple[float, float]
    kind: str = PERSPECTIVE
    clip: tuple[float, float] = (0.1, 1e30)
    radians_per_pixel: float = 0.0

    def __post_init__(self) -> None:
        """Convert the matrices to float64 and check all numbers. Raises TerrainError."""
        object.__setattr__(self, "world_to_camera", matrix(self.world_to_camera, "camera's matrix"))
        if self.projection is not None:
            object.__setattr__(self, "projection", matrix(self.projection, "camera's projection"))
        check_kind(self.kind, str, "The camera's kind", f"one of {', '.join(KINDS)}")
        if self.kind not in KINDS:
            raise TerrainError(f"The camera's kind is {self.kind!r}", expected=f"one of {', '.join(KINDS)}")
        if not np.isfinite(self.world_to_camera).all():
            raise TerrainError(
                "The camera's matrix has a value that is not finite", fix="check its location and its parents"
            )
        keep_plain_numbers(self, "The view's")
        object.__setattr__(self, "resolution", _check_resolution(self.resolution))
        if self.kind == PANORAMIC:
            if not 0 < self.radians_per_pixel < math.inf:
                raise TerrainError(f"A panorama has {self.radians_per_pixel} radians a pixel", expected="more than 0")
            return
        if self.projection is None or not np.isfinite(self.projection).all():
            raise TerrainError("The camera's projection is not finite", fix="check its lens, sensor, scale and shift")
        if self.projection[0, 0] == 0 or self.projection[1, 1] == 0:
            raise TerrainError("The camera's projection sees 180 degrees or nothing", fix="check its lens and sensor")

    def __repr__(self) -> str:
        return f"<View: {self.kind.lower()}, {self.resolution[0]:g} x {self.resolution[1]:g} px>"

    def key(self) -> bytes:
        """Return bytes that are the same for equal views."""
        projection = b"" if self.projection is None else self.projection.tobytes()
        numbers = np.array([*self.resolution, *self.clip, self.radians_per_pixel])
        return self.kind.encode() + self.world_to_camera.tobytes() + projection + numbers.tobytes()

    @property
    def pixels_per_unit(self) -> float:
        """Return the pixels per unit of tangent (perspective), metre (orthographic) or radian (panoramic).

        It is the larger one of those across and up.
        """
        if self.projection is None:  # a panorama
            return 1.0 / self.radians_per_pixel
        across, along = (abs(self.projection[axis, axis]) * self.resolution[axis] for axis in (0, 1))
        return float(max(across, along)) / 2

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the frame's left and right, bottom and top: tangents from the view axis (perspective) or metres."""
        # Device coordinates are (scale x + m z) / -z in a perspective: an end e is the tangent (e + m) / scale. In an
        # orthographic view they are scale x + m, and an end is (e - m) / scale.
        shift_column = 2 if self.kind == PERSPECTIVE else 3
        sign = 1.0 if self.kind == PERSPECTIVE else -1.0
        projection = self.projection
        assert projection is not None, "a panorama has no frame"

        def axis(i: int) -> tuple[float, float]:
            """Return the low and high end of the frame along axis 0, across, or 1, up: device coordinates -1, 1."""
            scale, shift = float(projection[i, i]), sign * float(projection[i, shift_column])
            ends = sorted(((-1 + shift) / scale, (1 + shift) / scale))
            return ends[0], ends[1]

        return axis(0), axis(1)

    @classmethod
    def look(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        *,
        fov_deg: float = 50.0,
        resolution: tuple[float, float] = (1920, 1080),
        kind: str = PERSPECTIVE,
        ortho_width: float = 1.0,
        clip: tuple[float, float] = (0.1, 1e6),
        roll_deg: float = 0.0,
    ) -> "View":
        """Return the view from `eye` towards `target`, z up, for a picture of `resolution` pixels.

        Args:
            eye, target: x, y and z in metres of the world, 3 numbers each.
            fov_deg: field of view in degrees across the picture's larger side; of a panorama, across its width.
            resolution: pixels across and up.
            kind: "PERSPECTIVE", "ORTHOGRAPHIC" or "PANORAMIC".
            ortho_width: metres across the larger side of an orthographic picture.
            clip: metres along the view from which to which ground is seen.
            roll_deg: degrees by which the camera is turned about its axis, counter-clockwise.

        Raises:
            TerrainError: for a number that no camera has.
        """
        check_kind(kind, str, "The camera's kind", f"one of {', '.join(KINDS)}")
        width, height = resolution = _check_resolution(resolution)
        fov_deg, roll_deg = plain_number(fov_deg, float, "The field of view"), plain_number(roll_deg, float, "The roll")
        ortho_width = plain_number(ortho_width, float, "The width of the orthographic view")
        if kind == ORTHOGRAPHIC and not 0 < ortho_width < math.inf:
            raise TerrainError(f"The orthographic view is {ortho_width} metres wide", expected="more than 0")
        start, end = clip = plain_number(clip, tuple[float, float], "The clip range")
        if kind == PERSPECTIVE and not 1e-7 < fov_deg < 180:
            raise TerrainError(f"The field of view is {fov_deg} degrees", expected="more than 1e-7 and less than 180")
        eye, target = _read_point(eye, "eye"), _read_point(target, "target")
        back = eye - target
        distance = length(back)
        if not distance > 0:
            raise TerrainError(f"The view's eye and target are both {eye.tolist()}", expected="two different points")
        back /= distance
        # Straight down, or up, the picture's upper side is the north.
        up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.999999 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, back)
        right /= length(right)
        up = np.cross(back, right)
        turn = math.radians(roll_deg)
        cosine, sine = round_last_bits(math.cos(turn)), round_last_bits(math.sin(turn))
        right, up = cosine * right + sine * up, cosine * up - sine * right
        to_camera = np.eye(4)
        to_camera[:3, :3] = right, up, back
        to_camera[:3, 3] = -product(to_camera[:3, :3], eye)
        if kind == PANORAMIC:
            return cls(to_camera, None, resolution, kind, clip, radians_per_pixel=math.radians(fov_deg) / width)
        projection = np.zeros((4, 4))
        larger = max(width, height)
        if start == end:
            raise TerrainError(f"The clip range is {clip}", expected="a start before its end, in metres")
        if kind == PERSPECTIVE:
            focal = 1.0 / round_last_bits(math.tan(math.radians(fov_deg) / 2))
            projection[0, 0], projection[1, 1] = focal * larger / width, focal * larger / height
            projection[2, 2:], projection[3, 2] = ((start + end) / (start - end), 2 * start * end / (start - end)), -1.0
        else:
            projection[0, 0], projection[1, 1] = 2 / ortho_width * larger / width, 2 / ortho_width * larger / height
            projection[2, 2:], projection[3, 3] = (2 / (start - end), (start + end) / (start - end)), 1.0
        return cls(to_camera, projection, resolution, kind, clip)


def listed_views(views: "Iterable[View] | View") -> list[View]:
    """Return views as a list: those of a list, of a generator, or a single one. Raises TerrainError for others."""
    listed: list = list(views) if isinstance(views, Iterable) else [views]
    for view in listed:
        if not isinstance(view, View):
            raise TerrainError(f"The views have {shown(repr(view))} among them", expected="View objects, one a camera")
    return listed


def _read_point(position: ArrayLike, name: str) -> np.ndarray:
    """Return a point as float64 [3], metres; TerrainError for anything else. name: what errors call the point."""
    points = vectors(position, 3, f"view's {name}")
    if len(points) != 1:
        raise TerrainError(f"The view's {name} has {len(points)} points", expected="one point: x, y and z in metres")
    return points[0]


def _check_resolution(resolution: object) -> tuple[float, float]:
    """Return pixels each way, whole ones as ints, so that JSON has one text for a resolution. Raises TerrainError."""
    pixels = plain_number(resolution, tuple[float, float], "The resolution")
    if not all(0 < n <= MAX_PIXELS for n in pixels):
        raise TerrainError(f"The resolution is {resolution}", expected=f"1 to {MAX_PIXELS:,} pixels each way")
    across, along = (int(n) if n.is_integer() else n for n in pixels)
    return across, along
