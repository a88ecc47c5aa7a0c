# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field: a terrain's samples on their lattice, with the error hierarchy and the height ranges."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...kernels.field.detail import Coats
from ..errors import TerrainError
from ..run.locks import caching
from . import codes
from .coats import Ground, packed, parts_of
from .detail_bounds import Part, highest
from .lattice import Lattice

INTERPOLATIONS = ("bilinear", "bicubic")
# Plane coordinates are float32 in the mesh: no lattice line finer than 2^-23 of the longer side.
PLANE_BITS = 23
# What the key of a bicubic surface has more than that of its samples.
BICUBIC_KEY = "-bicubic"
# ... and what that of a surface with detail begins its own with.
DETAIL_KEY = "-detail-"
# Surfaces with detail that a field keeps: several objects of a scene may share its raster.
MOST_DETAILED = 8


@dataclass(eq=False)
class HeightField:
    """A terrain ready for refinement; arrays may be memory-mapped and are never written.

    samples: [height, width], row 0 south, column 0 west: float32 metres, or uint16 numbers of `steps` (codes.py).
    interpolation: of INTERPOLATIONS, what the reference surface is between the samples; `interpolated` gives another.
    detail: None or what is added to that surface (detail.py, tiled.py, coats.py); `error`, `ranges` and slopes are
    without it.
    error: uint8 [lattice.node_count], a code of the saturated error of each diamond (see hierarchy.py; the order is
    that of lattice.py); of a bicubic surface with bends behind them (see bicubic.py).
    exponents: by which the table of codes is multiplied for each group of depths (codes.py).
    ranges: uint16 [lattice.range_count, 2], diamonds of 4 x 4 cells and more; a height is range_base + q * range_step
    metres. Of a bicubic surface those of the raster's cells follow.
    min_height, max_height: metres between which the surface lies.
    steepest_x, steepest_y: metres of height per metre along each axis, the most of the surface.
    source_max: metres by which the source's own rounding may have moved the surface, at most; 0 of exact samples.
    filled: how many missing samples were filled. origin: float64 [3], CRS coordinates of the local origin.
    valid: None or, where holes are to be cut out, uint8 [height, width]: 0 where a sample was missing; the cells that
    have such a corner are holes (see holes.py).
    layers: what effects that have shaped the heights (land/) have left, by name: float32 [height, width], row 0 south.
    key: identifies the content: equal keys, equal terrains.
    prefiltered: empty, or the coarser levels of the heights' pyramid (effects/pyramid.py), whatever lies between them.
    found: what was looked for once in the heights, for light and for what hides what (effects/occluder.py,
    effects/sky_layer.py, refine/horizon.py).
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
        """The key of the samples, whatever surface lies between them."""
        return self.key.partition(DETAIL_KEY)[0].removesuffix(BICUBIC_KEY)

    @property
    def finest_edge(self) -> float:
        """Metres of the shortest edge that float32 plane coordinates of the mesh can hold."""
        lattice = self.lattice
        bits = PLANE_BITS - (max(lattice.columns, lattice.rows) - 1).bit_length() - lattice.levels
        return min(lattice.step_x, lattice.step_y) * 2.0**-bits

    @cached_property
    def packed_detail(self) -> "Coats | None":
        """The detail as kernels read it; None without one."""
        return packed(self.detail, self.finest_edge, self.lattice) if self.detail else None

    @property
    def parts(self) -> list[Part]:
        """What bounds are taken of: the summands of the detail; none without one."""
        return parts_of(self.detail, self.finest_edge, self.lattice)

    @property
    def table(self) -> np.ndarray:
        """float32 [groups, 256] metres: what the codes of errors stand for."""
        return codes.tables(self.exponents)

    def heights(self, *index) -> np.ndarray:
        """float32 metres: samples[index], or all of them."""
        samples = self.samples[index]
        return samples if self.steps is None else self.steps.heights(samples)

    def damage(self, what: str) -> TerrainError:
        """The error of a field whose arrays cannot be what an import has written."""
        where = f"The store {self.path}" if self.path else "The height field"
        return TerrainError(f"{where} is damaged: {what}; import it again.")

    def check_samples(self) -> None:
        """Raise TerrainError if a sample is not finite: for what reads all of them, and takes longer than this."""
        finite = (np.isfinite(self.samples[row : row + 256]).all() for row in range(0, len(self.samples), 256))
        if self.steps is None and not all(finite):
            raise self.damage("it has heights that are not finite")


def as_heights(field: HeightField, samples: np.ndarray, key: str, lattice: Lattice | None = None) -> HeightField:
    """Other numbers over a field's raster as the samples of a field: float32 [lattice.height, lattice.width], row 0
    south. So they have a pyramid, and nothing of what was found in the heights; they have no errors and no ranges."""
    fresh = {"prefiltered": [], "expanded": {}, "surfaces": {}, "detailed": {}, "found": {}, "layers": {}}
    own = {"samples": samples, "steps": None, "valid": None, "path": None, "detail": None, "key": key}
    return replace(field, **own, **fresh, lattice=lattice or field.lattice)


def with_detail(field: HeightField, detail: Ground | None) -> HeightField:
    """The same surface with another detail on it, or with none. Arrays are shared, nothing is read.

    Without amplitude there is no detail. The last few that were asked for are the same objects again.
    """
    plain = field.surfaces["plain"] if field.detail else field
    if detail is None or not detail.amplitude:
        return plain
    with caching:
        kept = plain.detailed.pop(detail, None)
        if kept is None:
            more = highest(parts_of(detail, plain.finest_edge, plain.lattice))
            kept = replace(
                plain,
                detail=detail,
                min_height=plain.min_height - more,
                max_height=plain.max_height + more,
                key=plain.key + DETAIL_KEY + detail.key,
                surfaces={"plain": plain},
                detailed={},
            )
        plain.detailed[detail] = kept
        while len(plain.detailed) > MOST_DETAILED:
            del plain.detailed[next(iter(plain.detailed))]
        return kept
