# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles renders in child processes (cycles_frame.py), so that peak memory can be measured, and their comparison."""

from pathlib import Path

import numpy as np

from ..rig.child import run_child

ADAPTIVE, ERROR, MAPPED, GRID, BARE = "adaptive", "error", "mapped", "grid", "bare"
PIXEL = 1.0
HIGH, LOW = 50.0, 82.0  # degrees of the sun from the zenith
# Window and constants of structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004, section III), for 255 levels.
SSIM_TAPS, SSIM_SIGMA = 11, 1.5
SSIM_C1, SSIM_C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


def render(mode: str, px: float, store: Path, tiff: Path, folder: Path, sun: float = HIGH) -> tuple[dict, np.ndarray]:
    """Render in a child process; return its costs and its picture."""
    picture = folder / f"{mode}_{px:g}.png"
    costs = run_child("rows.cycles_frame", mode, store, tiff, px, picture, sun)
    return costs, pixels(picture)


def pixels(picture: Path) -> np.ndarray:
    """Return a picture, float32 [height, width, 3], 0 to 255."""
    import bpy

    image = bpy.data.images.load(str(picture))
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(values)
    width, height = image.size
    bpy.data.images.remove(image)
    return 255 * values.reshape(height, width, 4)[..., :3]


def similarity(one: np.ndarray, other: np.ndarray) -> float:
    """Return the mean structural similarity of two pictures, averaged over channels first; 1 for equal pictures."""
    x, y = (picture.mean(axis=2, dtype=np.float64) for picture in (one, other))
    mean_x, mean_y = _blur(x), _blur(y)
    variances = _blur(x * x) - mean_x**2 + _blur(y * y) - mean_y**2
    covariance = _blur(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x**2 + mean_y**2 + SSIM_C1)
    return float((luminance * (2 * covariance + SSIM_C2) / (variances + SSIM_C2)).mean())


def _blur(image: np.ndarray) -> np.ndarray:
    """Return the Gaussian mean around each pixel with a complete window."""
    weights = np.exp(-0.5 * ((np.arange(SSIM_TAPS) - SSIM_TAPS // 2) / SSIM_SIGMA) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(image, SSIM_TAPS, axis)
        image = windows @ weights
    return image
