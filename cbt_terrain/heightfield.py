# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field: a terrain's samples on their lattice, with the error hierarchy and the height ranges."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from . import hierarchy, launch, resample
from .errors import TerrainError
from .lattice import Lattice

INTERPOLATIONS = ("bilinear", "bicubic")

Allocate = Callable[[str, tuple, np.dtype], np.ndarray]


@dataclass(eq=False)
class HeightField:
    """A terrain ready for refinement; arrays may be memory-mapped and are never written.

    samples: float32 [height, width] metres, row 0 south, column 0 west.
    interpolation: of INTERPOLATIONS, what the reference surface is between the samples; `interpolated` gives another.
    error: float32 [lattice.node_count] metres, saturated error of each diamond (see hierarchy.py; the order of both
    is that of lattice.py); of a bicubic surface with bends behind them (see bicubic.py).
    ranges: uint16 [lattice.range_count, 2], diamonds above the raster's cells; a height is range_base + q * range_step
    metres. Of a bicubic surface [lattice.node_count, 2]: those of the cells follow.
    min_height, max_height: metres between which the surface lies.
    steepest_x, steepest_y: metres of height per metre along each axis, the most of the surface.
    resample_max, resample_rms: metres by which bringing the raster onto the lattice moved its own samples.
    moved: float32 [lattice.node_count] metres, the most of that below each diamond, nested; None where the raster fits.
    source_max: metres by which the source's own rounding may have moved the surface, at most; 0 of exact samples.
    filled: how many missing samples were filled. origin: float64 [3], CRS coordinates of the local origin.
    key: identifies the content: equal keys, equal terrains.
    """

    samples: np.ndarray
    lattice: Lattice
    error: np.ndarray
    ranges: np.ndarray
    range_base: float
    range_step: float
    min_height: float
    max_height: float
    steepest_x: float
    steepest_y: float
    key: str
    resample_max: float = 0.0
    resample_rms: float = 0.0
    moved: np.ndarray | None = None
    source_max: float = 0.0
    filled: int = 0
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    crs: str = ""
    provenance: dict = field(default_factory=dict)
    path: Path | None = None
    interpolation: str = "bilinear"
    _expanded: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    _interpolated: dict[str, "HeightField"] = field(default_factory=dict, repr=False)

    def interpolated(self, name: str) -> "HeightField":
        """The same samples with another surface between them, one of INTERPOLATIONS; this field if it is its own.

        Computed once and kept in the store if the field has one. Raises TerrainError for another name.
        """
        if name not in INTERPOLATIONS:
            known = " or ".join(INTERPOLATIONS)
            raise TerrainError(f"The interpolation is {name!r}; expected {known}.")
        if name == self.interpolation:
            return self
        if name not in self._interpolated:
            from . import bicubic

            self._interpolated[name] = made = bicubic.bicubic(self)
            made._interpolated = {self.interpolation: self}
        return self._interpolated[name]

    def damage(self, what: str) -> TerrainError:
        """The error of a field whose arrays cannot be what an import has written."""
        where = f"The store {self.path}" if self.path else "The height field"
        return TerrainError(f"{where} is damaged: {what}; import it again.")

    def check_samples(self) -> None:
        """Raise TerrainError if a sample is not finite: for what reads all of them, and takes longer than this."""
        if not all(np.isfinite(self.samples[row : row + 256]).all() for row in range(0, len(self.samples), 256)):
            raise self.damage("it has heights that are not finite")

    def error_for(self, meshlet: int) -> np.ndarray:
        """float32 [node_count]: the error hierarchy for leaves that are drawn as 4**meshlet triangles.

        Computed once for each `meshlet`, and kept in the store if the field has one.
        """
        if meshlet == 0:
            return self.error
        if meshlet not in self._expanded:
            self._expanded[meshlet] = self._load_or_expand(meshlet)
        return self._expanded[meshlet]

    def _load_or_expand(self, meshlet: int) -> np.ndarray:
        from . import store

        name = f"error_m{meshlet}" if self.interpolation == "bilinear" else f"error_c_m{meshlet}"
        kept = store.load_kept(self, name, self.error.shape, np.float32)
        if kept is not None:
            return kept
        errors = np.array(self.error)
        if not (errors >= 0).all() or np.isinf(errors).any():
            raise self.damage("it has errors that are negative or not finite")
        hierarchy.expand_errors(self.lattice, errors, meshlet, launch.default_threads())
        store.keep(self, name, errors)
        return errors


def _in_memory(_name: str, shape: tuple, dtype) -> np.ndarray:
    return np.zeros(shape, dtype)


def content_key(samples: np.ndarray, lattice: Lattice, resample_max: float, source_max: float) -> str:
    """Hex digest of what determines a terrain's shape and its bounds."""
    digest = hashlib.blake2b(digest_size=16)
    numbers = (lattice.step_x, lattice.step_y, lattice.levels, resample_max, source_max)
    digest.update(repr((samples.shape, *numbers)).encode())
    for row in range(0, samples.shape[0], 256):
        digest.update(np.ascontiguousarray(samples[row : row + 256]))
    return digest.hexdigest()


def build(
    raster: np.ndarray,
    step_x: float,
    step_y: float,
    *,
    missing: int,
    source_max: float = 0.0,
    name: str = "The raster",
    allocate: Allocate = _in_memory,
    threads: int | None = None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> HeightField:
    """Everything that is done to a raster once: fill, bring onto a lattice, error hierarchy, ranges.

    raster: float32 [rows, columns] metres, row 0 south, at least 2 x 2, NaN where missing (`missing` of them); is
    filled in place. step_x, step_y: metres between samples. source_max: as in HeightField. allocate(name, shape, dtype)
    provides the arrays that stay; where the raster fits its lattice, `raster` itself stays. name: what errors call the
    raster.
    """
    threads = threads or launch.default_threads()
    height, width = raster.shape
    lattice = resample.lattice_for(width, height, step_x, step_y, name)
    if missing == raster.size:
        raise TerrainError(f"{name} has only missing samples (no-data or not a number): there is no terrain in it.")
    if missing:
        resample.fill_missing(raster, threads)
    on_progress(0.1)
    samples, moved, moved_max, moved_rms = raster, None, 0.0, 0.0
    if (lattice.height, lattice.width) != raster.shape:
        samples = allocate("samples", (lattice.height, lattice.width), np.dtype(np.float32))
        moved_max, moved_rms = resample.onto_lattice(raster, samples, threads)
        moved = allocate("moved", (lattice.node_count,), np.dtype(np.float32))
        hierarchy.build_moved(raster, samples, lattice, moved, threads)
    on_progress(0.2)
    low, high = float(samples.min()), float(samples.max())
    climb_x, climb_y = hierarchy.climbs(samples)
    base, step = hierarchy.range_scale(low, high)
    ranges = allocate("ranges", (lattice.range_count, 2), np.dtype(np.uint16))
    hierarchy.build_ranges(samples, lattice, base, step, ranges, threads)
    on_progress(0.4)
    error = allocate("error", (lattice.node_count,), np.dtype(np.float32))
    hierarchy.build_errors(samples, lattice, error, threads, lambda done: on_progress(0.4 + 0.6 * done))
    return HeightField(
        samples=samples,
        lattice=lattice,
        error=error,
        ranges=ranges,
        range_base=base,
        range_step=step,
        min_height=low,
        max_height=high,
        steepest_x=climb_x / lattice.step_x,
        steepest_y=climb_y / lattice.step_y,
        key=content_key(samples, lattice, moved_max, source_max),
        resample_max=moved_max,
        resample_rms=moved_rms,
        moved=moved,
        source_max=source_max,
        filled=missing,
    )


def from_array(
    samples: np.ndarray, step_x: float = 1.0, step_y: float | None = None, *, source_max: float = 0.0, **details
) -> HeightField:
    """A height field in memory from a 2-D array of heights in metres, row 0 south.

    Samples are `step_x`, `step_y` metres apart (step_y defaults to step_x); those that are not finite are filled.
    `source_max`: metres by which they may be rounded. `details` are further fields of HeightField: origin, crs,
    provenance; `threads` limits the threads used.
    """
    step_y = step_x if step_y is None else step_y
    samples = np.asarray(samples)
    if samples.ndim != 2 or samples.dtype.kind not in "fiub":
        raise TerrainError(f"Heights came as {samples.dtype} {samples.shape}: expected a 2-D array of real numbers.")
    if not (np.isfinite(step_x) and np.isfinite(step_y) and step_x > 0.0 and step_y > 0.0):
        raise TerrainError(f"Samples are {step_x} x {step_y} m apart: expected positive distances.")
    raster, missing = resample.clean_rows(resample.widen(samples))
    threads, raster = details.pop("threads", None), np.ascontiguousarray(raster)
    built = build(raster, step_x, step_y, missing=missing, source_max=source_max, threads=threads)
    for name, value in details.items():
        setattr(built, name, value)
    return built
