# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field: a terrain's samples on their lattice, with the error hierarchy and the height ranges."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...kernels.field.detail import PackedLayers
from ..errors import TerrainError
from ..run.locks import caching
from . import codes
from .detail_bounds import DetailTerm, highest
from .displacement_layers import Ground, packed, parts_of
from .lattice import Lattice

INTERPOLATIONS = ("bilinear", "bicubic")
# Plane coordinates are float32 in the mesh, so lattice lines are at least 2^-23 of the longer side apart.
PLANE_BITS = 23
BICUBIC_KEY = "-bicubic"  # is appended to the samples' key for a bicubic surface
DETAIL_KEY = "-detail-"  # separates the surface's key from the detail's
# Cached surfaces with detail, since several objects of a scene may share a raster.
MAX_DETAILED = 8


@dataclass(eq=False)
class HeightField:
    """A terrain ready for refinement; arrays may be memory-mapped and are never written.

    Attributes:
        samples: [height, width], row 0 south, column 0 west: float32 metres, or uint16 numbers of `steps` (codes.py).
        interpolation: reference surface between the samples, one of INTERPOLATIONS; `interpolated` returns another.
        detail: displacement of that surface (detail.py, tiled.py, coats.py) or None; `error`, `ranges` and slopes do
            not include it.
        error: uint8 [lattice.node_count], codes of the saturated errors of all diamonds (hierarchy.py) in the order of
            lattice.py; curvatures of a bicubic surface follow (bicubic.py).
        exponents: powers of two that multiply the table of codes for each group of depths (codes.py).
        ranges: uint16 [lattice.range_count, 2] of diamonds of 4 x 4 cells and more: heights from range_base +
            q * range_step metres; for a bicubic surface those of the raster's cells follow.
        min_height, max_height: limits of the surface, metres.
        steepest_x, steepest_y: largest slopes of the surface along each axis.
        source_max: largest distance, metres, by which the rounding of the source has moved the surface.
        filled: number of missing samples that were filled.
        valid: None or, if holes are cut out, uint8 [height, width], 0 at missing samples; cells with such a corner are
            holes (holes.py).
        layers: by-products of height operators (land/), by name: float32 [height, width], row 0 south.
        origin: float64 [3], CRS coordinates of the local origin.
        key: identifies the content: terrains with equal keys are equal.
        prefiltered: coarser levels of the heights' pyramid (attributes/pyramid.py), if computed.
        found: cached results for light and occlusion (occluder.py and sky_layer.py of attributes, refine/horizon.py).
    """

    samples: np.ndarray
    lattice: Lattice
    error: np.ndarray
    exponents: list[int]
    ranges: np.ndarray
    range_base: float
    range_step: float
    min_height: float
    max_height: float
    steepest_x: float
    steepest_y: float
    key: str
    steps: codes.Steps | None = None
    source_max: float = 0.0
    filled: int = 0
    valid: np.ndarray | None = None
    layers: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    crs: str = ""
    provenance: dict = field(default_factory=dict)
    path: Path | None = None
    interpolation: str = "bilinear"
    detail: Ground | None = None
    expanded: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    surfaces: dict[str, "HeightField"] = field(default_factory=dict, repr=False)
    detailed: dict[Ground, "HeightField"] = field(default_factory=dict, repr=False)
    prefiltered: list[np.ndarray] = field(default_factory=list, repr=False)
    found: dict[tuple, object] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        lattice, surface = self.lattice, f"{self.interpolation} with detail" if self.detail else self.interpolation
        heights = f"{self.min_height:g} .. {self.max_height:g} m"
        return f"<HeightField: {lattice.width:,} x {lattice.height:,} samples, {heights}, {surface}>"

    @property
    def raster_key(self) -> str:
        """Return the key of the samples, whatever surface is between them."""
        return self.key.partition(DETAIL_KEY)[0].removesuffix(BICUBIC_KEY)

    @property
    def finest_edge(self) -> float:
        """Return the shortest edge, metres, that float32 plane coordinates of the mesh can hold."""
        lattice = self.lattice
        bits = PLANE_BITS - (max(lattice.columns, lattice.rows) - 1).bit_length() - lattice.levels
        return min(lattice.step_x, lattice.step_y) * 2.0**-bits

    @cached_property
    def packed_detail(self) -> "PackedLayers | None":
        """Return the detail as kernels read it; None without one."""
        return packed(self.detail, self.finest_edge, self.lattice) if self.detail else None

    @property
    def parts(self) -> list[DetailTerm]:
        """Return the summands of the detail for bounds; none without a detail."""
        return parts_of(self.detail, self.finest_edge, self.lattice)

    @property
    def table(self) -> np.ndarray:
        """Return the metres of the error codes, float32 [groups, 256]."""
        return codes.tables(self.exponents)

    def heights(self, *index) -> np.ndarray:
        """Return samples[index], or all of them, in float32 metres."""
        samples = self.samples[index]
        return samples if self.steps is None else self.steps.heights(samples)

    def damage(self, what: str) -> TerrainError:
        """Return the error for arrays that no import has written. what: clause about the fault."""
        name = f"The store {self.path}" if self.path else "The height field"
        return TerrainError(f"{name} is damaged ({what})", fix="import it again")

    def check_samples(self) -> None:
        """Raise TerrainError if a sample is not finite. This reads all samples, so only slower code should call it."""
        finite = (np.isfinite(self.samples[row : row + 256]).all() for row in range(0, len(self.samples), 256))
        if self.steps is None and not all(finite):
            raise self.damage("it has heights that are not finite")


def as_heights(field: HeightField, samples: np.ndarray, key: str, lattice: Lattice | None = None) -> HeightField:
    """Return a field with other samples over a field's raster, without its caches, errors and ranges.

    samples: float32 [lattice.height, lattice.width], row 0 south.
    """
    fresh = {"prefiltered": [], "expanded": {}, "surfaces": {}, "detailed": {}, "found": {}, "layers": {}}
    content = {"samples": samples, "steps": None, "valid": None, "path": None, "detail": None, "key": key}
    return replace(field, **content, **fresh, lattice=lattice or field.lattice)


def with_detail(field: HeightField, detail: Ground | None) -> HeightField:
    """Return the same surface with another detail or none. Arrays are shared, nothing is read.

    A detail without amplitude counts as none. The last few results are cached.
    """
    plain = field.surfaces["plain"] if field.detail else field
    if detail is None or not detail.amplitude:
        return plain
    with caching:
        surface = plain.detailed.pop(detail, None)
        if surface is None:
            more = highest(parts_of(detail, plain.finest_edge, plain.lattice))
            surface = replace(
                plain,
                detail=detail,
                min_height=plain.min_height - more,
                max_height=plain.max_height + more,
                key=plain.key + DETAIL_KEY + detail.key,
                surfaces={"plain": plain},
                detailed={},
            )
        plain.detailed[detail] = surface
        while len(plain.detailed) > MAX_DETAILED:
            del plain.detailed[next(iter(plain.detailed))]
        return surface
