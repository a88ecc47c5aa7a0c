# SPDX-License-Identifier: GPL-3.0-or-later
"""A static mesh: one error in metres everywhere, no camera. What `adaptive-terrain bake` does."""

from collections.abc import Callable

from ..ask.criterion import Criterion
from ..field.heightfield import HeightField
from ..terrain import Terrain, Update
from .fit import fit


def bake(
    field: HeightField,
    error_m: float,
    *,
    fitted: bool = False,
    max_triangles: int | None = None,
    meshlet: int = 0,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> Update:
    """The mesh that is nowhere more than `error_m` metres of height from the height field, which `open_store` gives.

    `fitted`: vertices leave the surface within that error, so that fewer triangles do (a `Fitted`, without meshlets);
    `on_progress` follows that, 0 .. 1, and may raise, which cancels. With a limit of `max_triangles` the finest error
    that fits. Heights become `height * vertical_scale + vertical_offset` metres. Raises TerrainError if a number cannot
    be used.
    """
    heights = {"vertical_scale": vertical_scale, "vertical_offset": vertical_offset}
    if fitted:
        limits = {"max_triangles": max_triangles, "threads": threads, "on_progress": on_progress}
        return fit(field, error_m, **limits, **heights)
    criterion = Criterion(error_px=0.0, error_m=error_m, max_triangles=max_triangles, meshlet=meshlet)
    return Terrain(field, threads).update(criterion, **heights)
