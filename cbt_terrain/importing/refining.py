# SPDX-License-Identifier: GPL-3.0-or-later
"""Second step of a quick import: the tiles that views need are loaded in more detail.

Each cell of the first picture becomes FACTOR x FACTOR cells, or those of the raster if they are larger. The chosen
tiles get true samples of the source, as the first picture has; all others keep its surface (tiling/coarse_land.py). The
store keeps the first picture inside, so that further tiles can be loaded; tiles that it has are not made again.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..attributes.tiling import Tiling
from ..errors import TerrainError
from ..field.cell_ranges import cell_ranges
from ..field.georeference import Georeference
from ..field.heightfield import HeightField
from ..field.store import changed_ns, open_store, read_json
from ..field.store_folder import FIRST, named_folder
from ..rasters.raster import ImportSettings, Raster
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_grid import TileGrid, rows_of
from ..view.linear import product
from ..view.local_view import eye_of
from ..view.view import ORTHOGRAPHIC, View
from .finer_squares import finer_source, finer_squares, square_bits
from .thinning import REFINED, loaded_m, positions, refined_m, stride_of

FACTOR = 8
BITS = 10  # of the tiles
MAX_TILES = 64  # that are loaded at once: 0.3 s each, and as long for its neighbours
SQUARES = 8  # along a side of a tile, of which each is looked at
NEAR_BITS = 3  # log2 of the samples along a side of a cell that is looked at near an eye
MAX_SQUARES = 16  # with the finest files that are loaded at once for a viewport: 2 s each
MAX_READ = 1 << 22  # samples of the source that are read at once
FEWEST = 1 << 29  # samples of a raster whose complete import takes much longer than this step


def first_picture(store: Path) -> Path:
    """Return the folder of the first picture, the store of a quick import with few samples.

    It is inside a store with loaded tiles, else it is the store itself.
    """
    folder = named_folder(store)
    inner = None if folder is None else folder / FIRST
    return inner if inner is not None and changed_ns(inner) else store


def coarse_land(settings: ImportSettings, picture: Path) -> CoarseLand:
    """Return the heights of a quick import in the folder `picture`, around which the settings' tiles are loaded.

    Raises TerrainError if there is none.
    """
    field = open_store(picture)
    full = _full_raster(field)
    if full is None:
        raise TerrainError(f"The store {picture} has no first picture", fix="import quickly first")
    return CoarseLand(field, read_json(picture)["digest"], _bits(field, full), frozenset(settings.loaded_tiles))


def refined(raster: Raster, settings: ImportSettings, land: CoarseLand) -> Raster:
    """Return a raster with the samples of the finer grid of a quick import, whose tiles are loaded one by one.

    Its samples are those of `raster` that are nearest to the grid's positions. It reads `raster` on demand, and closes
    it. land: the quick import.
    """
    stride = stride_of(raster.width, raster.height, settings.quick)
    counts = [(len(positions(count, stride)) - 1) << land.bits for count in (raster.width, raster.height)]
    columns, rows = (
        (2 * np.arange(cells + 1) * (count - 1) + cells) // (2 * cells)  # the nearest sample: a rounded quotient
        for cells, count in zip(counts, (raster.width, raster.height), strict=True)
    )

    def window(first: int, count: int, column: int, width: int) -> np.ndarray:
        """Return a window of the finer grid, NaN where samples are missing."""
        wanted_rows, wanted_columns = rows[first : first + count], columns[column : column + width]
        if raster.pick is not None:
            values = raster.pick(wanted_rows, wanted_columns)
            fine.shifted = raster.shifted  # the error of datums, which `pick` has set
            return values
        left, wide = int(wanted_columns[0]), int(wanted_columns[-1] - wanted_columns[0]) + 1
        if raster.window is None:
            left, wide = 0, raster.width
        bands = (wanted_rows - wanted_rows[0]) // max(1, MAX_READ // wide)  # rows that are read together
        parts = []
        for band in np.split(wanted_rows, np.flatnonzero(np.diff(bands)) + 1):
            top, high = int(band[0]), int(band[-1] - band[0]) + 1
            read = raster.read(top, high) if raster.window is None else raster.window(top, high, left, wide)
            parts.append(read[np.ix_(band - top, wanted_columns - left)])
        return np.concatenate(parts)

    place = raster.georeference or Georeference(first_row_south=settings.first_row_south)
    along = (raster.width - 1) / counts[0], (raster.height - 1) / counts[1]
    fine = replace(
        raster,
        width=counts[0] + 1,
        height=counts[1] + 1,
        read=lambda first, count: window(first, count, 0, counts[0] + 1),
        window=window,
        pick=None,
        original=None,
        inputs=None,
        georeference=place.with_steps_times(*(along[::-1] if place.transposed else along)),
        full_size=(raster.width, raster.height),
        squares=finer_source(raster, counts, settings.loaded_finer),
    )
    if fine.squares is not None and fine.squares.squares:
        fine.finer = fine.squares
    return fine


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

    A tile is needed where the finest stored errors are larger than the allowed pixels.
    """
    return seen_tiles(open_store(first_picture(store)), seen, loaded_tiles(read_json(store)["provenance"]))


def all_missing_tiles(store: Path, lands: Iterable[SeenLand]) -> tuple[int, ...]:
    """Return all tiles that any of several lands needs and an incomplete store lacks, in ascending order.

    Repeated calls of `missing_tiles` for each land find the same. Raises TerrainError.
    """
    return tuple(sorted(needed_tiles(store, lands) - loaded_tiles(read_json(store)["provenance"])))


def needed_tiles(store: Path, lands: Iterable[SeenLand]) -> frozenset[int]:
    """Return all tiles that any of several lands needs, loaded or not. Raises TerrainError."""
    field = open_store(first_picture(store))
    if not is_large(field):
        return frozenset()
    wanted = np.flatnonzero(_ratios_in_view(field, _picture_side(field), list(lands)) > 1.0)
    return frozenset(map(int, wanted))


def neediest_tile(store: Path, lands: Sequence[SeenLand], tiles: Sequence[int]) -> int:
    """Return that of some tiles whose errors exceed the allowed ones of several lands most. Raises TerrainError."""
    field = open_store(first_picture(store))
    ratios = _ratios_in_view(field, _picture_side(field), lands)
    return max(tiles, key=lambda tile: ratios[tile])


def are_loaded_enough(store: Path, lands: Sequence[SeenLand]) -> bool:
    """Return whether the loaded tiles have the detail that several lands need there, or squares can add what they lack.

    Tiles with all samples of the source have it. It is judged as in `is_fine_enough`, which needs all tiles, too.
    Raises TerrainError.
    """
    field = open_store(store)
    squares = finer_squares(field)
    if (squares is not None and squares.is_coarse) or are_all_samples(open_store(first_picture(store))):
        return True
    ratios, loaded = _ratios_in_view(field, 1 << BITS, lands), loaded_tiles(field.provenance)
    return all(ratio <= 1.0 for tile, ratio in enumerate(ratios) if tile in loaded)


def seen_tiles(field: HeightField, seen: SeenLand, loaded: frozenset[int] = frozenset()) -> tuple[int, ...]:
    """Return the tiles that views of a first picture need, without loaded ones; the MAX_TILES most needed ones at most.

    They are in ascending order. A tile is needed where the finest stored errors are larger than `error_px` pixels,
    because samples in between are about as far from the surface. There are none unless the field `is_large`.
    """
    if not is_large(field):
        return ()
    [errors_px] = (errors.ravel() for errors in errors_in_view(field, _picture_side(field), [seen]))
    errors_px[[tile for tile in loaded if tile < len(errors_px)]] = 0.0
    order = np.argsort(-errors_px, kind="stable")[:MAX_TILES]
    return tuple(sorted(int(tile) for tile in order if errors_px[tile] > seen.error_px))


def is_large(field: HeightField) -> bool:
    """Return whether a field is of a quick import of so large a raster that its tiles in view are loaded first.

    Such a raster has FEWEST samples or more; a smaller one is soon imported completely.
    """
    full = _full_raster(field)
    return full is not None and full[0] * full[1] >= FEWEST


def is_fine_enough(store: Path, lands: Sequence[SeenLand]) -> bool:
    """Return whether several lands need no more detail than an incomplete store has, judged as in `seen_tiles`.

    Loaded tiles with all samples of the source lack none. False for a first picture that is not `is_large`. Raises
    TerrainError.
    """
    field = open_store(store)
    if not loaded_tiles(field.provenance):
        return is_large(field) and not all_missing_tiles(store, lands)
    squares = finer_squares(field)
    if squares is not None and squares.is_coarse:
        return not (all_missing_tiles(store, lands) or missing_squares(store, lands))
    if are_all_samples(open_store(first_picture(store))):
        return not all_missing_tiles(store, lands)
    return bool((_ratios_in_view(field, 1 << BITS, lands) <= 1.0).all())


def missing_squares(store: Path, lands: Sequence[SeenLand], max_count: int | None = None) -> tuple[int, ...]:
    """Return the squares with finer files that views need and a store with loaded tiles lacks, in ascending order.

    A square is needed where the finest stored errors of the raster are larger than the error of a land. max_count:
    return the most needed ones at most; None for all. Raises TerrainError.
    """
    field = open_store(store)
    squares = finer_squares(field)
    if squares is None:
        return ()
    wanted, side = sorted(squares.there - squares.loaded), 1 << square_bits(squares.bits)
    ratios = _ratios_in_view(field, side, lands, side)[wanted]
    order = np.argsort(-ratios, kind="stable")[:max_count]
    return tuple(sorted(wanted[index] for index in order if ratios[index] > 1.0))


def loaded_tiles(provenance: dict) -> frozenset[int]:
    """Return the numbers of the loaded tiles of a store; none for a complete store or a first picture."""
    numbers = provenance.get("settings", {}).get("loaded_tiles") if REFINED in provenance else None
    return frozenset(number for number in numbers or () if type(number) is int and number >= 0)


def with_loaded(
    settings: ImportSettings, store: Path, tiles: Iterable[int] = (), squares: Iterable[int] = ()
) -> ImportSettings:
    """Return settings that load further tiles and squares beside those that a store has. Raises TerrainError."""
    field = open_store(store)
    before = finer_squares(field)
    numbers = loaded_tiles(field.provenance).union(tiles), (before.loaded if before else frozenset()).union(squares)
    return replace(settings, loaded_tiles=tuple(sorted(numbers[0])), loaded_finer=tuple(sorted(numbers[1])))


def loaded_at(field: HeightField, x: float, y: float) -> float | None:
    """Return the step to which a store is loaded at a point, metres; None for a complete store.

    x, y: metres from the raster's middle; beyond its border the nearest tile counts.
    """
    steps, tiles, squares = loaded_m(field.provenance), refined_m(field.provenance), finer_squares(field)
    if steps is None or tiles is None:
        return steps and steps[0]
    (west, south, _, _), lattice = field.lattice.rectangle(), field.lattice
    grid = TileGrid(lattice, BITS)
    positions = ((x - west) / lattice.step_x, lattice.cells_x), ((y - south) / lattice.step_y, lattice.cells_y)
    cell_x, cell_y = (int(min(max(cell, 0), cells - 1)) for cell, cells in positions)
    if squares is not None:
        shift = square_bits(squares.bits)
        if (cell_y >> shift) * TileGrid(lattice, shift).columns + (cell_x >> shift) in squares.loaded:
            return squares.finest_m
    column, row = cell_x >> BITS, cell_y >> BITS
    return tiles[0] if row * grid.columns + column in loaded_tiles(field.provenance) else steps[0]


def _ratios_in_view(field: HeightField, side: int, lands: Sequence[SeenLand], part: int | None = None) -> np.ndarray:
    """Return the largest error in each square by that which a land allows, of several lands: float64 [squares].

    A square needs more detail above 1. side, part: as of `errors_in_view`, powers of two.
    """
    ratios = np.zeros(len(TileGrid(field.lattice, side.bit_length() - 1)))
    for needs, seen in zip(errors_in_view(field, side, lands, part), lands, strict=True):
        np.maximum(ratios, needs.ravel() / seen.error_px, out=ratios)
    return ratios


def errors_in_view(
    field: HeightField, side: int, lands: Iterable[SeenLand], part: int | None = None
) -> Iterator[np.ndarray]:
    """Yield for each land the largest errors of the finest vertices, pixels, in squares of side x side cells.

    Arrays have [rows, columns]. Parts of a square, of `part` cells a side, are looked at, each by its own distance;
    None: SQUARES parts along a side. Those out of every view have 0. Near an eye, cells of 2^NEAR_BITS samples are
    looked at, since a part's box also encloses air.
    """
    from ..attributes import sizing  # takes a quarter of a start of the processes that import

    lattice, part = field.lattice, part or max(side // SQUARES, 2)
    west, south, _, _ = lattice.rectangle()
    columns, rows = (-(-cells // part) for cells in (lattice.cells_x, lattice.cells_y))
    tiling = Tiling(columns, rows, west, south, part * lattice.step_x, part * lattice.step_y, 0.0)
    codes = _centre_codes(field)
    errors = _largest_errors(field, codes, part).ravel()
    for seen in lands:
        boxes = sizing.boxes(tiling, field, seen.vertical_scale, seen.vertical_offset)
        needs = _needs(field, boxes, errors, seen)
        near = np.flatnonzero((needs > seen.error_px) & _is_near(boxes, seen))
        if len(near) and part >> NEAR_BITS and lattice.levels >= NEAR_BITS:
            needs[near] = _needs_of_cells(field, codes, near // columns, near % columns, part, seen)
        needs = needs.reshape(rows, columns)
        # the largest of the parts of each square
        for axis in (0, 1):
            needs = np.maximum.reduceat(needs, np.arange(0, needs.shape[axis], max(side // part, 1)), axis=axis)
        yield needs


def _needs(field: HeightField, boxes: np.ndarray, errors: np.ndarray, seen: SeenLand) -> np.ndarray:
    """Return errors, metres, in pixels of a land's views at boxes, float64 [boxes]; 0 out of every view.

    A distance below the step of all samples counts as this: no import has more detail. boxes: float64 [boxes, 2, 3],
    lowest and highest corners, metres.
    """
    steps = loaded_m(field.provenance)
    nearest = steps[1] if steps is not None else min(field.lattice.step_x, field.lattice.step_y)
    pixels = sizing.footprints(boxes, seen.views, seen.placement, only_seen=True, nearest=nearest)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(errors * abs(seen.vertical_scale) / pixels, posinf=np.inf)


def _is_near(boxes: np.ndarray, seen: SeenLand) -> np.ndarray:
    """Return which boxes are nearer to the eye of a land's view than they are long: bool [boxes]."""
    near, diagonals = np.zeros(len(boxes), bool), np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    for view in (view for view in seen.views if view.kind != ORTHOGRAPHIC):
        eye = eye_of(product(view.world_to_camera, seen.placement))
        away = np.maximum(np.maximum(boxes[:, 0] - eye, eye - boxes[:, 1]), 0.0)
        near |= np.linalg.norm(away, axis=1) < diagonals
    return near


def _needs_of_cells(
    field: HeightField, codes: np.ndarray, rows: np.ndarray, columns: np.ndarray, part: int, seen: SeenLand
) -> np.ndarray:
    """Return the largest need in each of some parts by the distances of its cells of 2^NEAR_BITS samples.

    codes: of `_centre_codes`. rows, columns: of the parts, int [parts]. part: number of samples along a side of one.
    """
    lattice, count = field.lattice, part >> NEAR_BITS
    x, y = (
        np.minimum(places[:, None] * count + np.arange(count), -(-cells >> NEAR_BITS) - 1)
        for places, cells in ((columns, lattice.cells_x), (rows, lattice.cells_y))
    )
    heights = cell_ranges(field, NEAR_BITS, x[:, None, :], y[:, :, None])
    boxes = np.empty((*heights.shape, 3))
    sides, (west, south, _, _) = 1 << NEAR_BITS, lattice.rectangle()
    for end in (0, 1):
        boxes[..., end, 0] = west + (x + end)[:, None, :] * (sides * lattice.step_x)
        boxes[..., end, 1] = south + (y + end)[:, :, None] * (sides * lattice.step_y)
    boxes[..., 2] = np.sort(heights * seen.vertical_scale + seen.vertical_offset, axis=-1)
    inner = np.arange(sides // 2)
    v, u = (
        np.minimum(places[:, :, None] * len(inner) + inner, size - 1)
        for places, size in zip((y, x), codes.shape, strict=True)
    )
    errors = field.table[0][codes[v[:, :, None, :, None], u[:, None, :, None, :]].max(axis=(-2, -1))]
    needs = _needs(field, boxes.reshape(-1, 2, 3), errors.ravel(), seen)
    return needs.reshape(len(rows), -1).max(axis=1)


def picture_tiles(picture: HeightField) -> int:
    """Return the number of tiles that can be loaded around the heights of a quick import."""
    side = _picture_side(picture)
    return -(-picture.lattice.cells_x // side) * -(-picture.lattice.cells_y // side)


def are_all_samples(picture: HeightField) -> bool:
    """Return whether the tiles of a first picture have all samples of its source, and not a coarser step."""
    full = _full_raster(picture)
    assert full is not None, "it is a first picture"
    return stride_of(*full, picture.provenance["settings"]["quick"]) <= FACTOR


def _picture_side(picture: HeightField) -> int:
    """Return the number of cells of a quick import along a side of one of its tiles."""
    full = _full_raster(picture)
    assert full is not None, "it is a first picture"
    return 1 << BITS - _bits(picture, full)


def _full_raster(field: HeightField) -> tuple[int, int] | None:
    """Return columns and rows of the source of a first picture; None for any other field or damaged entries."""
    if field.path is None or loaded_m(field.provenance) is None or REFINED in field.provenance:
        return None
    full = read_json(field.path)["report"].get("full_raster")
    values = [*full, field.provenance.get("settings", {}).get("quick")] if isinstance(full, list) else []
    is_known = [type(value) for value in values] == [int] * 3 and min(values) > 1
    return (values[0], values[1]) if is_known else None


def _bits(field: HeightField, full: tuple[int, int]) -> int:
    """Return log2 of the number of loaded cells along one cell of a quick import.

    full: columns and rows of the complete raster.
    """
    return min(FACTOR, stride_of(*full, field.provenance["settings"]["quick"])).bit_length() - 1


def _largest_errors(field: HeightField, codes: np.ndarray, side: int) -> np.ndarray:
    """Return the largest error, metres, in each square of side x side cells, [rows, columns].

    codes: of `_centre_codes`.
    """
    for axis in (0, 1):
        codes = np.maximum.reduceat(codes, np.arange(0, codes.shape[axis], max(side // 2, 1)), axis=axis)
    return field.table[0][codes]


def _centre_codes(field: HeightField) -> np.ndarray:
    """Return the codes of the errors of the finest vertices, in the centres of 2 x 2 cells: [rows, columns]."""
    base, pages = field.lattice.layout()
    codes = rows_of(field.error[base[0] : base[1]], int(pages[0]))
    return codes[1 : field.lattice.height : 2, 1 : field.lattice.width : 2]
