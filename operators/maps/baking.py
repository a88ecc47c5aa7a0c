# SPDX-License-Identifier: GPL-3.0-or-later
"""A request to bake maps, in plain numbers, and its execution, both independent of Blender."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cbt_terrain.attributes import sizing
from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.attributes.bake import Baked, bake
from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.coding import PNG, coding_of
from ...cbt_terrain.attributes.finer_pyramid import min_level
from ...cbt_terrain.attributes.tiling import tiling_of
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.view import View


@dataclass(frozen=True, eq=False)
class MapRequest:
    """One bake.

    `requests`: the attributes to bake. `folder`: of the images. `views`: the views that determine the resolution, none
    for that of the height map; `placement`: from the terrain's space to the world, float64 [4, 4]. `only_seen`: tiles
    outside all frames get the coarsest images. `budget_mb`: memory of all images, None for any. `form`: PNG or EXR.
    `store`, `land`: of the heights, as in a scene's Request.
    """

    requests: tuple[AttributeRequest, ...]
    folder: Path
    views: tuple[View, ...] = ()
    placement: np.ndarray | None = None
    only_seen: bool = False
    budget_mb: float | None = None
    form: str = PNG
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    store: str = ""
    land: object = None


def bake_maps(
    request: MapRequest,
    field,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    lock: AbstractContextManager | None = None,
) -> Baked:
    """Bake the requested maps of a height field into images, without touching Blender, so on any thread.

    Images that are up to date are not made again. Raises TerrainError.

    Args:
        field: the height field of the request's store or land, without an anchor.
        on_progress: called with the fraction done; may raise to stop.
        lock: held while the engine works, for other threads that use it; None for none.
    """
    tiling = tiling_of(field.lattice, min_level(field.raster))  # min_level: below 0 where parts have finer samples
    heights = {"vertical_scale": request.vertical_scale, "vertical_offset": request.vertical_offset}
    # Metres for each tile: of its finest content, which no texel has to be smaller than, and of the pixels that see it.
    content = pixels = sizing.shown_by(tiling, field, request.requests)
    if request.views:  # no finer than a pixel of a view
        placement = np.eye(4) if request.placement is None else request.placement
        pixels = sizing.footprints(sizing.boxes(tiling, field, **heights), request.views, placement, request.only_seen)
    texel_bytes = sum(coding_of(ATTRIBUTES[item.name], request.form).texel_bytes for item in request.requests)
    # sides: texels along a side of each tile's image; tiles get coarser if all texels exceed the budget.
    sides = sizing.resolutions(tiling, pixels, content, texel_bytes, request.budget_mb)
    more = {"form": request.form, "on_progress": on_progress, "lock": lock}
    return bake(field, request.requests, request.folder, sides, **heights, **more)


def check_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of attributes, sorted, each once. Raises TerrainError for an unknown name, or for none."""
    names = sorted(set(names))
    unknown = [name for name in names if name not in ATTRIBUTES]
    if unknown or not names:
        what = f"There is no map {unknown[0]!r}" if unknown else "No map is requested"
        raise TerrainError(what, expected=f"one or more of {', '.join(sorted(ATTRIBUTES))}")
    return tuple(names)


def summary(baked: Baked, name: str) -> str:
    """Describe a bake in one line: images written and unchanged, their size, and the maps. `name`: the terrain's."""
    sides = {tile["resolution"] for entry in baked.index["maps"].values() for tile in entry["tiles"]}
    range_text = " to ".join(str(side) for side in sorted({min(sides), max(sides)}))
    images = "image" if baked.written == 1 else "images"
    return (
        f"{name}: {baked.written} {images} baked, {baked.unchanged} kept, {range_text} texels a side: "
        f"{', '.join(baked.index['maps'])}"
    )
