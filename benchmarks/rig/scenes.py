# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrains and camera flights of the benchmark: a flat terrain with a panoramic camera, a rough one with a lens."""

from collections.abc import Callable
from functools import cache

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import island
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain, Update
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.view import PANORAMIC, View

SAMPLES = 4097
SIDE = 4096.0  # metres
STEP = 0.001  # camera motion a frame, as a fraction of the side
EYE_HEIGHT = 2.0  # metres over the flat terrain
PANORAMA_PIXELS = 1920
DEPTH = 27  # maximum depth, the same as in the serial baseline
MILLION = 1_000_000
# The search for a triangle count accepts this relative difference.
TOLERANCE = 0.01


def flat() -> HeightField:
    """Return a flat terrain."""
    return from_array(np.zeros((SAMPLES, SAMPLES), np.float32), SIDE / (SAMPLES - 1))


def noise(samples: int) -> np.ndarray:
    """Return periodic noise, float32 [samples, samples] metres, with a power spectrum of exponent -2.2."""
    rng = np.random.default_rng(1)
    frequency = np.fft.rfftfreq(samples)[None, :] ** 2 + np.fft.fftfreq(samples)[:, None] ** 2
    frequency[0, 0] = 1
    spectrum = rng.standard_normal((samples, samples // 2 + 1)) * frequency**-1.1
    spectrum[0, 0] = 0
    heights = np.fft.irfft2(spectrum, (samples, samples))
    return (heights / heights.std() * 30).astype(np.float32)


def rough() -> HeightField:
    """Return a terrain of noise."""
    return from_array(noise(SAMPLES), SIDE / (SAMPLES - 1))


@cache
def island_of(samples: int) -> HeightField:
    """Return the built-in island, the same object for every row."""
    return from_array(island.island(samples), island.SIDE / (samples - 1))


def around(frame: int) -> View:
    """Return a panoramic view from just over the flat terrain, whose leaves have every size."""
    eye = np.array([-0.07 * SIDE + STEP * SIDE * frame, 0.07 * SIDE, EYE_HEIGHT])
    return View.look(eye, eye + [1, 0, 0], kind=PANORAMIC, fov_deg=360, resolution=(PANORAMA_PIXELS, 1080))


def eye_over(frame: float, side: float = SIDE) -> np.ndarray:
    """Return the eye of a flight along the southern border, float64 [3] metres."""
    return np.array([(STEP * frame - 0.4) * side, -0.5 * side, side / 16])


def over(frame: float, side: float = SIDE) -> View:
    """Return the view from the southern border towards the centre of a terrain."""
    return View.look(eye_over(frame, side), (0, 0, 0))


def edges(px: float) -> Criterion:
    """Return a criterion of edge lengths on screen."""
    return Criterion(error_px=0, edge_px=px, max_depth=DEPTH)


def errors(px: float) -> Criterion:
    """Return a criterion of error on screen, with the default guard band and coarser detail outside the frame."""
    return Criterion(error_px=px)


def pixels_for(field: HeightField, view: View, criterion: Callable[[float], Criterion], triangles: int) -> float:
    """Return the pixels for which `criterion(pixels)` gives about `triangles` in a view.

    Raises:
        TerrainError: no such number of pixels was found.
    """
    terrain, px = Terrain(field), 64.0
    for _ in range(40):
        found = terrain.update(criterion(px), [view]).triangles
        if abs(found - triangles) <= TOLERANCE * triangles:
            return px
        # Triangles are proportional to pixels to a power between -1 and -2. The limits keep every trial cheap.
        px *= min(max((found / triangles) ** 0.6, 0.25), 4.0)
    raise TerrainError(f"No refinement of about {triangles:,} triangles was found (the last had {found:,})")


class TimedFlight:
    """Terrain seen by a moving camera; each call updates the next frame and returns milliseconds by step."""

    def __init__(
        self, field: HeightField, views: Callable[[int], View], criterion: Criterion, threads: int | None = None
    ):
        self.terrain, self.views, self.criterion = Terrain(field, threads), views, criterion
        self.frame = -1
        self.update: Update | None = None

    def __call__(self) -> dict[str, float]:
        """Refine the next frame; return the times of its steps in ms. Raises TerrainError if nothing changed."""
        self.frame += 1
        self.update = self.terrain.update(self.criterion, [self.views(self.frame)])
        if not self.update.changed:
            raise TerrainError(f"Frame {self.frame} of a benchmark has the same mesh as the one before")
        return self.update.ms
