# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field: a terrain's samples on their lattice, with the error hierarchy and the height ranges."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import TerrainError, check_kind
from ..run.locks import caching
from . import codes
from .detail_bounds import DetailTerm, highest
from .displacement_layers import Ground, bound_terms, pack_layers
from .georeference import Place, known_place, move_place
from .lattice import Lattice
from .shared_pages import Paged
from .store_arrays import all_finite

if TYPE_CHECKING:
    from ...kernels.field.detail import PackedLayers
    from .finer_tiles import FinerTiles

INTERPOLATIONS = ("bilinear", "bicubic")
# Plane coordinates are float32 in the mesh, so lattice lines are at least 2^-23 of the longer side apart.
PLANE_BITS = 23
LOADED = "loaded_m"  # entry of the provenance of an incomplete import (importing/thinning.py)
# Cached surfaces with detail, since several objects of a scene may share a raster.
MAX_DETAILED = 8


@dataclass(frozen=True)
class SurfaceSpec:
    """The choice of a surface through a raster's samples.

    Attributes:
        interpolation: reference surface between the samples, one of INTERPOLATIONS.
        detail: displacement of that surface (detail.py, tiled.py, displacement_layers.py) or None.
    """

    interpolation: str = "bilinear"
    detail: Ground | None = None


@dataclass(frozen=True)
class FieldKey:
    """The identity of a height field: fields with equal keys are equal. Its text goes into files and hashes.

    `raster`, `detail`: digests of the samples and of the displacement, "" without one.
    """

    raster: str
    interpolation: str
    detail: str
    anchor: tuple[float, float] = (0.0, 0.0)

    def __str__(self) -> str:
        surface = "" if self.interpolation == "bilinear" else f"-{self.interpolation}"
        anchor = "-anchor-{}-{}".format(*self.anchor) if any(self.anchor) else ""
        return self.raster + surface + (f"-detail-{self.detail}" if self.detail else "") + anchor


@dataclass(frozen=True)
class FieldCache:
    """Results that are computed once for a raster.

    Attributes:
        surfaces: height fields by specification; the raster's own is there once there is another.
        expanded: error hierarchies by interpolation and level of meshlets (meshlet_errors.py).
        pyramid: coarser levels of the heights (attributes/pyramid.py), if computed.
        results: for light, occlusion and previews, by kind.
        anchored: the field with the anchor that was requested last.
    """

    surfaces: dict[SurfaceSpec, "HeightField"] = field(default_factory=dict)
    expanded: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)
    pyramid: list[np.ndarray] = field(default_factory=list)
    results: dict[tuple, object] = field(default_factory=dict)
    anchored: dict[tuple[float, float], "HeightField"] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class HeightRaster:
    """Samples on their lattice and their origin; arrays may be memory-mapped and are never written.

    Attributes:
        samples: [height, width], row 0 south, column 0 west: float32 metres, or uint16 numbers of `steps` (codes.py).
        digest: identifies the heights and their bounds: rasters with equal digests have equal surfaces.
        filled: number of missing samples that were filled.
        valid: None or, if holes are cut out, uint8 [height, width], 0 at missing samples; cells with such a corner are
            holes (holes.py).
        layers: by-products of height operators, by name: float32 [height, width], row 0 south.
        origin: float64 [3], CRS coordinates of the local origin.
        place: from the terrain's space to the CRS, see georeference.py; None without a geotransform and in stores of
            older versions.
        provenance: record of the source, with which an import can be repeated.
        path: the store's folder, None for a raster in memory.
        finer: tiles with heights at a fraction of the step (finer_tiles.py), None without any.
        cache: empty in a copy that `replace` has made.
    """

    samples: np.ndarray
    lattice: Lattice
    digest: str
    steps: codes.Steps | None = None
    filled: int = 0
    valid: np.ndarray | None = None
    layers: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    crs: str = ""
    place: Place | None = None
    provenance: dict = field(default_factory=dict)
    path: Path | None = None
    finer: "FinerTiles | None" = field(default=None, repr=False)
    cache: FieldCache = field(default_factory=FieldCache, repr=False, init=False)

    def heights(self, *index: int | slice | np.ndarray) -> np.ndarray:
        """Return samples[index], or all of them, in float32 metres: a view if samples are float32 and index slices."""
        samples = self.samples[index]
        return samples if self.steps is None else self.steps.heights(samples)

    @property
    def known_place(self) -> Place | None:
        """Return the affine map from the terrain's space to its CRS; None if a raster with a CRS does not have it.

        Without a CRS the map gives metres from the origin.
        """
        return known_place(self.place, self.crs, self.origin)

    def damage(self, what: str) -> TerrainError:
        """Return the error for arrays that no import has written. what: clause about the fault."""
        name = f"The store {self.path}" if self.path else "The height field"
        return TerrainError(f"{name} is damaged ({what})", fix="import it again")

    def check_samples(self) -> None:
        """Raise TerrainError if a sample or a height of a finer tile is not finite. 16-bit samples always are.

        This reads all others, so only slower code should call it.
        """
        arrays = [*([self.samples] if self.steps is None else []), *([self.finer.heights] if self.finer else [])]
        if not all(map(all_finite, arrays)):
            raise self.damage("it has heights that are not finite")


@dataclass(frozen=True, eq=False)
class HeightField:
    """A terrain ready for refinement: a raster, a surface through its samples, and that surface's error hierarchy.

    Attributes:
        error: uint8 [lattice.node_count], codes of the saturated errors of all diamonds (hierarchy.py) in the order of
            lattice.py, without the detail; curvatures of a bicubic surface follow (bicubic.py).
        exponents: powers of two that multiply the table of codes for each group of depths (codes.py).
        ranges: uint16 [lattice.range_count, 2] of diamonds of 4 x 4 cells and more, without the detail: heights from
            range_base + q * range_step metres; for a bicubic surface those of the raster's cells follow.
        min_height, max_height: limits of the surface outside of holes, metres, with the detail.
        steepest_x, steepest_y: largest slopes of the surface along each axis, with finer tiles and without the detail.
        source_max: largest distance, metres, by which the rounding of the source has moved the surface.
        bicubic_finer: the finer tiles of a bicubic surface (finer_bicubic.py).
    """

    raster: HeightRaster
    error: Paged
    exponents: list[int]
    ranges: Paged
    range_base: float
    range_step: float
    min_height: float
    max_height: float
    steepest_x: float
    steepest_y: float
    source_max: float = 0.0
    surface: SurfaceSpec = SurfaceSpec()
    bicubic_finer: "FinerTiles | None" = field(default=None, repr=False)

    samples = property(attrgetter("raster.samples"))
    steps = property(attrgetter("raster.steps"))
    filled = property(attrgetter("raster.filled"))
    valid = property(attrgetter("raster.valid"))
    layers = property(attrgetter("raster.layers"))
    origin = property(attrgetter("raster.origin"))
    crs = property(attrgetter("raster.crs"))
    provenance = property(attrgetter("raster.provenance"))
    path = property(attrgetter("raster.path"))
    cache = property(attrgetter("raster.cache"))
    interpolation = property(attrgetter("surface.interpolation"))
    detail = property(attrgetter("surface.detail"))

    def __repr__(self) -> str:
        lattice, surface = self.lattice, f"{self.interpolation} with detail" if self.detail else self.interpolation
        heights = f"{self.min_height:g} .. {self.max_height:g} m"
        return f"<HeightField: {lattice.width:,} x {lattice.height:,} samples, {heights}, {surface}>"

    @property
    def lattice(self) -> Lattice:
        """Return the lattice of the samples."""
        return self.raster.lattice

    @cached_property
    def key(self) -> FieldKey:
        """Return the identity of the field: content of the raster, interpolation, displacement and anchor."""
        anchor = self.lattice.anchor_x, self.lattice.anchor_y
        return FieldKey(self.raster.digest, self.interpolation, self.detail.key if self.detail else "", anchor)

    @property
    def finest_edge(self) -> float:
        """Return the shortest edge, metres, that float32 plane coordinates of the mesh can hold."""
        lattice = self.lattice
        bits = PLANE_BITS - lattice.side_bits - lattice.levels
        return min(lattice.step_x, lattice.step_y) * 2.0**-bits

    @cached_property
    def packed_detail(self) -> "PackedLayers | None":
        """Return the displacement as kernels read it; None without one."""
        return pack_layers(self.detail, self.finest_edge, self.lattice) if self.detail else None

    @property
    def parts(self) -> list[DetailTerm]:
        """Return the summands of the displacement, from which bounds are computed; none without a displacement."""
        return bound_terms(self.detail, self.finest_edge, self.lattice)

    @property
    def finer(self) -> "FinerTiles | None":
        """Return the finer tiles of this surface, whose change is that of the surface between samples; None if none."""
        return self.bicubic_finer or self.raster.finer

    @property
    def max_change(self) -> float:
        """Return the largest height of the displacement, with the change of finer tiles, metres."""
        return highest(self.parts) + (self.finer.max_change if self.finer else 0.0)

    @property
    def table(self) -> np.ndarray:
        """Return the metres of all error codes, float32 [parts, 256]: a row for each of `codes.parts`."""
        return codes.tables(self.exponents)

    def heights(self, *index: int | slice | np.ndarray) -> np.ndarray:
        """Return samples[index], or all of them, in float32 metres."""
        return self.raster.heights(*index)

    def with_raster(self, **changes: Any) -> "HeightField":
        """Return the same surface of a raster with other attributes (`changes`) and an empty cache."""
        return replace(self, raster=replace(self.raster, **changes))


def anchored(field: HeightField, x: float, y: float) -> HeightField:
    """Return the same surface in a space whose origin is (x, y), metres from the raster's middle: the anchor.

    For (0, 0) it is `field`. Positions become float32 relative to the anchor, so they are exact near it. Samples and
    errors are shared; only the last result is cached. field: without an anchor and without detail. Raises TerrainError
    if the anchor is outside of the raster or its CRS coordinates are unknown.
    """
    if not (x or y):
        return field
    with caching:
        if (x, y) not in field.cache.anchored:
            raster, lattice = field.raster, replace(field.lattice, anchor_x=x, anchor_y=y)
            west, south, east, north = lattice.rectangle()  # sides of the raster, metres from the anchor
            if not (west <= 0.0 <= east and south <= 0.0 <= north):  # coordinates at its far end would be too coarse
                raise TerrainError(
                    f"The anchor ({x:g}, {y:g}) is outside of the terrain",
                    expected="metres from its middle",
                    fix="choose one on it; in Blender press Move World Here",
                )
            if raster.known_place is None:
                raise TerrainError(
                    f"The store {raster.path} does not record its place, so its origin cannot be moved",
                    fix="import it again",
                )
            place = move_place(raster.known_place, x, y)
            origin = np.array([place[2], place[5], raster.origin[2]])  # CRS coordinates of the anchor
            field.cache.anchored.clear()
            field.cache.anchored[x, y] = field.with_raster(lattice=lattice, origin=origin, place=place)
        return field.cache.anchored[x, y]


def with_detail(field: HeightField, detail: Ground | None) -> HeightField:
    """Return the same surface with another detail or none. Arrays are shared, nothing is read.

    A detail without amplitude counts as none. MAX_DETAILED results are cached. field: if it has a detail, it is a
    result of this function or `interpolated`, whose cache has the surface without one.
    """
    surfaces = field.cache.surfaces
    plain = surfaces[SurfaceSpec(field.interpolation)] if field.detail else field
    if detail is None or not detail.amplitude:
        return plain
    wanted = SurfaceSpec(field.interpolation, detail)
    with caching:
        surface = surfaces.pop(wanted, None)  # to be put back last: the order is that of use
        if surface is None:
            displacement = highest(bound_terms(detail, plain.finest_edge, plain.lattice))  # metres, at most
            low, high = plain.min_height - displacement, plain.max_height + displacement
            surface = replace(plain, surface=wanted, min_height=low, max_height=high)
            surfaces.setdefault(plain.surface, plain)  # from which later calls get it
        surfaces[wanted] = surface
        for spec in [spec for spec in surfaces if spec.detail][:-MAX_DETAILED]:
            del surfaces[spec]
        return surface


def check_field(field: object) -> None:
    """Raise TerrainError unless a caller's height field is one, as for the path of a store."""
    check_kind(field, HeightField, "The height field", "one that open_store returns")
