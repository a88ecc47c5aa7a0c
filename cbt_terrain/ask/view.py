# SPDX-License-Identifier: GPL-3.0-or-later
"""A view: what a camera sees, in numbers of float64, wherever the camera came from."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError
from .linear import length, product

PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC = "PERSPECTIVE", "ORTHOGRAPHIC", "PANORAMIC"
KINDS = (PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)
MAX_PIXELS = 1_000_000


@dataclass(frozen=True, eq=False)
class View:
    """One camera.

    `world_to_camera` float64 [4, 4]: x right, y up, looking along -z; it need not be rigid (a sheared camera).
    `projection` float64 [4, 4]: camera space to normalised device coordinates, as OpenGL; None for a panorama.
    `resolution`: pixels across and up, of the whole frame. `clip`: start and end in metres along the view.
    `radians_per_pixel`: of a panorama, which has no projection matrix.
    """

    world_to_camera: np.ndarray
    projection: np.ndarray | None
    resolution: tuple[float, float]
    kind: str = PERSPECTIVE
    clip: tuple[float, float] = (0.1, 1e30)
    radians_per_pixel: float = 0.0

    def __post_init__(self):
        matrix = np.array(self.world_to_camera, np.float64)
        object.__setattr__(self, "world_to_camera", matrix)
        if self.projection is not None:
            object.__setattr__(self, "projection", np.array(self.projection, np.float64))
        if self.kind not in KINDS:
            raise TerrainError(f"The camera's kind is {self.kind!r}; expected one of {', '.join(KINDS)}.")
        if self.world_to_camera.shape != (4, 4) or not np.isfinite(self.world_to_camera).all():
            raise TerrainError(
                "The camera's matrix has a value that is not finite; check its location and its parents."
            )
        _check_resolution(self.resolution)
        if self.kind == PANORAMIC:
            if not 0 < self.radians_per_pixel < math.inf:
                raise TerrainError(f"A panorama has {self.radians_per_pixel} radians a pixel; expected more than 0.")
            return
        if self.projection is None or self.projection.shape != (4, 4) or not np.isfinite(self.projection).all():
            raise TerrainError("The camera's projection is not finite; check its lens, sensor, scale and shift.")
        if self.projection[0, 0] == 0 or self.projection[1, 1] == 0:
            raise TerrainError("The camera's projection sees 180 degrees or nothing; check its lens and sensor.")

    def key(self) -> bytes:
        """The same bytes for the same view."""
        projection = b"" if self.projection is None else self.projection.tobytes()
        numbers = np.array([*self.resolution, *self.clip, self.radians_per_pixel])
        return self.kind.encode() + self.world_to_camera.tobytes() + projection + numbers.tobytes()

    @property
    def pixels_per_unit(self) -> float:
        """Pixels per unit of tangent (perspective), per metre (orthographic) or per radian (panoramic): the larger."""
        if self.kind == PANORAMIC:
            return 1.0 / self.radians_per_pixel
        return (
            float(max(abs(self.projection[0, 0]) * self.resolution[0], abs(self.projection[1, 1]) * self.resolution[1]))
            / 2
        )

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The frame's left and right, bottom and top: tangents from the view axis (perspective) or metres."""
        at = 2 if self.kind == PERSPECTIVE else 3
        sign = 1.0 if self.kind == PERSPECTIVE else -1.0

        def axis(i: int) -> tuple[float, float]:
            scale, shift = float(self.projection[i, i]), sign * float(self.projection[i, at])
            ends = sorted(((-1 + shift) / scale, (1 + shift) / scale))
            return ends[0], ends[1]

        return axis(0), axis(1)

    @classmethod
    def look(
        cls,
        eye,
        target,
        *,
        fov_deg: float = 50.0,
        resolution: tuple[int, int] = (1920, 1080),
        kind: str = PERSPECTIVE,
        ortho_width: float = 1.0,
        clip: tuple[float, float] = (0.1, 1e6),
        roll_deg: float = 0.0,
    ) -> "View":
        """A view built by hand: from `eye` towards `target` (metres, world), z up, `fov_deg` across the larger side."""
        _check_resolution(resolution)
        if kind == PERSPECTIVE and not 1e-7 < fov_deg < 180:
            raise TerrainError(f"The field of view is {fov_deg} degrees; expected more than 1e-7 and less than 180.")
        eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
        back = eye - target
        distance = length(back)
        if not distance > 0:
            raise TerrainError(f"The view's eye and target are both {tuple(eye)}; expected two different points.")
        back /= distance
        up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.999999 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, back)
        right /= length(right)
        up = np.cross(back, right)
        turn = math.radians(roll_deg)
        right, up = math.cos(turn) * right + math.sin(turn) * up, math.cos(turn) * up - math.sin(turn) * right
        matrix = np.eye(4)
        matrix[:3, :3] = right, up, back
        matrix[:3, 3] = -product(matrix[:3, :3], eye)
        width, height = resolution
        if kind == PANORAMIC:
            return cls(matrix, None, resolution, kind, clip, radians_per_pixel=math.radians(fov_deg) / width)
        projection = np.zeros((4, 4))
        larger = max(width, height)
        start, end = clip
        if start == end:
            raise TerrainError(f"The clip range is {clip}; expected a start before its end, in metres.")
        if kind == PERSPECTIVE:
            focal = 1.0 / math.tan(math.radians(fov_deg) / 2)
            projection[0, 0], projection[1, 1] = focal * larger / width, focal * larger / height
            projection[2, 2:], projection[3, 2] = ((start + end) / (start - end), 2 * start * end / (start - end)), -1.0
        else:
            projection[0, 0], projection[1, 1] = 2 / ortho_width * larger / width, 2 / ortho_width * larger / height
            projection[2, 2:], projection[3, 3] = (2 / (start - end), (start + end) / (start - end)), 1.0
        return cls(matrix, projection, resolution, kind, clip)


def listed_views(views: Iterable[View]) -> list[View]:
    """Return the views as a list. Raises TerrainError where that is no list, tuple or generator of views."""
    found = [views] if isinstance(views, View) else list(views) if isinstance(views, Iterable) else None
    if found is None or not all(isinstance(view, View) for view in found):
        wrong = views if found is None else next(view for view in found if not isinstance(view, View))
        raise TerrainError(f"The views hold a {type(wrong).__name__}; expected a list of View objects, one a camera.")
    return found


def _check_resolution(resolution: tuple[float, float]) -> None:
    if not all(0 < pixels <= MAX_PIXELS for pixels in resolution):
        raise TerrainError(f"The resolution is {resolution}; expected 1 to {MAX_PIXELS:,} pixels each way.")
