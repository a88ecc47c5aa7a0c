# SPDX-License-Identifier: GPL-3.0-or-later
"""The report on a mosaic before it is imported: grid, coverage, seams, edges, datums, time and disk space.

A Composite has the files (tiles) of a mosaic in the order of their priority, and returns heights on the target grid.
"""

import time
from collections import Counter
from pathlib import Path

import numpy as np

from ..errors import shown
from ..field.build import from_array
from ..field.codes import steps_of
from ..field.finer_tiles import TILE_BYTES
from ..field.lattice import fit
from ..formats.archives import MAX_UNPACKED_BYTES, is_packed
from ..importing.covered import COVERED, POINTS, covered_text
from ..importing.drafts import work_bytes
from ..rasters.file_grid import unit_of
from ..rasters.raster import ImportSettings
from ..view.linear import add_up
from .composite import Composite
from .edges import find_edges
from .mosaic_source import blend_metres, georeference_of
from .seams import StepReport, find_seams
from .systems import crs_of, projected

MIN_GAP_PERCENT = 10.0  # of the extent; the report of an import says where larger gaps are
FIRST_SIDE, MEASURED_SIDE = 129, 513  # samples of a small window, and of the one whose reading and building is timed
MEASURED_POINTS = 64  # along each axis; a window's middle is one of them
MAX_KINDS = 12
# Of the samples' distance: a larger median step between files that meet is no relief along a whole border.
STEP_FRACTION = 0.2
# Entries that the report of an import has, too; it has its own sizes.
SEAM_NAMES = ("s", "s_compared", "_samples", "_median_m", "_max_m", "_max_at", "_max_between")
EDGE_NAMES = ("s", "s_compared", "_median_m", "_max_m", "_max_at", "_max_between")
IMPORT_ENTRIES = (
    *("files", "kinds", "overlap_percent", "gap_percent", "blend_m"),
    *(f"seam{name}" for name in SEAM_NAMES),
    *(f"edge{name}" for name in EDGE_NAMES),
)


def describe_mosaic(composite: Composite, settings: ImportSettings) -> dict:
    """Return the report on a mosaic as JSON. Lengths are metres, coordinates those of its system.

    Seams are places where files overlap, edges are places where files meet without an overlap.
    """
    grid, place = composite.grid, georeference_of(composite.grid)
    # x and y of the first and of the last sample, as arrays of one
    west, north = grid.positions(np.array([grid.column]), np.array([grid.row]))
    last = grid.positions(np.array([grid.column + grid.width - 1]), np.array([grid.row + grid.height - 1]))
    overlap, gap = coverage(composite)
    # The composite's heights are metres; the user may multiply them by a further factor.
    scale = 1.0 if settings.height_scale is None else abs(settings.height_scale)
    edges = find_edges(composite)
    return {
        "files": len(composite.tiles),
        "kinds": _kinds(composite),
        "crs": grid.crs,
        "raster": [grid.width, grid.height],
        "step_m": [place.step_x, place.step_y],
        "extent_m": [place.step_x * (grid.width - 1), place.step_y * (grid.height - 1)],
        "west_south_east_north": [float(west[0]), float(last[1][0]), float(last[0][0]), float(north[0])],
        "overlap_percent": round(100.0 * overlap, 2),
        "gap_percent": round(100.0 * gap, 2),
        "gaps_become": "holes" if settings.holes else "filled from the nearest sample",
        **_seams(find_seams(composite), scale),
        **_edges(edges, scale),
        **_finer_tiles(composite),
        **({"blend_m": float(f"{blend_metres(composite):.4g}")} if composite.insets else {}),
        "expected_seconds": _expected_seconds(composite),
        "expected_disk_mb": round(_expected_bytes(composite) / 1e6, 1),
        "warnings": [*datum_warnings(composite), *edge_warnings(edges, scale, max(place.step_x, place.step_y))],
    }


def coverage(composite: Composite) -> tuple[float, float]:
    """Return the fractions of the extent that several files cover, and that none covers, by their headers."""
    counts = _files_at(composite)
    return float(np.mean(counts > 1)), float(np.mean(counts == 0))


def covered_entry(composite: Composite) -> dict:
    """Return the report's entry with the points that files cover (importing/covered.py); {} without large gaps."""
    grid, largest = composite.grid, 1.0 - MIN_GAP_PERCENT / 100.0  # fraction of the extent that files may cover
    sides = composite.boxes[:, 2:] - composite.boxes[:, :2]
    if float(sides.prod(axis=1).sum()) > largest * (grid.width - 1) * (grid.height - 1):
        return {}  # known without a look at points, which takes a second for 10,000 files
    is_covered = _files_at(composite)[::-1] > 0
    return {COVERED: covered_text(is_covered)} if is_covered.mean() <= largest else {}


def _files_at(composite: Composite) -> np.ndarray:
    """Return the number of files that cover each of evenly spread points of the extent, by their headers.

    A file covers half a cell beyond its outer samples. The result is int32 [POINTS, POINTS], row 0 north.
    """
    grid = composite.grid
    columns = np.linspace(grid.column, grid.column + grid.width - 1, POINTS)
    rows = np.linspace(grid.row, grid.row + grid.height - 1, POINTS)
    x, y = grid.positions(*np.meshgrid(columns, rows))
    counts = np.zeros(x.shape, np.int32)  # files that cover each point
    for lattice in composite.lattices:
        positions = projected(grid.crs, lattice.crs, x.ravel(), y.ravel())
        for number, rank in enumerate(lattice.tiles):
            # Test only points in the file's box with a margin: lowest column and row of the grid, and highest ones.
            box = composite.near[rank]
            across = slice(*np.searchsorted(columns, [box[0], box[2]]))
            down = slice(*np.searchsorted(rows, [box[1], box[3]]))
            part_x, part_y = (values.reshape(x.shape)[down, across] for values in positions)
            counts[down, across] += lattice.covers(number, part_x, part_y)
    return counts


def datum_warnings(composite: Composite) -> list[str]:
    """Return a warning if files name different vertical datums, with the number of those that name none; else []."""
    counts = Counter(tile.datum for tile in composite.tiles)
    known = {datum: count for datum, count in counts.items() if datum}
    if len(known) < 2:
        return []
    names = ", ".join(f"{shown(datum, 60)} in {count:,}" for datum, count in known.items())
    more = f", and {counts['']:,} name none" if counts[""] else ""
    text = f"The files' heights refer to different surfaces ({names}{more})"
    if composite.shifts is not None:
        return [f"{text}: they were converted to {shown(composite.shifts.reference.datum, 60)}, by PROJ's grids."]
    return [
        f"{text}, which may be tens of metres apart. They were not converted, because a grid of PROJ is missing: get "
        "the grids (projsync, or the package proj-data) and name their folder in PROJ_DATA, or convert the files first "
        "(gdalwarp with -s_srs and -t_srs)."
    ]


def edge_warnings(edges: StepReport, scale: float, step: float) -> list[str]:
    """Return a warning about files that meet with a step, which is a cliff in the terrain; [] without any.

    scale: factor on the heights, by the settings. step: distance between samples, metres.
    """
    sizes = np.abs(edges.steps) * scale  # one step for each pair of `names`
    is_large = sizes > STEP_FRACTION * step
    if not is_large.any():
        return []
    worst, count = int(np.argmax(sizes)), int(is_large.sum())
    first, second = (shown(Path(path).name) for path in edges.names[worst])
    where = ", ".join(f"{coordinate:.10g}" for coordinate in edges.places[worst])
    others = f", and {count - 1:,} more pairs have a step of this kind" if count > 1 else ""
    return [
        f"{first} and {second} meet with a step of {sizes[worst]:.3g} m along their border, near {where}{others}. "
        "Their units or zero heights may differ: add a constant to one of them (QGIS: Raster Calculator), and import "
        "again."
    ]


def _kinds(composite: Composite) -> list[str]:
    """Return a line for each of the MAX_KINDS commonest kinds of file (system, step, type), and one for the others."""
    counts: Counter = Counter()
    for tile in composite.tiles:
        unit = unit_of(crs_of(tile.crs)) if tile.crs else {}  # a dict with the key "degrees" for such a unit
        step = " x ".join(f"{abs(s):.6g}" for s in tile.position(1, 1) - np.array(tile.position(0, 0)))
        counts[f"{tile.crs or 'no system'}, steps of {step}{'°' if 'degrees' in unit else ''}, {tile.stored}"] += 1
    lines = [f"{count:,} of {shown(kind)}" for kind, count in counts.most_common(MAX_KINDS)]
    return lines + ([f"{len(counts) - MAX_KINDS:,} more kinds"] if len(counts) > MAX_KINDS else [])


def _seams(seams: StepReport, scale: float) -> dict:
    """Return the report's entries about seams: how far the heights of overlapping files differ at their borders.

    scale: factor on the heights, by the settings.
    """
    entries = {"seams": seams.pairs, "seams_compared": seams.compared, "seam_samples": len(seams.steps)}
    return entries | _figures("seam", seams, scale)


def _edges(edges: StepReport, scale: float) -> dict:
    """Return the report's entries about edges: how far the heights of files differ that meet without an overlap.

    scale: factor on the heights, by the settings.
    """
    if not edges.pairs:
        return {}
    return {"edges": edges.pairs, "edges_compared": edges.compared} | _figures("edge", edges, scale)


def _figures(kind: str, found: StepReport, scale: float) -> dict:
    """Return the median of steps between files, and the largest step with its place and files: entries `<kind>_...`.

    {} without a step. scale: factor on the heights. found: its `numbers` are the index in `names` of each step's files.
    """
    if not len(found.steps):
        return {}
    sizes = np.abs(found.steps) * scale
    worst = int(np.argmax(sizes))
    return {
        f"{kind}_median_m": float(np.median(sizes)),
        f"{kind}_max_m": float(sizes[worst]),
        f"{kind}_max_at": [float(c) for c in found.places[worst]],
        f"{kind}_max_between": [Path(path).name for path in found.names[found.numbers[worst]]],
    }


def _finer_tiles(composite: Composite) -> dict:
    """Return the report's entries about finer tiles: number and step; {} for a mosaic with one step everywhere."""
    if composite.finer is None:
        return {}
    plan, finer_composite = composite.finer  # the latter is of all files on a grid with the finest step
    georeference = georeference_of(finer_composite.grid)
    return {"finer_tiles": plan.tiles, "finer_step_m": [georeference.step_x, georeference.step_y]}


def _expected_bytes(composite: Composite) -> int:
    """Return the bytes that an import takes on the disk, with those of unpacked files."""
    lattice = fit(max(composite.grid.width, 2), max(composite.grid.height, 2))
    unpacked = sum(
        int(tile.width * tile.height * np.dtype(tile.stored).itemsize)
        for tile in composite.tiles
        if is_packed(Path(tile.path))
    )
    steps = steps_of(np.dtype(composite.stored), composite.scale, composite.offset)
    needed = work_bytes(lattice, 4 if steps is None else 2)  # bytes of a sample: float32, or codes of 16 bits
    finer_tiles = 0 if composite.finer is None else composite.finer[0].tiles  # [0]: the plan
    return needed + finer_tiles * TILE_BYTES + min(unpacked, MAX_UNPACKED_BYTES)


def _expected_seconds(composite: Composite) -> float:
    """Return the expected time of an import: that of measured windows, times the samples that each stands for."""
    # plan.work: the number of samples of a raster without finer tiles that takes as long.
    samples = composite.grid.width * composite.grid.height if composite.finer is None else composite.finer[0].work
    if composite.finer is not None and composite.finer[0].is_of_gaps:
        # Finer tiles because of wide gaps: nearly all time is for samples of files, so a window in a file is measured.
        plan, all_files = composite.finer
        largest = plan.boxes[np.argmax((plan.boxes[:, 2:] - plan.boxes[:, :2]).prod(axis=1))]
        seconds = _seconds_at(all_files, *(largest[:2] + largest[2:]) / 2)
    else:
        seconds = add_up(fraction * _seconds_at(composite, *middle) for fraction, middle in measured_parts(composite))
    return float(f"{seconds * samples:.2g}")


def _seconds_at(composite: Composite, column: float, row: float) -> float:
    """Return the time that a sample takes to be read and built, measured in a window around a column and row."""
    grid = composite.grid
    for side in (FIRST_SIDE, MEASURED_SIDE):  # the first window opens files, loads kernels and starts threads
        width, height = min(grid.width, side), min(grid.height, side)
        left = int(np.clip(column - width / 2, 0, grid.width - width))
        top = int(np.clip(row - height / 2, 0, grid.height - height))
        started = time.perf_counter()
        heights, _ = composite.read(top, height, left, width)
        from_array(np.nan_to_num(heights, posinf=0.0, neginf=0.0).astype(np.float32))  # builds a field, for its time
    return (time.perf_counter() - started) / (width * height)


def measured_parts(composite: Composite) -> list[tuple[float, tuple[float, float]]]:
    """Return the parts of the extent whose samples take different times: fraction of the extent, and a column and row.

    A sample where finer files are on coarser ones takes several times as long, because it is blended. So the ground of
    finer files is one part, measured in the middle of the largest one. The other part is the rest, measured where some
    file is, as far from finer ones as possible. Without finer files, the extent is one part.
    """
    grid = composite.grid
    if composite.insets is None:
        return [(1.0, (grid.width / 2, grid.height / 2))]
    boxes = composite.boxes - np.array([grid.column, grid.row] * 2)
    columns = np.linspace(0, grid.width - 1, MEASURED_POINTS)
    rows = np.linspace(0, grid.height - 1, MEASURED_POINTS)
    finer = boxes[composite.levels > 0]
    # Of evenly spread points: distances from the nearest finer file, and whether any file is there.
    distances, is_covered = _box_distances(finer, columns, rows), _box_distances(boxes, columns, rows) == 0.0
    fraction = float(np.mean(distances[is_covered] == 0.0))
    farthest = np.unravel_index(np.argmax(np.where(is_covered, distances, -1.0)), distances.shape)
    largest = finer[np.argmax((finer[:, 2:] - finer[:, :2]).prod(axis=1))]
    middle = float(largest[[0, 2]].mean()), float(largest[[1, 3]].mean())
    parts = [(1.0 - fraction, (float(columns[farthest[1]]), float(rows[farthest[0]]))), (fraction, middle)]
    return [found for found in parts if found[0] > 0.0]


def _box_distances(boxes: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the Chebyshev distance of points to the nearest box (the larger one of columns and rows), 0 inside.

    The result is [rows, columns]. boxes: float64 [n, 4], first column and row and last ones. columns, rows: those of
    the points; every row is combined with every column.
    """
    nearest = np.full((len(rows), len(columns)), np.inf)
    for left, top, right, bottom in boxes:
        across = np.maximum(np.maximum(left - columns, columns - right), 0.0)
        down = np.maximum(np.maximum(top - rows, rows - bottom), 0.0)
        np.minimum(nearest, np.maximum(across, down[:, None]), out=nearest)
    return nearest
