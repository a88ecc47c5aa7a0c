# SPDX-License-Identifier: GPL-3.0-or-later
"""Application of a stack to a store, which writes another store; shape_process.py runs it in a child process.

`heights` is the source's height field, and `shaped` the change that the stack makes to its samples.
"""

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
from ..field.store_layers import layer_name
from ..importing.drafts import open_draft, shaped_bytes
from ..importing.earlier_import import finished_before
from ..importing.finer_import import finer_entries
from ..importing.import_report import common_report_entries
from ..importing.placing import rotation_of
from ..run import launch
from .finer_land import not_finite, raster_part, with_shaped_tiles
from .level_plan import MAX_WHOLE
from .level_work import HOLES, METHOD
from .mask_image import load_image
from .shape import Shaped, shape
from .shaping import Added
from .stack import Stack, check_by_products, land_name, stack_content, stack_from
from .stack_layers import key_with, merge_layers
from .tile_cache import TileCache
from .tiles import Wanted, levels_of, whole_land

# Fraction of the progress bar for the operators; the rest is for measuring errors.
SHAPING = 0.8
ROWS = 256
RECORD = 1  # version of the provenance; raising it rebuilds older land
ADDED_KEYS = {"max_m": "most_m", "pieces": "made"}  # names of attributes of Added in the provenance, where they differ
BUILDING, FINER = "Measuring errors", "Shaping finer tiles"
DOUBTFUL = (
    "Tiles of {} may differ by more than 5 % from the land in one piece: big rivers run elsewhere at each level, and "
    f"beyond {MAX_WHOLE} x {MAX_WHOLE} samples a level is not made in one piece. Use a height map of at most that "
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
    """Shape the store `source` into the store `path` in this process and return the report.

    A store that was shaped so before stays, and its report has "unchanged". Only the last step changes `path`, except
    for cached tiles. Raises TerrainError.

    wanted: for each level {tile: allowed error in metres} or None for all of it; None for all levels. on_progress: gets
    the finished fraction and a text. finish: called now and then; True stops after the complete levels. folder: name of
    the folder for the new arrays, None for a new one. tiles: folder of cached tiles, which stores of one source can
    share; None for a folder in `path`.
    """
    started, path, threads = time.monotonic(), Path(path), threads or launch.default_threads()
    stack = stack_from(stack_content(stack))  # the same numbers as in the child process
    store_folder.check_target(path)
    heights = open_source(source, path, stack)
    digest = shape_digest(heights, stack, wanted)
    report = finished_before(path, digest)
    if report is not None:
        return report
    everywhere = wanted is None  # the store records whether all tiles were requested
    wanted = whole_land(heights.lattice) if wanted is None else wanted
    units = layer_units(heights, stack)  # of the layers that the new store will have, by name
    num_finer = len(heights.raster.finer.heights) if heights.raster.finer is not None else 0
    room = shaped_bytes(heights.lattice, len(units), num_finer)  # bytes that the cache of tiles leaves for the store
    # The draft is the new store, which is removed after an error before `publish`.
    with open_draft(path, folder, heights.lattice, room, ROOM_ELSEWHERE) as draft:
        tiles = path / store_folder.TILES if tiles is None else Path(tiles)
        cache = TileCache(tiles, room)
        images = {file: load_image(file, tiles) for file in sorted(stack.mask_images)}
        # The change is computed when the progress is SHAPING; the rest builds the store.
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
        built = SHAPING + (1.0 - SHAPING) * raster_part(heights)  # progress when only finer tiles are left
        field = _build(
            heights, shaped, draft, threads, lambda f: on_progress(SHAPING + (built - SHAPING) * f, BUILDING)
        )
        field = with_shaped_tiles(
            field, heights, threads, draft.allocate, lambda f: on_progress(built + (1.0 - built) * f, FINER), cache
        )
        layers = _write_layers(heights, shaped, draft)
        # `build` knows only the samples: add the source's metadata, and the layers to the key of the content.
        field = field.with_raster(
            digest=key_with(field.raster.digest, layers),
            filled=heights.filled,
            origin=heights.origin,
            crs=heights.crs,
            place=heights.raster.place,
            provenance=heights.provenance | {"shaped": _provenance(source, heights, stack, shaped, everywhere)},
        )
        report = _shaping_report(field, source, heights, stack, shaped)
        report["seconds"] = round(time.monotonic() - started, 3)
        # A run that finished early does not satisfy the same request later.
        draft.publish(field, "" if shaped.finished_early else digest, report, {name: units[name] for name in layers})
        cache.trim()
    return report


def open_source(source: str | os.PathLike, path: Path, stack: Stack) -> HeightField:
    """Open the store to shape.

    Raises TerrainError if it is damaged, is the target, or lacks a layer that the stack's masks read.
    """
    heights = store.open_store(source)
    if os.path.realpath(source) == os.path.realpath(path):
        raise TerrainError(f"The store {path} would be shaped into itself", fix="choose another folder to write")
    check_by_products(stack, heights.layers)
    heights.raster.check_samples()
    return heights


def shape_digest(heights: HeightField, stack: Stack, wanted: Wanted | None) -> str:
    """Return a digest of everything that determines the content of the store.

    heights: the source. wanted: for each level {tile: allowed error in metres} or None for all of it; None for all.
    """
    tiles = None
    if wanted is not None:
        tiles = [None if pairs is None else sorted((t, float(m)) for t, m in pairs.items()) for pairs in wanted]
    holes = [] if heights.valid is None else [HOLES]
    content = METHOD, RECORD, store.VERSION, heights.raster.digest, stack.key(), tiles, *holes
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def layer_units(heights: HeightField, stack: Stack) -> dict[str, str]:
    """Return the units of the layers of the result, by name."""
    units = dict(getattr(heights.layers, "units", {}))  # of the source's layers, if they have units
    return units | {layer.name: layer.unit for entry in stack.active for layer in entry.declaration.layers}


def _build(
    heights: HeightField, shaped: Shaped, draft: store.Draft, threads: int, on_progress: Callable[[float], None]
) -> HeightField:
    """Build the height field of the shaped samples in the arrays of a draft.

    Raises TerrainError for a change that is not finite.
    """
    samples = draft.allocate("samples", shaped.change.shape, np.dtype(np.float32))
    missing = 0  # samples in holes
    for row in range(0, len(samples), ROWS):
        rows = slice(row, row + ROWS)
        before, change = heights.heights(rows), shaped.change[rows]
        with np.errstate(over="ignore", invalid="ignore"):
            samples[rows] = np.where(change == 0.0, before, before + change)  # unchanged heights keep their bits
        if not np.isfinite(samples[rows]).all():
            raise not_finite()
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
        source_max=heights.source_max,  # largest rounding error of the source's heights, metres
        name="The shaped terrain",
        allocate=draft.allocate,
        threads=threads,
        on_progress=on_progress,
    )
    draft.remove("errors")  # in metres; the field has their codes
    return field


def _write_layers(heights: HeightField, shaped: Shaped, draft: store.Draft) -> dict[str, np.ndarray]:
    """Write the layers of the source and of the stack as arrays of the draft and return them by name; depths add up.

    Raises TerrainError for a layer that is not finite. shaped: the stack's result.
    """
    written = {}
    for name, layer in merge_layers(heights.layers, shaped.layers, shaped.depths).items():
        if not np.isfinite(layer).all():
            problem = f"The stack's layer {name!r} has values that are not finite numbers"
            raise TerrainError(problem, fix="report the stack as a bug")
        written[name] = draft.allocate(layer_name(name), layer.shape, np.dtype(np.float32))
        written[name][:] = layer
    return written


def _provenance(
    source: str | os.PathLike, heights: HeightField, stack: Stack, shaped: Shaped, everywhere: bool
) -> dict:
    """Return the entries of a store that tell how it was shaped, so that it can be updated.

    `everywhere`: every tile of every level was requested.
    """
    return {
        "source": str(source),
        "source_key": heights.raster.digest,
        "land": land_name(heights.raster.digest, stack),
        "everywhere": everywhere,
        "stack": stack_content(stack),
        "tiles": shaped.tiles,
        "tile_counts": shaped.tile_counts,
        "added": [
            {ADDED_KEYS.get(key, key): value for key, value in dataclasses.asdict(added).items()}
            for added in shaped.added
        ],
        "left_out_rms_m": shaped.left_out_m[0],
        "left_out_most_m": shaped.left_out_m[1],
        "finished_early": shaped.finished_early,
    }


def _shaping_report(
    field: HeightField, source: str | os.PathLike, heights: HeightField, stack: Stack, shaped: Shaped
) -> dict:
    """Return the report that the store keeps: sizes, effects, levels, and warnings about missing detail.

    Args:
        field: the shaped terrain.
        source: store that was shaped.
        heights: its field, unshaped.
        stack: the effects.
        shaped: changes, computed tiles, size of the missing detail (`left_out_m`), and for each operator and level an
            item of `added`. It is `doubtful` if its tiles differ too much from the level computed in one piece.
    """
    lattice, levels = field.lattice, levels_of(field.lattice)
    built = sum(map(len, shaped.tiles))  # computed tiles of all levels
    warnings = []
    rms, max_change = shaped.left_out_m
    if max_change > 0.0:
        warnings.append(
            f"Finer levels are left out in places. The finest level there changed heights by {rms:.3g} m (root mean "
            f"square), {max_change:.3g} m at most; the missing detail is of that size."
        )
    warnings += [DOUBTFUL.format(name) for name in sorted({a.effect for a in shaped.added if a.doubtful})]
    return {
        "format": "shaped",
        "raster": [lattice.width, lattice.height],
        **common_report_entries(field),
        **finer_entries(field),
        "rotation_deg": rotation_of(source),
        "bounds_against": "the surface as shaped",
        "effects": [entry.effect for entry in stack.active],
        "layers": sorted(layer_units(heights, stack)),
        "tiles_built": built,
        "tiles_there_are": sum(map(int, shaped.tile_counts)),
        "finest_spacing_m": max(levels[shaped.level].step_x, levels[shaped.level].step_y),
        "levels": [_describe_entry(added) for added in shaped.added],
        "left_out_rms_m": rms,
        "left_out_most_m": max_change,
        "finished_early": shaped.finished_early,
        "warnings": warnings,
    }


def _describe_entry(added: Added) -> str:
    """Return a line such as "rivers at 16 m: 3.2 m rms, 41 m at most, 12 tiles, 3 of them new, 210 ms"."""
    tiles = f"{added.pieces} tile{'s' if added.pieces != 1 else ''}, {added.computed} of them new"
    tiles = f"the whole level, {'new' if added.computed else 'known before'}" if added.whole else tiles
    metres = f"{added.rms_m:.3g} m rms, {added.max_m:.3g} m at most"
    return f"{added.effect} at {added.spacing_m:.4g} m: {metres}, {tiles}, {added.ms:.0f} ms"
