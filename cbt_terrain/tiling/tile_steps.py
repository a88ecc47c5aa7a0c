# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of a store that is made by tile, after its samples are there: fill, measure each tile, join the borders.

`work` is the folder with the terrain's arrays and with records of its finished parts: of samples that were read (READ)
and of tiles that were measured (MEASURED), by number. `work.grid` has the tiles, each a square of cells.

A tile's errors are stored as codes: bytes, each the index of an error in a table of its group (two levels of diamonds;
the raster's cells have the last table). The largest error of a table is 2^exponent metres. A tile is measured under its
own exponents; joining translates its codes to those of the whole terrain, which are larger or equal.

The record of a tile has the entries STATE: "errors" and "ranges", digests of all that they depend on; "largest", the
largest error of each group and of the cells; "exponents" of its stored codes; "climbs", the largest differences of
neighbouring heights along x and y; "above", a digest and the errors of diamonds larger than a tile.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from operator import gt
from typing import Any, NamedTuple

import numpy as np

from ..field import cleaning, codes, hierarchy
from ..field.continued_slopes import continue_slopes
from ..field.digests import digest_of
from ..field.holes import longest_edge
from ..field.lattice import Lattice
from . import borders, part_files
from .coarse_land import CoarseLand
from .measure_tile import (
    LargeError,
    TileSamples,
    code_errors,
    exact_errors,
    large_errors,
    large_triangles,
    margin_of,
    measure_ranges,
)
from .tile_grid import halved, put, translate
from .tile_records import MEASURED, READ, STATE
from .tile_work import TileWork


class TerrainLimits(NamedTuple):
    """Limits of all heights of a work, and the number of its missing samples."""

    low: float
    high: float
    missing: int

    @property
    def scale(self) -> tuple[float, float]:
        """Return base and step, metres: a code q of the height ranges is the height base + q * step."""
        return hierarchy.range_scale(self.low, self.high)


def limits_of(work: TileWork) -> TerrainLimits:
    """Return the limits of all heights that were read; NaN if all samples are missing."""
    records = work.records(READ).values()
    known = [record["limits"] for record in records if record["limits"]]
    low = min((low for low, _ in known), default=np.nan)
    high = max((high for _, high in known), default=np.nan)
    return TerrainLimits(low, high, sum(int(record["missing"]) for record in records))


def fill(work: TileWork, threads: int) -> None:
    """Fill all missing samples with the nearest valid one, in the work's arrays; they stay marked as missing.

    If they are cut out, those beside ground continue its slopes.
    """
    shape = work.grid.lattice.height, work.grid.lattice.width

    def samples() -> np.ndarray:
        """Map the samples."""
        return work.open("samples")

    def missing_in(rows: slice) -> np.ndarray:
        """Return which samples of some rows are missing, bool."""
        return work.open("missing")[rows] > 0

    cleaning.fill_rows(samples, missing_in, shape, threads)
    if work.holes:
        continue_slopes(samples, missing_in, shape)


def measure(
    work: TileWork,
    number: int,
    limits: TerrainLimits,
    threads: int,
    before: dict | None,
    exponents: Sequence[int] = (),
    coarse: CoarseLand | None = None,
) -> bool:
    """Measure the changed parts of a tile and write its record. Return whether its errors were measured.

    Without a change nothing is written. limits: of all heights. before: its last record, None for none. exponents: of
    its groups and cells; a tile whose stored codes have a larger one is measured again, () for no such limit. coarse:
    the land around loaded tiles, None if all tiles are loaded.
    """
    changes = measured(work, number, limits, threads, before, exponents, coarse)
    if changes is None:
        return False
    write_measured(work, number, changes, has_record=before is not None)
    return changes.codes is not None


class MeasuredTile(NamedTuple):
    """Changes of a tile by its measuring.

    Attributes:
        record: its state.
        codes: uint8, codes of its errors, in the layout of its lattice; None if they are as before.
        border: uint8 [2, n], codes and kinds of cells near its border; None as `codes`.
        ranges: uint16 [n, 2], ranges in the layout of its halved lattice; None if they are as before.
    """

    record: dict[str, Any]
    codes: np.ndarray | None = None
    border: np.ndarray | None = None
    ranges: np.ndarray | None = None


def write_measured(work: TileWork, number: int, changes: MeasuredTile, has_record: bool) -> None:
    """Write the changes of a tile into the arrays of a work, and its record. has_record: it has an earlier one."""
    grid, box = work.grid, work.grid.box(number)
    if has_record:
        work.note(MEASURED, number)  # a record without entries: not measured, if this process is killed meanwhile
    if changes.codes is not None:
        put(grid, box, changes.codes, work.open("error"))
        work.open("borders")[number] = changes.border
    if changes.ranges is not None:
        half = halved(grid)  # only every other sample has a range
        put(half, half.box(number), changes.ranges, work.open("ranges"))
    work.note(MEASURED, number, **changes.record)


def write_parts(work: TileWork) -> None:
    """Write the results of tiles that other processes have measured (part_files.py) into the arrays of a work.

    Damaged ones are left out. Those of other samples are measured again later, as any tile that has changed.
    """
    before = work.records(MEASURED)
    for number in part_files.numbers_of(work.folder, MEASURED):
        record = part_files.find_record(work.folder, work.grid, MEASURED, number)
        if record is None or "errors" not in record:
            continue
        with suppress(ValueError, OSError):
            blocks = {block.name: block.values for block in part_files.blocks_of(work.folder, record)}
            state = {name: record[name] for name in STATE}
            changes = MeasuredTile(state, blocks.get("codes"), blocks.get("border"), blocks.get("ranges"))
            if _fits(work, number, changes):
                write_measured(work, number, changes, has_record=number in before)


def _fits(work: TileWork, number: int, changes: MeasuredTile) -> bool:
    """Return whether arrays of a tile have the shapes that it needs; border is there if codes are.

    changes: these arrays.
    """
    local, near = work.grid.local(work.grid.box(number)), len(work.grid.near_border.x)
    wanted = {"codes": (local.node_count,), "border": (2, near), "ranges": (local.range_count, 2)}
    arrays = {name: getattr(changes, name) for name in wanted}
    is_paired = (changes.codes is None) == (changes.border is None)
    return is_paired and all(array is None or array.shape == wanted[name] for name, array in arrays.items())


def measured(
    work: TileWork,
    number: int,
    limits: TerrainLimits,
    threads: int,
    before: dict | None,
    exponents: Sequence[int] = (),
    coarse: CoarseLand | None = None,
) -> MeasuredTile | None:
    """Measure the changed parts of a tile; None without a change. Nothing is written.

    The parts are the errors inside the tile, those of larger diamonds ("above") and the ranges. Each has a digest of
    all that it depends on; it has changed if that differs from the digest in the record `before`.

    Args:
        limits: of all heights of the terrain; `limits.scale`, base and step of its ranges, follows from them.
        before: its last record, None for none.
        exponents: of its groups and cells; a tile whose stored codes have a larger one is measured again. () for no
            such limit.
        coarse: the land around loaded tiles, None if all tiles are loaded.
    """
    grid, box = work.grid, work.grid.box(number)
    # All samples that the tile's errors depend on: its own and a margin, which grows with the range of heights.
    window = grid.window(box, margin_of(limits.low, limits.high))
    raw = work.raw("samples", window)
    valid = work.raw("missing", window) ^ 1 if work.holes and limits.missing else None
    is_near = coarse is not None and coarse.is_near_loaded(grid, number, margin_of(limits.low, limits.high))
    coarse_inputs = () if coarse is None else (coarse.digest, is_near, box)
    # The window relative to the tile's first sample, whose position another extent of the raster changes.
    around = tuple(end - first for end, first in zip(window, (box.x0, box.y0) * 2, strict=True))
    # The step of the grid, metres: only errors at holes depend on it.
    hole_steps = () if valid is None else (grid.lattice.step_x, grid.lattice.step_y)
    places = around, grid.shape_of(box), hole_steps
    arrays = [raw] if valid is None else [raw, valid]
    errors_digest = digest_of(arrays, repr((places, work.steps, *coarse_inputs)))
    heights: dict[tuple[int, int], float] = {}

    def height(samples: np.ndarray, x: int, y: int) -> float:
        """Return the height at a vertex, and keep it. samples: the mapped array."""
        if (x, y) not in heights:
            heights[x, y] = work.height(samples, x, y)
        return heights[x, y]

    # Reads the few vertices that it needs into `heights` from one mapping, which takes longer to open than to read.
    # There are no larger diamonds if a tile holds whole root squares, the largest cells of the lattice.
    triangles = [] if grid.holds_roots else large_triangles(grid, box, partial(height, work.open("samples")))
    state: dict[str, Any] = {name: (before or {}).get(name) for name in STATE}
    above_digest = digest_of([], repr((errors_digest, sorted(heights.items()))))
    ranges_digest = digest_of([], repr((errors_digest, limits.scale)))
    # stored codes with larger exponents than are allowed were rounded too much
    is_rounded = state["exponents"] is not None and any(map(gt, state["exponents"], exponents))
    is_measured = state["errors"] == errors_digest and not is_rounded
    if is_measured and state["ranges"] == ranges_digest and state["above"][0] == above_digest:
        return None
    stored, border, ranges = None, None, None
    tile = TileSamples(grid, box, window, work.decoded(raw), valid)
    if not is_measured:
        tile_errors = code_errors(tile, *_errors(tile, coarse, is_near, threads), threads)
        stored = tile_errors.codes
        # Codes near the tile's border, and kinds (ground, hole) of the same cells, 0 without holes.
        border = np.stack(
            [tile_errors.border, np.zeros_like(tile_errors.border) if tile_errors.kinds is None else tile_errors.kinds]
        )
        state |= {
            "errors": errors_digest,
            "largest": tile_errors.largest,
            "climbs": hierarchy.climbs(tile.inner_samples),
        }
        state["exponents"] = tile_exponents(work, number, tile_errors.largest)
    if state["ranges"] != ranges_digest and grid.lattice.range_depth:
        ranges = measure_ranges(tile, limits.scale, threads)
    if state["above"] is None or state["above"][0] != above_digest:
        large = large_errors(tile, triangles, threads)
        # With both, since joining takes the largest error of each diamond.
        state["above"] = [above_digest, large if coarse is None else large + list(coarse.large_errors(large))]
    return MeasuredTile(state | {"ranges": ranges_digest}, stored, border, ranges)


def _errors(
    tile: TileSamples, coarse: CoarseLand | None, is_near_loaded: bool, threads: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the errors of a tile, float32 metres in the layout of its lattice, and the kinds of its cells.

    The kinds (ground, hole) are None without holes. coarse: the land around loaded tiles, None if all tiles are loaded.
    Its bounds of errors need no samples; they are all that counts if the tile has no holes and no loaded tile is near.
    is_near_loaded: whether samples of a loaded tile are in the tile's window.
    """
    if coarse is None:
        return exact_errors(tile, threads)
    errors, kinds = coarse.errors(tile.grid, tile.box), None
    if is_near_loaded or tile.valid is not None:
        exact, kinds = exact_errors(tile, threads)
        np.maximum(errors, exact, out=errors)
    return errors, kinds


def tile_exponents(work: TileWork, number: int, largest: Sequence[float]) -> list[int]:
    """Return the exponents of the codes that a tile was measured with. largest: its largest errors, metres."""
    return codes.nested(work.grid.local(work.grid.box(number)), list(map(codes.exponent_of, largest)))


class JoinedErrors(NamedTuple):
    """Results of a whole terrain: exponents, and the largest differences of neighbours along x and y, metres."""

    exponents: list[int]
    climbs: tuple[float, float]


def join(
    work: TileWork,
    limits: TerrainLimits,
    threads: int,
    on_progress: Callable[[float], None],
    coarse: CoarseLand | None = None,
) -> JoinedErrors:
    """Complete the errors and ranges of a terrain whose tiles are all measured.

    on_progress: gets the fraction that is done. coarse: the land around loaded tiles, None if all tiles are loaded.
    limits: of all heights.
    """
    grid, lattice = work.grid, work.grid.lattice
    records = work.records(MEASURED)  # their entries: STATE
    # Errors of diamonds as large as a tile or larger, from each tile that they meet: vertex, level and metres.
    large = [LargeError(*item) for record in records.values() for item in record["above"][1]]
    kinds = None  # opens the kinds of all diamonds: ground, hole or both; only a terrain with holes has them
    largest = _largest(work, records, large)
    if work.holes and limits.missing:
        work.make_sparse("kinds")
        kinds = partial(work.open, "kinds")
        # At the border of a hole a diamond's error is at least the length of its longest edge, so that it is split.
        # Raise the largest error at each depth with such diamonds. is_centre: their vertices are centres of cells.
        for level, is_centre in _join_kinds(work, kinds):
            largest[level // 2] = max(largest[level // 2], _longest(lattice, level, is_centre))
    # The largest error of each group chooses its table of codes; a coarser group has no smaller one than a finer group.
    exponents = codes.nested(lattice, list(map(codes.exponent_of, _nested(largest))))
    for number, record in sorted(records.items()):
        on_progress(0.5 * number / len(grid))
        groups = len(record["exponents"]) - 1
        wanted = [*exponents[:groups], exponents[-1]]  # the last is that of the cells
        # Codes that were rounded for a larger error than there is now cannot be refined.
        if any(map(gt, record["exponents"], wanted)):
            measure(work, number, limits, threads, before=record, exponents=wanted, coarse=coarse)
            record = work.records(MEASURED, number)[number]
        if record["exponents"] != wanted:
            work.note(MEASURED, number)  # a record without entries: not measured, if this process is killed meanwhile
            tables = borders.tables_between(record["exponents"], wanted)
            translate(grid, grid.box(number), work.open("error"), tables)
            values = {name: value for name, value in record.items() if name not in ("kind", "number", "at")}
            work.note(MEASURED, number, **values | {"exponents": wanted})
    # Of each tile the codes near its border, as they were measured, before any translation: functions that read them.
    border_codes = [(number, partial(work.border, number, kind=0)) for number in records]

    def tables_of(number: int) -> np.ndarray:
        """Return the tables from the codes that a tile was measured with to those of the terrain."""
        exact = tile_exponents(work, number, records[number]["largest"])
        return borders.tables_between(exact, [*exponents[: len(exact) - 1], exponents[-1]])

    error = partial(work.open, "error")
    borders.join_borders(grid, border_codes, error, tables_of)
    table = codes.tables(exponents)
    borders.write_large(grid, large, table, error)
    on_progress(0.7)
    borders.raise_errors(grid, error, table, kinds, partial(_longest, lattice))
    on_progress(0.9)
    if lattice.range_depth:
        borders.unite_ranges(grid, partial(work.open, "ranges"))
    if kinds is not None:
        work.remove("kinds")
    climbs = [record["climbs"] for record in records.values()]
    return JoinedErrors(exponents, (max(x for x, _ in climbs), max(y for _, y in climbs)))


def _largest(work: TileWork, records: dict[int, dict], large: Sequence[LargeError]) -> list[float]:
    """Return the largest error, metres, of each group of the terrain and of its cells.

    records: of the measured tiles by number. large: errors of diamonds as large as a tile or larger.
    """
    largest = [0.0] * (work.grid.lattice.groups + 1)
    for record in records.values():
        *groups, cells = record["largest"]
        largest[-1] = max(largest[-1], cells)
        for group, error in enumerate(groups):
            largest[group] = max(largest[group], error)
    for item in large:
        largest[item.level // 2] = max(largest[item.level // 2], item.error)
    return largest


def _nested(largest: Sequence[float]) -> list[float]:
    """Return the largest error of each group, raised to those of all finer groups and of the cells.

    largest: the largest error of each group, the finest first, then that of the cells, as in the result.
    """
    *groups, cells = largest
    return [*(max([cells, *groups[: number + 1]]) for number in range(len(groups))), cells]


def _longest(lattice: Lattice, level: int, is_centre: bool) -> float:
    """Return the longest edge of a diamond with a vertex of this level, float32 metres.

    is_centre: the vertex is the centre of a cell, otherwise the middle of a side.
    """
    # A centre's depth is one less than that of the middles of its cell's sides.
    return float(np.float32(longest_edge(lattice, 2 * (lattice.levels - level) - is_centre)))


def _join_kinds(work: TileWork, kinds: borders.Opened) -> list[tuple[int, bool]]:
    """Unite the kinds of cells (ground, hole) near the tiles' borders; return the depths with cells of both kinds.

    A depth is (level, whether its vertices are centres).
    """
    border_kinds = [(number, partial(work.border, number, kind=1)) for number in range(len(work.grid))]
    # Tables that leave values as they are: kinds, unlike codes, need no translation between tiles and raster.
    identity = np.tile(np.arange(256, dtype=np.uint8), (work.grid.lattice.groups + 1, 1))
    borders.join_borders(work.grid, border_kinds, kinds, lambda _number: identity, np.bitwise_or)
    return borders.raise_kinds(work.grid, kinds)
