# SPDX-License-Identifier: GPL-3.0-or-later
"""Which tiles and squares of a quick import views need: those where the finest errors are too many pixels.

A quick import has few samples, and tiles of it are loaded in more detail (refining.py), squares with the finest files
(finer_squares.py). A land (SeenLand) is a placement of the terrain with the views that see it and the error that they
allow. Errors are those that the store has for the finest vertices, in the centres of 2 x 2 cells of the raster.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..attributes import sizing
from ..attributes.tiling import Tiling
from ..field.cell_ranges import cell_ranges
from ..field.domain import box_of
from ..field.heightfield import HeightField
from ..field.lattice import rows_of
from ..field.store import open_store, read_json
from ..tiling.tile_grid import TileGrid
from ..view.linear import lengths, product
from ..view.local_view import eye_of
from ..view.view import ORTHOGRAPHIC, View
from . import refining
from .finer_squares import finer_squares, square_bits
from .refining import are_all_samples, first_picture, is_large, loaded_tiles, picture_side
from .thinning import loaded_m

MAX_TILES = 64  # that are loaded at once: 0.3 s each, and as long for its neighbours
MAX_SQUARES = 16  # with the finest files that are loaded at once for a viewport: 2 s each
PARTS = 8  # along a side of a tile, of which each is looked at
NEAR_BITS = 3  # log2 of the samples along a side of a cell that is looked at near an eye


class SeenLand(NamedTuple):
    """Views of a terrain, and what else determines the detail that they need.

    Attributes:
        placement: float64 [4, 4], maps the terrain's space to the world.
        error_px: error in pixels beyond which more detail is needed.
        vertical_scale: factor on heights in the terrain's space.
        vertical_offset: metres that are added to these.
    """

    views: Sequence[View]
    placement: np.ndarray
    error_px: float = 1.0
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0


def missing_tiles(store: Path, seen: SeenLand) -> tuple[int, ...]:
    """Return the numbers of the tiles that views need and an incomplete store lacks, ascending. Raises TerrainError.

    A tile is needed where the finest stored errors are larger than the allowed pixels. At most the MAX_TILES most
    needed ones are returned. seen: the land with its views.
    """
    return seen_tiles(open_store(first_picture(store)), seen, loaded_tiles(read_json(store)["provenance"]))


def all_missing_tiles(store: Path, lands: Iterable[SeenLand]) -> tuple[int, ...]:
    """Return all tiles that any of several lands needs and an incomplete store lacks, in ascending order.

    `missing_tiles` finds a limited number of them in a call, for one land. Raises TerrainError.
    """
    return tuple(sorted(needed_tiles(store, lands) - loaded_tiles(read_json(store)["provenance"])))


def needed_tiles(store: Path, lands: Iterable[SeenLand]) -> frozenset[int]:
    """Return all tiles with a larger error in view than one of several lands allows, loaded or not.

    There are none for a small raster, which is soon imported completely (`is_large`). Raises TerrainError.
    """
    field = open_store(first_picture(store))
    if not is_large(field):
        return frozenset()
    wanted = np.flatnonzero(_ratios_to_allowed(field, picture_side(field), list(lands)) > 1.0)
    return frozenset(map(int, wanted))


def neediest_tile(store: Path, lands: Sequence[SeenLand], tiles: Sequence[int]) -> int:
    """Return the one of some tiles whose error in view is the largest multiple of what one of several lands allows.

    Raises TerrainError.
    """
    field = open_store(first_picture(store))
    ratios = _ratios_to_allowed(field, picture_side(field), lands)
    return max(tiles, key=lambda tile: ratios[tile])


def are_loaded_enough(store: Path, lands: Sequence[SeenLand]) -> bool:
    """Return whether the loaded tiles of a store have the detail that several lands need there.

    They always have it if they have all samples of the source, or of the coarser files of a mosaic, whose finer files
    are loaded by squares instead. `is_fine_enough` judges all tiles, loaded or not. Raises TerrainError.
    """
    field = open_store(store)
    squares = finer_squares(field)
    # `is_coarse`: the raster has the step of the coarser files. The first picture, the store of the quick import, tells
    # from its own step whether tiles, which are a fixed factor finer, have all samples.
    if (squares is not None and squares.is_coarse) or are_all_samples(open_store(first_picture(store))):
        return True
    ratios, loaded = _ratios_to_allowed(field, side=1 << refining.BITS, lands=lands), loaded_tiles(field.provenance)
    return all(ratio <= 1.0 for tile, ratio in enumerate(ratios) if tile in loaded)


def seen_tiles(field: HeightField, seen: SeenLand, loaded: frozenset[int] = frozenset()) -> tuple[int, ...]:
    """Return the tiles that views of a first picture need, without loaded ones; the MAX_TILES most needed ones at most.

    They are in ascending order. A tile is needed where the finest stored errors are larger than `error_px` pixels:
    the samples that it lacks are about as far from the surface. There are none for a small raster (`is_large`).
    """
    if not is_large(field):
        return ()
    # Of the one land: the largest error in view of each tile, by its number.
    [errors_px] = (errors.ravel() for errors in errors_in_view(field, picture_side(field), [seen]))
    errors_px[[tile for tile in loaded if tile < len(errors_px)]] = 0.0
    order = np.argsort(-errors_px, kind="stable")[:MAX_TILES]
    return tuple(sorted(int(tile) for tile in order if errors_px[tile] > seen.error_px))


def is_fine_enough(store: Path, lands: Sequence[SeenLand]) -> bool:
    """Return whether several lands need no more detail than an incomplete store has.

    They need more where the finest stored errors are more pixels than they allow, except in loaded tiles that have all
    samples of the source. False for a first picture of a raster so small that it is soon imported completely
    (`is_large`). Raises TerrainError.
    """
    field = open_store(store)
    if not loaded_tiles(field.provenance):  # it is a first picture
        return is_large(field) and not all_missing_tiles(store, lands)
    squares = finer_squares(field)
    if squares is not None and squares.is_coarse:  # tiles have the coarser files' step; only squares have more detail
        return not (all_missing_tiles(store, lands) or missing_squares(store, lands))
    if are_all_samples(open_store(first_picture(store))):  # loaded tiles lack nothing, only others may
        return not all_missing_tiles(store, lands)
    # Loaded tiles have a coarser step than the source: they are judged like the others.
    return bool((_ratios_to_allowed(field, side=1 << refining.BITS, lands=lands) <= 1.0).all())


def missing_squares(store: Path, lands: Sequence[SeenLand], max_count: int | None = None) -> tuple[int, ...]:
    """Return the squares with finer files that views need and a store with loaded tiles lacks, in ascending order.

    A square is needed where the finest stored errors of the raster are larger than a land allows. max_count: return
    the most needed ones at most; None for all. Raises TerrainError.
    """
    field = open_store(store)
    squares = finer_squares(field)
    if squares is None:
        return ()
    wanted, side = sorted(squares.there - squares.loaded), 1 << square_bits(squares.bits)
    ratios = _ratios_to_allowed(field, side, lands, part=side)[wanted]  # the largest error of each over the allowed one
    order = np.argsort(-ratios, kind="stable")[:max_count]
    return tuple(sorted(wanted[index] for index in order if ratios[index] > 1.0))


def _ratios_to_allowed(field: HeightField, side: int, lands: Sequence[SeenLand], part: int | None = None) -> np.ndarray:
    """Return for each tile or square the largest ratio of its error in view to the error that a land allows.

    The result is float64 [tiles]; one above 1 needs more detail. side: the field's cells along a tile or square. part:
    cells along its parts, whose distances from a view are measured; None for PARTS parts along a side. Both are powers
    of two.
    """
    ratios = np.zeros(len(TileGrid(field.lattice, side.bit_length() - 1)))
    for errors_px, seen in zip(errors_in_view(field, side, lands, part), lands, strict=True):
        np.maximum(ratios, errors_px.ravel() / seen.error_px, out=ratios)
    return ratios


def errors_in_view(
    field: HeightField, side: int, lands: Iterable[SeenLand], part: int | None = None
) -> Iterator[np.ndarray]:
    """Yield for each land the largest errors of the finest vertices, pixels, in squares of side x side cells.

    Arrays have [rows, columns]. Parts of a square, of `part` cells a side, are looked at, each by its own distance;
    None: PARTS parts along a side. Those out of every view have 0. Near an eye, cells of 2^NEAR_BITS samples are
    looked at, since a part's box also encloses air. Raises TerrainError for a vertical scale or offset that no mesh can
    have, such as NaN from a driver.
    """
    lattice, part = field.lattice, part or max(side // PARTS, 2)
    west, south, _, _ = lattice.rectangle()
    columns, rows = (-(-cells // part) for cells in (lattice.cells_x, lattice.cells_y))
    tiling = Tiling(columns, rows, west, south, part * lattice.step_x, part * lattice.step_y, margin=0.0)
    codes = _centre_codes(field)  # a larger code is a larger error, in metres by the table
    errors = field.table[0][_largest(codes, side=part // 2)].ravel()  # a code has 2 x 2 cells
    for seen in lands:
        box_of(field, seen.vertical_scale, seen.vertical_offset)  # raises for numbers that cannot be used
        boxes = sizing.boxes(tiling, field, seen.vertical_scale, seen.vertical_offset)
        errors_px = _errors_px(field, boxes, errors, seen)
        # Parts near an eye that exceed the allowed error are looked at again, by cells, if the raster has such cells.
        near = np.flatnonzero((errors_px > seen.error_px) & _is_near(boxes, seen))
        if len(near) and part >> NEAR_BITS and lattice.levels >= NEAR_BITS:
            errors_px[near] = _errors_px_by_cells(field, codes, near // columns, near % columns, part, seen)
        yield _largest(errors_px.reshape(rows, columns), side // part)


def _errors_px(field: HeightField, boxes: np.ndarray, errors: np.ndarray, seen: SeenLand) -> np.ndarray:
    """Return errors, metres, at boxes as pixels of a land's views, float64 [boxes]; 0 out of every view.

    A distance is at least the step of the source's samples: no import has more detail. boxes: float64 [boxes, 2, 3],
    lowest and highest corners, metres.
    """
    steps = loaded_m(field.provenance)
    # The smallest distance from an eye that counts. steps[1]: metres between all samples of the source.
    nearest = steps[1] if steps is not None else min(field.lattice.step_x, field.lattice.step_y)
    metres_per_px = sizing.footprints(boxes, seen.views, seen.placement, only_seen=True, nearest=nearest)
    stretch_x, stretch_y, stretch_z = lengths(seen.placement[:3, :3])
    with np.errstate(divide="ignore", invalid="ignore"):
        # Footprints are in horizontal metres of the terrain's space, and errors are vertical.
        factor = abs(seen.vertical_scale) * stretch_z / max(stretch_x, stretch_y)
        return np.nan_to_num(errors * factor / metres_per_px, posinf=np.inf)


def _is_near(boxes: np.ndarray, seen: SeenLand) -> np.ndarray:
    """Return which boxes are nearer to the eye of a land's view than they are long: bool [boxes]."""
    near, sides = np.zeros(len(boxes), bool), boxes[:, 1] - boxes[:, 0]
    diagonals2 = (sides * sides).sum(axis=1)
    for view in (view for view in seen.views if view.kind != ORTHOGRAPHIC):
        eye = eye_of(product(view.world_to_camera, seen.placement))
        away = np.maximum(np.maximum(boxes[:, 0] - eye, eye - boxes[:, 1]), 0.0)  # along each axis, 0 inside
        near |= (away * away).sum(axis=1) < diagonals2
    return near


def _errors_px_by_cells(
    field: HeightField, codes: np.ndarray, rows: np.ndarray, columns: np.ndarray, part: int, seen: SeenLand
) -> np.ndarray:
    """Return the largest error, pixels, in each of some parts: float64 [parts].

    Each part is divided into cells of 2^NEAR_BITS samples a side, and each of these counts at its own distance. codes:
    of the errors in the centres of 2 x 2 raster cells, [rows, columns]. rows, columns: of the parts, int [parts]. part:
    samples along a side of one.
    """
    lattice, cells_a_side = field.lattice, part >> NEAR_BITS
    # Columns and rows of each part's cells; the last ones of the raster stand for those beyond.
    cell_x, cell_y = (
        np.minimum(places[:, None] * cells_a_side + np.arange(cells_a_side), -(-cells >> NEAR_BITS) - 1)
        for places, cells in ((columns, lattice.cells_x), (rows, lattice.cells_y))
    )
    # From here on arrays are [parts, rows of cells, columns of cells, ...]: lowest and highest height of each cell.
    heights = cell_ranges(field, NEAR_BITS, cell_x[:, None, :], cell_y[:, :, None])
    boxes = np.empty((*heights.shape, 3))  # lowest and highest corner of each cell: x, y, z in metres
    cell_side, (west, south, _, _) = 1 << NEAR_BITS, lattice.rectangle()
    for end in (0, 1):
        boxes[..., end, 0] = west + (cell_x + end)[:, None, :] * (cell_side * lattice.step_x)
        boxes[..., end, 1] = south + (cell_y + end)[:, :, None] * (cell_side * lattice.step_y)
    boxes[..., 2] = np.sort(heights * seen.vertical_scale + seen.vertical_offset, axis=-1)
    # The error of a cell is the largest of its codes; the first table gives the metres of each code.
    code_in_cell = np.arange(cell_side // 2)  # one code for 2 samples
    code_row, code_column = (
        np.minimum(places[:, :, None] * len(code_in_cell) + code_in_cell, size - 1)
        for places, size in zip((cell_y, cell_x), codes.shape, strict=True)
    )
    errors = field.table[0][codes[code_row[:, :, None, :, None], code_column[:, None, :, None, :]].max(axis=(-2, -1))]
    errors_px = _errors_px(field, boxes.reshape(-1, 2, 3), errors.ravel(), seen)
    return errors_px.reshape(len(rows), -1).max(axis=1)


def _largest(values: np.ndarray, side: int) -> np.ndarray:
    """Return the largest of values [rows, columns] in each square of side x side of them, 1 x 1 for side 0."""
    for axis in (0, 1):
        values = np.maximum.reduceat(values, np.arange(0, values.shape[axis], max(side, 1)), axis=axis)
    return values


def _centre_codes(field: HeightField) -> np.ndarray:
    """Return the codes of the errors of the finest vertices, in the centres of 2 x 2 cells: [rows, columns]."""
    # base: where each group of depths begins, from fine to coarse. pages: pages (squares of entries) in a row of it.
    base, pages = field.lattice.layout()
    codes = rows_of(field.error[base[0] : base[1]], int(pages[0]))
    return codes[1 : field.lattice.height : 2, 1 : field.lattice.width : 2]
