# SPDX-License-Identifier: GPL-3.0-or-later
"""How time grows with triangles: slopes of straight lines through logarithms; 1 is proportional."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ..rig.measure import Row, alternate
from . import engine, in_blender

SIZES = (50_000, 250_000, 1_000_000, 4_000_000)
QUICK_SIZES = SIZES[:3]


def refine_row(flat: HeightField, sizes: tuple[int, ...]) -> Row:
    return _scale("refine", lambda size: engine.edge_flight(flat, size), sizes, engine.refine_ms)


def surface_row(rough: HeightField, sizes: tuple[int, ...]) -> Row:
    return _scale("surface", lambda size: engine.error_flight(rough, size), sizes)


def ingest_row(rough: HeightField, sizes: tuple[int, ...]) -> Row:
    return _scale("ingest", lambda size: in_blender.writers(rough, size)[0], sizes)


def frame_row(rough: HeightField, store: Path, sizes: tuple[int, ...]) -> Row:
    return _scale("frame", lambda size: in_blender.frames(rough, store, size)[0], sizes)


def _scale(
    name: str,
    prepare: Callable[[int], Callable[[], dict[str, float]]],
    sizes: tuple[int, ...],
    part: Callable[[dict[str, float]], float] = lambda steps: steps["total"],
) -> Row:
    """The time of the largest size on every thread; its ratio is the slope over all of them."""
    points = {size: part(alternate(prepare(size)).ms) for size in sizes}
    row = Row(f"scale_{name}", sizes[-1], points[sizes[-1]], "slope", ratio=slope(points))
    row.figures = {f"{size}_ms": ms for size, ms in points.items()}
    return row


def slope(points: dict[int, float]) -> float:
    """The exponent p of the power law size^p that fits the times best."""
    return float(np.polyfit(np.log(list(points)), np.log(list(points.values())), 1)[0])
