# SPDX-License-Identifier: GPL-3.0-or-later
"""Construction of a height field from a raster: filled samples, error hierarchy and height ranges."""

import hashlib
from collections.abc import Callable
from typing import Protocol

import numpy as np

from ..errors import TerrainError
from ..run import launch
from . import cleaning, codes, hierarchy
from .continued_slopes import continue_slopes
from .heightfield import HeightField, HeightRaster
from .holes import holes_leave_ground, refine_borders
from .lattice import Lattice, lattice_for

DIGESTED = 1 << 23  # samples that are digested at once

Allocate = Callable[[str, tuple, np.dtype], np.ndarray]


def in_memory(_name: str, shape: tuple, dtype: np.dtype) -> np.ndarray:
    """Allocate a zeroed array in memory; a store allocates files instead."""
    return np.zeros(shape, dtype)


class Rows(Protocol):
    """An array that need not be in memory: `shape`, and rows as arrays."""

    shape: tuple[int, ...]

    def __getitem__(self, rows: slice, /) -> np.ndarray: ...


def content_key(samples: Rows, lattice: Lattice, source_max: float, valid: Rows | None) -> str:
    """Return a hex digest of everything that determines the shape and the bounds of a raster without finer tiles.

    samples: float32 metres, filled. valid: 1 where a sample is given and 0 in holes; None without holes. source_max:
    largest error of the source, metres.
    """
    digest = hashlib.blake2b(digest_size=16)
    numbers = (lattice.step_x, lattice.step_y, lattice.levels, source_max)
    digest.update(repr((samples.shape, *numbers)).encode())
    for values in (samples, *([] if valid is None else [valid])):
        rows = max(1, DIGESTED // values.shape[1])
        for row in range(0, values.shape[0], rows):
            digest.update(np.ascontiguousarray(values[row : row + rows]).data)
    return digest.hexdigest()


def no_heights(name: str) -> TerrainError:
    """Return the error about a raster without any height."""
    return TerrainError(
        f"{name} has only missing samples (no-data or not a number)",
        expected="at least one height",
        fix="choose another file or band, or another no-data value if a real height was taken for missing",
    )


def no_ground(name: str) -> TerrainError:
    """Return the error about a raster of which holes would leave nothing."""
    what = f"{name} has no cell with four known samples, so nothing would be left of it"
    return TerrainError(what, fix="import it without cutting holes")


def build(
    samples: np.ndarray,
    step_x: float,
    step_y: float,
    *,
    missing: int,
    holes: bool = False,
    source_max: float = 0.0,
    name: str = "The raster",
    allocate: Allocate = in_memory,
    threads: int | None = None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> HeightField:
    """Build a height field: fill missing samples, and compute the error hierarchy and the ranges.

    Samples in holes continue the slopes of ground beside them.

    Args:
        samples: float32 [rows, columns] metres, row 0 south, at least 2 x 2, NaN where missing; filled in place.
        step_x, step_y: metres between samples.
        missing: number of missing samples.
        holes: whether missing samples are cut out.
        source_max: largest rounding error of the source's heights, metres.
        name: the raster's name, in errors.
        allocate: allocate(name, shape, dtype) returns the other arrays, zeroed: "valid" (only with holes), "ranges",
            "error", and "errors", which is not needed afterwards.
        threads: None for the default number.
        on_progress: gets the finished fraction, 0.98 at most.

    Raises TerrainError for a raster that is too large, has no height, or has holes that leave no ground.
    """
    threads = threads or launch.default_threads()
    height, width = samples.shape
    lattice = lattice_for(width, height, step_x, step_y, name)
    if missing == samples.size:
        raise no_heights(name)
    valid = measured = None
    if missing and holes:  # errors do not count where samples are missing, although these are filled below
        valid = allocate("valid", samples.shape, np.dtype(np.uint8))
        np.isfinite(samples, out=valid.view(bool))
        if not holes_leave_ground(valid.view(bool)):
            raise no_ground(name)
        measured = samples.copy()  # with NaN for missing samples
    if missing:
        cleaning.fill_missing(samples, threads)
    on_progress(0.2)
    low, high = float(samples.min()), float(samples.max())
    if valid is not None:
        continue_slopes(lambda: samples, lambda rows: valid[rows] == 0, samples.shape)
    climb_x, climb_y = hierarchy.climbs(samples)  # largest differences between neighbours, for slopes
    # The heights below each diamond, as 16-bit codes: base + code * step metres.
    base, step = hierarchy.range_scale(low, high)
    ranges = allocate("ranges", (lattice.range_count, 2), np.dtype(np.uint16))
    hierarchy.build_ranges(samples, lattice, base, step, ranges, threads)
    on_progress(0.4)
    errors = allocate("errors", (lattice.node_count,), np.dtype(np.float32))
    hierarchy.build_errors(samples, lattice, errors, threads, lambda done: on_progress(0.4 + 0.58 * done), measured)
    if valid is not None:  # diamonds on the border of a hole get larger errors, so that the border is refined
        refine_borders(valid, lattice, errors, threads)
    # The stored errors are codes of 8 bits; each group of diamonds has a table that reaches 2^exponent metres.
    error = allocate("error", (lattice.node_count,), np.dtype(np.uint8))
    exponents = codes.encode(lattice, errors, error, threads)
    return HeightField(
        HeightRaster(samples, lattice, content_key(samples, lattice, source_max, valid), filled=missing, valid=valid),
        error=error,
        exponents=exponents,
        ranges=ranges,
        range_base=base,
        range_step=step,
        min_height=low,
        max_height=high,
        steepest_x=climb_x / lattice.step_x,
        steepest_y=climb_y / lattice.step_y,
        source_max=source_max,
    )


def from_array(
    samples: np.ndarray,
    step_x: float = 1.0,
    step_y: float | None = None,
    *,
    source_max: float = 0.0,
    holes: bool = False,
    threads: int | None = None,
    origin: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
    crs: str = "",
    provenance: dict | None = None,
) -> HeightField:
    """Return a height field in memory of a 2-D array of heights in metres, row 0 south. The array is not changed.

    A single row or column is repeated. Raises TerrainError for another kind of array, distances that are not positive,
    and for what `build` and `clean_rows` refuse.

    Args:
        step_x, step_y: metres between samples (step_y defaults to step_x).
        source_max: largest rounding error of the samples, metres.
        holes: whether samples that are not finite are cut out instead of filled.
        threads: largest number of threads, None for the default.
        origin: float64 [3], coordinates of the raster's middle. crs: coordinate system. provenance: record of the
            source, with which an import can be repeated.
    """
    step_y = step_x if step_y is None else step_y
    samples = np.asarray(samples)
    if samples.ndim != 2 or samples.dtype.kind not in "fiub":
        raise TerrainError(f"Heights came as {samples.dtype} {samples.shape}", expected="a 2-D array of real numbers")
    if not (np.isfinite(step_x) and np.isfinite(step_y) and step_x > 0.0 and step_y > 0.0):
        raise TerrainError(f"Samples are {step_x} x {step_y} m apart", expected="positive distances")
    raster, missing = cleaning.clean_rows(cleaning.repeat_single_line(samples))
    raster = np.ascontiguousarray(raster)
    built = build(raster, step_x, step_y, missing=missing, holes=holes, source_max=source_max, threads=threads)
    return built.with_raster(origin=np.asarray(origin, np.float64), crs=crs, provenance=provenance or {})
