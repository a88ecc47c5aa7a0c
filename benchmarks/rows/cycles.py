# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole Cycles renders of one frame: our mesh against Cycles' own adaptive subdivision of the same heights, and how
close each picture comes to that of the whole uniform grid.

Each way is a process of its own (cycles_frame.py), so that its peak memory can be told.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..rig.child import run_child
from ..rig.measure import Row

ADAPTIVE, ERROR, MAPPED, GRID, BARE = "adaptive", "error", "mapped", "grid", "bare"
PIXEL = 1.0
HIGH, LOW = 50.0, 82.0  # of the sun, degrees from the zenith
# Levels of 255 by which a pixel may differ before it counts as another.
VISIBLE = 8
# Of the index of structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004, section III): its window's Gaussian,
# and its constants for levels of 255.
SSIM_TAPS, SSIM_SIGMA = 11, 1.5
SSIM_C1, SSIM_C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


def cycles_rows(store: Path, tiff: Path, folder: Path) -> Iterator[Row]:
    """Our error at most 1 pixel against dicing at 1 pixel: time and memory."""
    found, pictures = {}, {}
    for mode in (GRID, ADAPTIVE, ERROR):
        found[mode], pictures[mode] = rendered(mode, PIXEL, store, tiff, folder)
    ours, theirs = found[ERROR], found[ADAPTIVE]
    row = Row("cycles_error", ours["triangles"], ours["ms"], "cycles dicing", theirs["ms"])
    row.first_ms = ours["first_ms"]
    row.figures = difference(pictures[ERROR], pictures[ADAPTIVE])
    for name, mode in (("", ERROR), ("baseline_", ADAPTIVE)):
        row.figures[f"{name}ssim"] = similarity(pictures[mode], pictures[GRID])
        row.figures[f"{name}cpu_s"] = found[mode]["cpu_s"]
    yield row
    if ours["peak_mb"] is not None:
        yield memory_row("cycles_error_memory", ours, theirs, 0.0)


def rendered(mode: str, px: float, store: Path, tiff: Path, folder: Path, sun: float = HIGH) -> tuple[dict, np.ndarray]:
    """What a render in a process of its own has cost, and its picture."""
    picture = folder / f"{mode}_{px:g}.png"
    said = run_child("rows.cycles_frame", mode, store, tiff, px, picture, sun)
    return said, pixels(picture)


def memory_row(name: str, ours: dict, theirs: dict, base_mb: float) -> Row:
    """The ratio of peak memory, of both above what `base_mb` says that anything takes."""
    row = Row(name, ours["triangles"], None, "cycles dicing")
    row.ratio = (ours["peak_mb"] - base_mb) / (theirs["peak_mb"] - base_mb)
    row.figures = {"peak_mb": ours["peak_mb"], "baseline_peak_mb": theirs["peak_mb"]}
    if base_mb:
        row.figures["base_mb"] = base_mb
    return row


def pixels(picture: Path) -> np.ndarray:
    """float32 [height, width, 3], 0 to 255."""
    import bpy

    image = bpy.data.images.load(str(picture))
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(values)
    width, height = image.size
    bpy.data.images.remove(image)
    return 255 * values.reshape(height, width, 4)[..., :3]


def difference(ours: np.ndarray, theirs: np.ndarray) -> dict[str, float]:
    """Mean difference in levels of 255, and the share of pixels that differ visibly."""
    apart = np.abs(ours - theirs).max(axis=2)
    return {"mean_levels": float(apart.mean()), "pixels_apart_percent": 100 * float((apart > VISIBLE).mean())}


def similarity(one: np.ndarray, other: np.ndarray) -> float:
    """Mean structural similarity of two pictures, 1 for equal ones, of the mean of their channels."""
    x, y = (picture.mean(axis=2, dtype=np.float64) for picture in (one, other))
    mean_x, mean_y = _blurred(x), _blurred(y)
    variances = _blurred(x * x) - mean_x**2 + _blurred(y * y) - mean_y**2
    covariance = _blurred(x * y) - mean_x * mean_y
    light = (2 * mean_x * mean_y + SSIM_C1) / (mean_x**2 + mean_y**2 + SSIM_C1)
    return float((light * (2 * covariance + SSIM_C2) / (variances + SSIM_C2)).mean())


def _blurred(image: np.ndarray) -> np.ndarray:
    """The Gaussian mean about each pixel whose whole window is in the image."""
    weights = np.exp(-0.5 * ((np.arange(SSIM_TAPS) - SSIM_TAPS // 2) / SSIM_SIGMA) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(image, SSIM_TAPS, axis)
        image = windows @ weights
    return image
