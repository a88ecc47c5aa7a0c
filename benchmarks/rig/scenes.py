# SPDX-License-Identifier: GPL-3.0-or-later
"""The terrains and the flights that are measured: a flat one seen all round, a rough one seen through a lens."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.view import PANORAMIC, View
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import island
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain, Update

SAMPLES = 4097
SIDE = 4096.0  # metres
STEP = 0.001  # of the side, that the camera moves a frame
EYE_HEIGHT = 2.0  # metres, of the eye over the flat terrain
PANORAMA_PIXELS = 1920
DEPTH = 27  # as the serial baseline has
# A search for a number of triangles ends within this part of it.
TOLERANCE = 0.01

Asked = Callable[[float], Criterion]
Views = Callable[[int], View]


def flat() -> HeightField:
    return from_array(np.zeros((SAMPLES, SAMPLES), np.float32), SIDE / (SAMPLES - 1))


def noise(samples: int) -> np.ndarray:
    """float32 [samples, samples] metres: height falls with frequency to the power 2.2; repeats without a seam."""
    rng = np.random.default_rng(1)
    frequency = np.fft.rfftfreq(samples)[None, :] ** 2 + np.fft.fftfreq(samples)[:, None] ** 2
    frequency[0, 0] = 1
    spectrum = rng.standard_normal((samples, samples // 2 + 1)) * frequency**-1.1
    spectrum[0, 0] = 0
    heights = np.fft.irfft2(spectrum, (samples, samples))
    return (heights / heights.std() * 30).astype(np.float32)


def rough() -> HeightField:
    return from_array(noise(SAMPLES), SIDE / (SAMPLES - 1))


def built_in_island() -> HeightField:
    return island_of(SAMPLES)


@cache
def island_of(samples: int) -> HeightField:
    """The same one for every row that asks."""
    return from_array(island.island(samples), island.SIDE / (samples - 1))


def around(frame: int, height: float = EYE_HEIGHT) -> View:
    """All round, low over the flat terrain: leaves of every size, as the serial baseline has them."""
    eye = np.array([-0.07 * SIDE + STEP * SIDE * frame, 0.07 * SIDE, height])
    return View.look(eye, eye + [1, 0, 0], kind=PANORAMIC, fov_deg=360, resolution=(PANORAMA_PIXELS, 1080))


def eye_over(frame: float, side: float = SIDE) -> np.ndarray:
    return np.array([(STEP * frame - 0.4) * side, -0.5 * side, side / 16])


def over(frame: int, side: float = SIDE) -> View:
    """From the rim of the rough terrain towards its middle."""
    return View.look(eye_over(frame, side), (0, 0, 0))


def edges(px: float, depth: int = DEPTH) -> Criterion:
    return Criterion(error_px=0, edge_px=px, max_depth=depth)


def errors(px: float, meshlet: int = 0) -> Criterion:
    """Guard band and coarser detail off screen are on, as they are by default."""
    return Criterion(error_px=px, meshlet=meshlet)


def pixels_for(field: HeightField, view: Callable[[float], View], asked: Asked, triangles: int) -> float:
    """How many pixels to ask for so that about `triangles` result; `view(px)` may depend on the answer."""
    terrain, px = Terrain(field), 64.0
    for _ in range(40):
        found = terrain.update(asked(px), [view(px)]).triangles
        if abs(found - triangles) <= TOLERANCE * triangles:
            return px
        # Triangles fall with pixels to a power between 1 and 2, so this converges; and it never asks for far too much.
        px *= min(max((found / triangles) ** 0.6, 0.25), 4.0)
    raise TerrainError(f"No refinement of about {triangles:,} triangles was found; the last had {found:,}.")


def height_reaching(depth: int, px: float) -> float:
    """Metres over the flat terrain from which the finest leaves just have `depth` bisections."""
    longest = SIDE * 2 ** ((3 - depth) / 2)  # of a triangle one bisection above the finest
    return longest / (1.1 * px * math.tau / PANORAMA_PIXELS)


class Flight:
    """A terrain whose camera moves on by one frame at each call, which returns the milliseconds by step."""

    def __init__(self, field: HeightField, views: Views, criterion: Criterion, threads: int | None = None):
        self.terrain, self.views, self.criterion = Terrain(field, threads), views, criterion
        self.frame = -1
        self.update: Update | None = None

    def __call__(self) -> dict[str, float]:
        self.frame += 1
        self.update = self.terrain.update(self.criterion, [self.views(self.frame)])
        if not self.update.changed:
            raise TerrainError(f"Frame {self.frame} of a benchmark shows the same mesh as the one before.")
        return self.update.ms
