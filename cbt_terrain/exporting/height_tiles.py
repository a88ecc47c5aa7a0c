# SPDX-License-Identifier: GPL-3.0-or-later
"""Height rasters and masks in tiles for game engines, and one JSON file with their scale and position.

Samples are points of the terrain's surface without displacement, also in finer tiles. Integer formats share one scale
and one offset: height = offset + scale * number. The largest difference to the surface is counted while the tiles are
written. `placing` is the terrain's position in its coordinate system. Layers are the rasters to write: heights first,
then one for each mask.
"""

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..attributes.attribute import AttributeRequest, SamplePoints
from ..attributes.catalogue import ATTRIBUTES
from ..attributes.evaluate import values_at
from ..attributes.exr import BLOCK
from ..attributes.finer_pyramid import min_level
from ..errors import TerrainError, unwritable
from ..field.heightfield import HeightField, with_detail
from ..field.store_folder import check_is_no_store
from ..height_operators.export import FORMATS, MASK_FORMAT, RasterShape
from ..height_operators.exported_rows import LINES
from ..importing.placing import Placing, placing_or_middle
from ..query.grid import check_grid_size, heights_on_grid
from ..run import launch, stopping
from ..run.owned_files import remove_file
from ..run.partial_files import sole_writer, written_beside
from .tile_grid import PATTERN, TileAxis, axes_of
from .tile_layers import HOLES, NO_FILE_NAME, TileLayer, mask_layers

VERSION = 1
# Of the tiles that are written side by side. Systems allow 256 open files or more.
MAX_OPEN, MAX_COLUMNS = 64, 65_536
# Unreal: height in cm = (number - 32768) / 128 * scale Z. So a step of 1 m a number is a scale Z of 100 * 128.
UNREAL_MIDDLE, UNREAL_STEP = 32_768, 12_800.0


@dataclass(frozen=True)
class HeightTiles:
    """Settings of tiles.

    Attributes:
        form: a suffix of FORMATS without its dot.
        size: samples of a tile's side, 0 for one tile.
        step: metres between samples, 0 for those of the raster.
        tiles: numbers of tiles that cover the terrain exactly, instead of a step; None keeps the step.
        overlap: samples that neighbours share.
        is_flipped: whether the first row of a tile, and the first row of tiles, are the southern ones.
        pattern: name of a tile without suffix, with {name}, {x} and {y}; `name` is the first of these.
    """

    form: str = "png"
    size: int = 0
    tiles: tuple[int, int] | None = None
    overlap: int = 1
    is_flipped: bool = False
    name: str = "terrain"
    pattern: str = PATTERN
    step: float = 0.0


class _Samples:
    """Heights, attributes and holes at the samples of a grid, in blocks.

    Attributes:
        field: the terrain without displacement.
        axes: the grid's samples from west to east, and from its first row to its last.
        x, y: coordinates of its columns and rows in the terrain, metres.
        layers: rasters to write, heights first; a later one without a source is the mask of holes.
        level: log2 of the raster's samples per sample of the grid, over which attributes are averaged; below 0 in
            finer tiles.
    """

    def __init__(self, field: HeightField, axes: tuple[TileAxis, TileAxis], layers: list[TileLayer], flipped: bool):
        """Locate the grid's columns and rows in the terrain. `flipped`: row 0 is the south."""
        self.field, self.layers = with_detail(field, detail=None), layers
        self.axes, self.threads, self._flipped = axes, launch.default_threads(), flipped
        west, south, _, north = field.lattice.rectangle()
        self.x = west + axes[0].places
        self.y = south + axes[1].places if flipped else north - axes[1].places
        # Attributes are averaged over a step of the grid: 2^level samples of the raster.
        steps = axes[0].spacing / field.lattice.step_x, axes[1].spacing / field.lattice.step_y
        self.level = max(float(min_level(field.raster)), math.log2(max(steps)))

    def block(self, rows: slice, columns: slice) -> tuple[np.ndarray, np.ndarray | None, list[np.ndarray]]:
        """Return the heights of a block, metres, with holes filled; which samples are on ground; the values of layers.

        All arrays are [rows, columns]: float64, bool (None without holes), and float64 for each layer after the first.
        """
        across = self.axes[0].grid.positions(columns.start, columns.stop)
        down = self.axes[1].grid.positions(rows.start, rows.stop, is_reversed=not self._flipped)
        heights, inside = heights_on_grid(self.field, across, down, self.threads)
        requests = list({layer.source.name: layer.source for layer in self.layers if layer.source}.values())
        attributes = {}
        if requests:
            x, y = np.meshgrid(self.x[columns], self.y[rows])
            positions = np.stack([x.ravel(), y.ravel(), heights.ravel()], -1).astype(np.float32)
            level = np.full(len(positions), self.level, np.float32)
            attributes = values_at(SamplePoints(self.field, positions, level, threads=self.threads), requests)
        values = []
        for layer in self.layers[1:]:
            if layer.source is None:  # the layer of holes
                values.append(1.0 - inside)
            else:
                channel_values = attributes[layer.source.name].reshape(*heights.shape, -1)[..., layer.channel]
                values.append(channel_values.astype(np.float64))
        return heights, inside if self.field.valid is not None else None, values

    def row_blocks(self, first: int, end: int) -> Iterator[slice]:
        """Yield the rows `first` to `end` (exclusive) in slices of at most LINES, of fewer for a wide tile.

        A request to stop raises between them.
        """
        # Whole blocks of lines of an EXR file.
        lines = min(max(LINES * MAX_COLUMNS // self.axes[0].size // BLOCK, 1) * BLOCK, LINES)
        for row in range(first, end, lines):
            stopping.check()
            yield slice(row, min(row + lines, end))

    def groups(self) -> Iterator[range]:
        """Yield the columns of the tiles of a row in groups whose files and samples fit into memory together."""
        across = self.axes[0]
        count = max(1, min(MAX_OPEN // len(self.layers), MAX_COLUMNS // across.size))
        for first in range(0, across.tiles, count):
            yield range(first, min(first + count, across.tiles))

    def columns_of(self, tiles: range) -> slice:
        """Return the columns of some tiles that are side by side."""
        across = self.axes[0]
        return slice(across.first(tiles.start), across.first(tiles.stop - 1) + across.size)


def export_height_tiles(
    field: HeightField,
    out: Path,
    settings: HeightTiles,
    masks: Sequence[AttributeRequest] = (),
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> dict:
    """Write the tiles of a store's field and NAME.json into the folder `out`; return the content of that file.

    settings: format, size, number and names of the tiles. masks: attributes that become 8-bit PNG files with the same
    tiles. Raises TerrainError.
    """
    suffix = f".{settings.form.lower()}"
    if suffix not in FORMATS:
        raise TerrainError(
            f"{settings.form!r} is no format of height tiles", expected=", ".join(n[1:] for n in FORMATS)
        )
    if not os.path.isdir(out):
        raise TerrainError(f"There is no folder {out} to write into", fix="create it or choose another")
    check_is_no_store(out)
    axes = axes_of(field.lattice, settings.size, settings.tiles, settings.overlap, settings.step)
    layers = [TileLayer("", FORMATS[suffix], suffix), *mask_layers(masks)]
    if field.valid is not None:
        layers.append(TileLayer(HOLES, MASK_FORMAT, ".png", low=0.0, high=1.0))
    check_grid_size((axes[0].grid, axes[1].grid), sum(int(layer.form.dtype.itemsize) for layer in layers))
    names = _names(settings, axes, layers)
    field.raster.check_samples()  # all are finite
    samples = _Samples(field, axes, layers, settings.is_flipped)
    placing = placing_or_middle(field)
    json_file = out / f"{settings.name}.json"
    try:
        with sole_writer(json_file):
            # Integers need the smallest and largest value of a layer, which only a first pass over all samples finds.
            if any(layer.form.is_integer and not layer.has_range for layer in layers):
                _measure(samples, layers, lambda done: on_progress(0.4 * done))
            remove_file(json_file)  # of an earlier export, whose tiles are about to be replaced
            for row in range(axes[1].tiles):
                for tiles in samples.groups():  # columns of tiles that are open side by side
                    _write_tiles(samples, out, names, tiles, row, placing)
                on_progress(0.4 + 0.6 * (row + 1) / axes[1].tiles)
            index = _tiles_json(samples, names, placing, settings)
            with written_beside(json_file) as partial:
                partial.write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")
    except OSError as reason:
        raise unwritable(f"The tiles in {out}", reason) from reason
    return index


def _names(settings: HeightTiles, axes: tuple[TileAxis, TileAxis], layers: list[TileLayer]) -> dict[tuple, str]:
    """Return the names of all files by layer's index, x and y of the tile.

    settings: has the pattern of names; {name} in it stands for the export's name and the layer's. axes: have the
    numbers of tiles along x and y. Raises TerrainError for a pattern that gives no such names.
    """
    names = {}
    # A field of 1000 or more characters is longer than a file name, and may fill the memory.
    pattern = "" if re.search(r"{[^}]*\d{4}", settings.pattern) else settings.pattern
    for k, layer in enumerate(layers):
        name = f"{settings.name}_{layer.name}" if layer.name else settings.name
        for y in range(axes[1].tiles):
            for x in range(axes[0].tiles):
                try:
                    names[k, x, y] = pattern.format(name=name, x=x, y=y) + layer.suffix
                except (LookupError, ValueError, AttributeError, TypeError):
                    names[k, x, y] = ""
    used = [*names.values(), f"{settings.name}.json"]
    bad = [name for name in used if not name.rpartition(".")[0] or set(name) & NO_FILE_NAME]
    if bad or len({name.casefold() for name in used}) < len(used):
        what = f"{max(bad)!r} is no file name" if any(bad) else "gives one name to several files, or none"
        raise TerrainError(
            f"The pattern {settings.pattern!r} of tiles: {what}", expected=f"{{name}}, {{x}} and {{y}}, as {PATTERN}"
        )
    return names


def _measure(samples: _Samples, layers: list[TileLayer], on_progress: Callable[[float], None]) -> None:
    """Widen the ranges of layers without a given range to all samples on the terrain, before values are coded."""
    total = samples.axes[1].inside
    lack_range = [not layer.has_range for layer in layers]  # before the first block gives them one
    for rows in samples.row_blocks(0, total):
        for tiles in samples.groups():
            heights, _, values = samples.block(rows, samples.columns_of(tiles))
            for layer, array, lacks_range in zip(layers, [heights, *values], lack_range, strict=True):
                if lacks_range:
                    layer.widen(array)
        on_progress(rows.stop / total)


def _write_tiles(samples: _Samples, out: Path, names: dict[tuple, str], group: range, y: int, placing: Placing) -> None:
    """Write some tiles of row `y`, side by side, of all layers, in blocks of rows. Raises OSError.

    out: folder. names: file names by layer, column and row of the tile. group: columns of the tiles, whose files appear
    when all are complete. placing: conversion to the coordinate system of the files.
    """
    (across, down), columns = samples.axes, samples.columns_of(group)
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(2, "adaptive_terrain_export"))
        tiles: list[tuple] = []  # (layer's index, its columns in a block, open file, its path, its shape)
        for k, layer in enumerate(samples.layers):
            for x in group:
                partial = stack.enter_context(written_beside(out / names[k, x, y]))
                transform, crs = _transform(samples, placing, across.first(x), down.first(y))
                missing = samples.field.valid is not None and layer.form.keeps_missing
                shape = RasterShape(across.size, down.size, transform, crs, missing)
                file = layer.form.open(partial, shape, layer.form.dtype, pool)
                stack.callback(file.abandon)
                first = across.first(x) - columns.start
                tiles.append((k, slice(first, first + across.size), file, partial, shape))
        for rows in samples.row_blocks(down.first(y), down.first(y) + down.size):
            heights, inside, values = samples.block(rows, columns)
            if not samples.layers[0].form.is_integer:  # no range was needed to encode: find that for the JSON file
                samples.layers[0].widen(heights)
            coded = [layer.encode(array) for layer, array in zip(samples.layers, [heights, *values], strict=True)]
            if inside is not None and samples.layers[0].form.keeps_missing:
                coded[0][~inside] = np.nan
            for k, tile_columns, file, _, _ in tiles:
                file.add(coded[k][:, tile_columns])
        for _, _, file, _, _ in tiles:
            file.close()
        finish = samples.layers[0].form.finish  # turns complete raw files into TIFF; None for other formats
        if finish is not None:
            written = [(partial, shape) for k, _, _, partial, shape in tiles if k == 0]
            finish(*zip(*written, strict=True))  # paths, shapes


def _transform(samples: _Samples, placing: Placing, column: int, row: int) -> tuple[tuple[float, ...], str]:
    """Return the affine transform from pixels, whose centres are samples, to coordinates, and the name of their system.

    column, row: sample of the tile's first pixel.
    """
    step_x, step_y = _sample_steps(samples, placing)
    x, y = _origin(samples, placing)
    return (step_x, 0.0, x + (column - 0.5) * step_x, 0.0, step_y, y + (row - 0.5) * step_y), placing.crs


def _sample_steps(samples: _Samples, placing: Placing) -> tuple[float, float]:
    """Return the step from a column and from a row to the next one, in the coordinate system's unit."""
    sign = 1.0 if samples.y[-1] > samples.y[0] else -1.0
    return samples.axes[0].spacing / placing.metres_x, sign * samples.axes[1].spacing / placing.metres_y


def _origin(samples: _Samples, placing: Placing) -> list[float]:
    """Return the coordinates, x and y, of the first sample."""
    return [float(c) for c in placing.from_terrain(np.array([samples.x[0], samples.y[0]]))]


def _tiles_json(samples: _Samples, names: dict[tuple, str], placing: Placing, settings: HeightTiles) -> dict:
    """Return the content of the JSON file beside the tiles: sizes, coding of values and position on the map.

    names: file names by layer, column and row of the tile. "step" and "origin" are in units of the coordinate system.
    Samples beyond the terrain's border fill up the last tiles; "num_samples_on_terrain" leaves them out.
    """
    axes, heights = samples.axes, samples.layers[0]
    index = {
        "version": VERSION,
        "generator": "Adaptive Terrain",
        "tile_size": [axis.size for axis in axes],
        "overlap": settings.overlap,
        "num_tiles": [axis.tiles for axis in axes],
        "num_samples": [axis.total for axis in axes],
        "num_samples_on_terrain": [axis.inside for axis in axes],
        "first_row": "south" if settings.is_flipped else "north",
        "spacing_m": [axis.spacing for axis in axes],
        "origin": _origin(samples, placing),
        "step": list(_sample_steps(samples, placing)),
        "crs": placing.crs,
        "holes": "none" if samples.field.valid is None else "NaN" if heights.form.keeps_missing else "filled",
        "heights": heights.to_json() | {"unit": "m"},
        "masks": [
            layer.to_json()
            | {"name": layer.name, "attribute": layer.source.name if layer.source else HOLES}
            | {"unit": ATTRIBUTES[layer.source.name].unit if layer.source else "1"}
            for layer in samples.layers[1:]
        ],
    }
    index["tiles"] = [
        {"x": x, "y": y, "column": axes[0].first(x), "row": axes[1].first(y), "file": names[0, x, y]}
        | {"masks": {layer.name: names[k, x, y] for k, layer in enumerate(samples.layers) if k}}
        for y in range(axes[1].tiles)
        for x in range(axes[0].tiles)
    ]
    if heights.form.is_integer and not settings.is_flipped:
        _add_unreal(index, samples)
    return index


def _add_unreal(index: dict, samples: _Samples) -> None:
    """Add Unreal's numbers to the content of the JSON file: those of all tiles together, and the place of each tile.

    Unreal Engine measures in centimetres, and its y axis points south. A number stands for the height (number -
    UNREAL_MIDDLE) / 128 * scale_z above location_z. A landscape is located by its first sample. Locations count from
    the anchor, the origin of the terrain's space.
    """
    scale, heights = [100.0 * axis.spacing for axis in samples.axes], samples.layers[0]
    first = 100.0 * float(samples.x[0]), -100.0 * float(samples.y[0])
    index["unreal"] = {
        "scale_x": scale[0],
        "scale_y": scale[1],
        "scale_z": UNREAL_STEP * heights.scale,
        "location_x": first[0],
        "location_y": first[1],
        "location_z": 100.0 * (heights.offset + UNREAL_MIDDLE * heights.scale),
    }
    for tile in index["tiles"]:
        tile["unreal_location"] = [first[0] + scale[0] * tile["column"], first[1] + scale[1] * tile["row"]]
