# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack applied to a store, into another store: the work, which shape_process.py does in a process of its own."""

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import store, store_folder
from ..field.build import build
from ..field.heightfield import HeightField
from ..importing.build_store import finished_before
from ..importing.drafts import drafted, figures, room_for
from ..importing.placing import rotation_of
from ..run import launch
from .level_plan import MOST_WHOLE
from .level_work import METHOD
from .mask_image import load_image
from .shape import Shaped, shape
from .stack import Stack, check_by_products, land_name, stack_content, stack_from
from .stack_layers import joined, key_with
from .tile_cache import TileCache
from .tiles import Wanted, levels_of, whole_land

# The part of the work that effects are taken for; the rest is that of an import.
SHAPING = 0.8
ROWS = 256
RECORD = 1  # raised when the provenance of shaped land says more, so that older land is made again
BUILDING = "Measuring errors"
DOUBTFUL = (
    "Tiles of {} may differ by more than 5 % from the land in one piece: big rivers run elsewhere at each level, and "
    f"beyond {MOST_WHOLE} x {MOST_WHOLE} samples a level is not made in one piece. Use a height map of at most that "
    "size, or harder rock (a lower erodibility or fewer years)."
)
ROOM_ELSEWHERE = "choose another folder (in Blender: Pack Store Beside File)"


def run_shape(
    source: str | os.PathLike,
    stack: Stack,
    path: str | os.PathLike,
    wanted: Wanted | None = None,
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None,
    folder: str | None = None,
    finish: Callable[[], bool] = lambda: False,
    threads: int | None = None,
    tiles: str | os.PathLike | None = None,
) -> dict:
    """Shape the store `source` into the store `path` in this process and return the report; `path` changes at the very
    end or not at all, but for tiles that are kept there for the next time.

    wanted: the tiles of each level (tiles.py), None for all of the land. finish: asked now and then whether the levels
    that are done are enough. folder: name of the folder for the new arrays, if the caller wants to know it. tiles:
    where tiles are kept, which several stores of one source may share; None for a folder in `path`. Raises
    TerrainError.
    """
    started, path, threads = time.monotonic(), Path(path), threads or launch.default_threads()
    stack = stack_from(stack_content(stack))  # numbers as those of the process that asked
    store_folder.check_target(path)
    heights = open_source(source, path, stack)
    digest = shape_digest(heights, stack, wanted)
    report = finished_before(path, digest)
    if report is not None:
        return report
    everywhere = wanted is None
    wanted = whole_land(heights.lattice) if everywhere else wanted
    units = layer_units(heights, stack)
    with drafted(path, folder, heights.lattice, len(units), ROOM_ELSEWHERE) as draft:
        room = room_for(heights.lattice, len(units))
        cache = TileCache(path / store_folder.TILES if tiles is None else Path(tiles), room)
        images = {file: load_image(file, cache.folder) for file in mask_files(stack)}
        shaped = shape(
            heights,
            stack,
            wanted,
            images=images,
            cache=cache,
            threads=threads,
            on_progress=lambda fraction, message: on_progress(SHAPING * fraction, message),
            finish=finish,
        )
        field = _build(heights, shaped, draft, threads, lambda f: on_progress(SHAPING + (1 - SHAPING) * f, BUILDING))
        layers = _write_layers(heights, shaped, draft)
        field.key = key_with(field.key, layers)
        field.provenance = heights.provenance | {"shaped": _provenance(source, heights, stack, shaped, everywhere)}
        report = _report(field, source, heights, stack, shaped)
        report["seconds"] = round(time.monotonic() - started, 3)
        # What stopped early is not what was asked for.
        draft.publish(field, "" if shaped.finished_early else digest, report, {name: units[name] for name in layers})
        cache.trim()
    return report


def open_source(source: str | os.PathLike, path: Path, stack: Stack) -> HeightField:
    """The store to be shaped. Raises TerrainError, also where it is the one that is to be written, or lacks what the
    stack's masks read."""
    heights = store.open_store(source)
    if os.path.realpath(source) == os.path.realpath(path):
        raise TerrainError(f"The store {path} would be shaped into itself: choose another folder to write.")
    check_by_products(stack, heights.layers)
    heights.check_samples()
    return heights


def shape_digest(heights: HeightField, stack: Stack, wanted: Wanted | None) -> str:
    """Of all that decides what the store will hold."""
    tiles = wanted and [None if some is None else sorted((t, float(m)) for t, m in some.items()) for some in wanted]
    content = METHOD, RECORD, store.VERSION, heights.key, stack.key(), tiles
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def mask_files(stack: Stack) -> list[str]:
    """The images that the stack's masks are painted in."""
    return sorted({entry.mask.image for entry in stack.active if entry.mask is not None and entry.mask.image})


def layer_units(heights: HeightField, stack: Stack) -> dict[str, str]:
    """The layers that there will be, and their units."""
    units = dict(getattr(heights.layers, "units", {}))
    return units | {layer.name: layer.unit for entry in stack.active for layer in entry.declaration.layers}


def _build(
    heights: HeightField, shaped: Shaped, draft: store.Draft, threads: int, on_progress: Callable[[float], None]
) -> HeightField:
    """The height field of the shaped samples in the arrays of a draft."""
    samples = draft.allocate("samples", shaped.change.shape, np.dtype(np.float32))
    missing = 0
    for row in range(0, len(samples), ROWS):
        rows = slice(row, row + ROWS)
        before, change = heights.heights(rows), shaped.change[rows]
        with np.errstate(over="ignore", invalid="ignore"):
            samples[rows] = np.where(change == 0.0, before, before + change)
        if not np.isfinite(samples[rows]).all():
            raise TerrainError("The stack makes heights that are no numbers: switch its effects off one by one.")
        if heights.valid is not None:
            holes = heights.valid[rows] == 0
            samples[rows][holes] = np.nan
            missing += int(holes.sum())
    lattice = heights.lattice
    field = build(
        samples,
        lattice.step_x,
        lattice.step_y,
        missing=missing,
        holes=heights.valid is not None,
        source_max=heights.source_max,
        name="The shaped terrain",
        allocate=draft.allocate,
        threads=threads,
        on_progress=on_progress,
    )
    field.filled, field.origin, field.crs = heights.filled, heights.origin, heights.crs
    return field


def _write_layers(heights: HeightField, shaped: Shaped, draft: store.Draft) -> dict[str, np.ndarray]:
    """The layers of the source and of the stack as arrays of the draft, by name."""
    written = {}
    for name, layer in joined(heights.layers, shaped.layers, shaped.depths).items():
        if not np.isfinite(layer).all():
            raise TerrainError(f"The stack makes a layer {name!r} with values that are no numbers: report its effects.")
        written[name] = draft.allocate(store.layer_name(name), layer.shape, np.dtype(np.float32))
        written[name][:] = layer
    return written


def _provenance(
    source: str | os.PathLike, heights: HeightField, stack: Stack, shaped: Shaped, everywhere: bool
) -> dict:
    return {
        "source": str(source),
        "source_key": heights.key,
        "land": land_name(heights.key, stack),
        "everywhere": everywhere,
        "stack": stack_content(stack),
        "tiles": shaped.tiles,
        "tile_counts": shaped.tile_counts,
        "added": [dataclasses.asdict(added) for added in shaped.added],
        "left_out_rms_m": shaped.left_out_m[0],
        "left_out_most_m": shaped.left_out_m[1],
        "finished_early": shaped.finished_early,
    }


def _report(field: HeightField, source: str | os.PathLike, heights: HeightField, stack: Stack, shaped: Shaped) -> dict:
    lattice, levels = field.lattice, levels_of(field.lattice)
    built = sum(map(len, shaped.tiles))
    warnings = []
    rms, most = shaped.left_out_m
    if most > 0.0:
        warnings.append(
            f"Finer levels are left out in places; the last that was made there has changed heights by {rms:.3g} m "
            f"(root mean square), {most:.3g} m at most: what is missing is of that size."
        )
    warnings += [DOUBTFUL.format(name) for name in sorted({a.effect for a in shaped.added if a.doubtful})]
    return {
        "format": "shaped",
        "raster": [lattice.width, lattice.height],
        **figures(field),
        "rotation_deg": rotation_of(source),
        "bounds_against": "the surface as shaped",
        "effects": [entry.effect for entry in stack.active],
        "layers": sorted(field.layers) or sorted(layer_units(heights, stack)),
        "tiles_built": built,
        "tiles_there_are": sum(map(int, shaped.tile_counts)),
        "finest_spacing_m": max(levels[shaped.level].step_x, levels[shaped.level].step_y),
        "levels": [_line(added) for added in shaped.added],
        "left_out_rms_m": rms,
        "left_out_most_m": most,
        "finished_early": shaped.finished_early,
        "warnings": warnings,
    }


def _line(added) -> str:
    """`rivers at 16 m: 3.2 m rms, 41 m at most, 12 tiles, 3 of them new, 210 ms`."""
    tiles = f"{added.made} tile{'s' if added.made != 1 else ''}, {added.computed} of them new"
    tiles = f"the whole level, {'new' if added.computed else 'known before'}" if added.whole else tiles
    metres = f"{added.rms_m:.3g} m rms, {added.most_m:.3g} m at most"
    return f"{added.effect} at {added.spacing_m:.4g} m: {metres}, {tiles}, {added.ms:.0f} ms"
