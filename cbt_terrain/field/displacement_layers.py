# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement layers of a terrain: sums of details, each multiplied by an optional mask.

A mask has a byte for every sample of the raster, where 255 is all of the detail, and is bilinear in between.
"""

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..errors import TerrainError
from ..run.buffers import flat, shared
from ..view.linear import add_up
from .blocks import fill_levels, level_shapes
from .detail import Detail
from .detail_bounds import DetailTerm, highest, masked_terms, tables
from .digests import digest_of
from .lattice import Lattice
from .tiled import Tiled

if TYPE_CHECKING:
    from ...kernels.field import detail as kernels
    from ...kernels.field.domain import Domain

ALL = 255  # byte of a mask where the detail has its full height
ROUNDING = np.float32(1.0 + 2.0**-19)  # exceeds the rounding of a sum of a dozen float32


@dataclass(frozen=True, eq=True)
class LayerMask:
    """Weight of a displacement layer.

    Attributes:
        values: uint8 [height, width], one a sample.
        max_cells: their maximum of each cell, of 2 x 2 cells, and so on, uint8 [n], in the order of `mask_levels`;
            computed if it is empty, otherwise trusted.
        digest: identifies the values.
    """

    values: np.ndarray = field(compare=False, repr=False)
    max_cells: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8), compare=False, repr=False)
    digest: str = ""

    def __post_init__(self) -> None:
        """Convert the values to uint8 in C order, and compute the digest and the maxima."""
        values = np.ascontiguousarray(self.values, np.uint8)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "digest", digest_of([values], repr(values.shape)))
        if not self.max_cells.size:
            count = sum(int(rows * columns) for rows, columns in level_shapes(*cells_of(values)))
            object.__setattr__(self, "max_cells", np.empty(count, np.uint8))
            fill_max_cells(values, self.max_cells)


def cells_of(values: np.ndarray) -> tuple[int, int]:
    """Return rows and columns of the cells between the samples of a mask."""
    return values.shape[0] - 1, values.shape[1] - 1


def fill_max_cells(values: np.ndarray, max_cells: np.ndarray) -> None:
    """Fill `max_cells`, uint8 [entries], with the maxima of a mask: of each cell, of 2 x 2 cells, and so on to all.

    values: of the mask, uint8 [height, width].
    """

    def finest(rows: slice) -> np.ndarray:
        """Return the maxima of some rows of cells."""
        v = values[rows.start : rows.stop + 1]
        return np.maximum(np.maximum(v[1:, 1:], v[1:, :-1]), np.maximum(v[:-1, 1:], v[:-1, :-1]))

    fill_levels(max_cells, *cells_of(values), np.maximum, finest)


@dataclass(frozen=True)
class DisplacementLayer:
    """A displacement layer: a detail, everywhere or weighted by a mask."""

    detail: Detail | Tiled
    mask: LayerMask | None = None


@dataclass(frozen=True)
class DisplacementLayers:
    """The sum of displacement layers; those with a mask come last."""

    layers: tuple[DisplacementLayer, ...]

    @property
    def amplitude(self) -> float:
        """Return the largest magnitude of the sum, metres."""
        return add_up(layer.detail.amplitude for layer in self.layers)

    @property
    def key(self) -> str:
        """Return a hex digest of the layers and their masks, by which surfaces and results are cached."""
        text = repr([(layer.detail.key, layer.mask and layer.mask.digest) for layer in self.layers])
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


Ground = Detail | Tiled | DisplacementLayers


def layers_below(ground: Ground | None) -> tuple[DisplacementLayer, ...]:
    """Return a displacement as layers, those without a mask first.

    ground: a Detail, a Tiled, layers of them, or None.
    """
    layers = ground.layers if isinstance(ground, DisplacementLayers) else (DisplacementLayer(ground),) if ground else ()
    return tuple(sorted(layers, key=lambda layer: layer.mask is not None))


def bound_terms(ground: Ground | None, finest: float, lattice: Lattice) -> list[DetailTerm]:
    """Return all layers' summands, from which bounds are computed. finest: metres of the shortest edges of meshes."""
    return [part for group in _groups(ground, finest, lattice) for part in group]


def _groups(ground: Ground | None, finest: float, lattice: Lattice) -> list[list[DetailTerm]]:
    """Return the summands of all layers without a mask, then those of each layer with one.

    finest: shortest edge of a mesh, metres; waves that it cannot resolve are left out. ground: a displacement, layers
    of it, or None.
    """
    layers = layers_below(ground)
    everywhere = [part for layer in layers if layer.mask is None for part in layer.detail.parts(finest)]
    steps = lattice.step_x, lattice.step_y
    return [
        everywhere,
        # Bounds that include the slope of a mask, which is bilinear in cells of the size `steps`.
        *(masked_terms(layer.detail.parts(finest), steps) for layer in layers if layer.mask is not None),
    ]


def layer_tables(ground: Ground | None, finest: float, lattice: Lattice, meshlet: int) -> np.ndarray:
    """Return a table of bounds for all layers without a mask together, then one for each layer with a mask.

    The result is float32 [1 + masks, 64, 2] metres, for each depth of a leaf: the largest distance between the
    displacement and the drawn triangles, and its largest difference between the leaf's corners. Distances in a mask's
    table are for a mask of 1; kernels multiply them by the largest value of the mask there, at most 255. The first
    table has the differences of all layers together, at masks of 255; those in the other tables are not used. finest:
    shortest edge of a mesh, metres. meshlet: leaves are drawn as 4**meshlet triangles.
    """
    steps, half_cell_depth = (lattice.step_x, lattice.step_y), 2 * lattice.levels + 1
    first, *others = _groups(ground, finest, lattice)
    bounds = [tables(first, steps, lattice.levels, meshlet)]
    for parts in others:  # table: [depth, distance and difference] at a mask of 255
        table = tables(parts, steps, lattice.levels, meshlet, smooth_from=half_cell_depth)
        bounds[0][:, 1] += table[:, 1]
        table[:, 0] *= np.float32(1.0 / ALL) * ROUNDING  # for a mask of 1, slightly up
        bounds.append(table)
    bounds[0][:, 1] *= ROUNDING if others else np.float32(1.0)
    return np.stack(bounds)


def mask_levels(lattice: Lattice) -> np.ndarray:
    """Return the first entry of each level of `LayerMask.max_cells`, and the number of entries, int64 [levels + 1]."""
    shapes = level_shapes(lattice.cells_y, lattice.cells_x)
    return np.cumsum([0, *(rows * columns for rows, columns in shapes)], dtype=np.int64)


def max_of_masks(ground: Ground | None) -> np.ndarray:
    """Return `LayerMask.max_cells` of the layers with masks, ordered as in `layer_tables`, uint8 [masks * entries]."""
    return _joined([layer.mask.max_cells for layer in layers_below(ground) if layer.mask is not None])


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    """Return arrays of uint8 as one flat array: without a copy if they are neighbours in the memory of one array.

    Masks of a large raster are, since one file of its store has them all.
    """
    if not arrays:
        return np.empty(0, np.uint8)
    first, ends = arrays[0], [array.ctypes.data + array.nbytes for array in arrays]
    follow = all(end == array.ctypes.data for end, array in zip(ends, arrays[1:], strict=False))
    if len(arrays) == 1 or (follow and all(array.base is first.base is not None for array in arrays)):
        return np.lib.stride_tricks.as_strided(first.reshape(-1), (ends[-1] - first.ctypes.data,), (1,))
    return np.concatenate([array.reshape(-1) for array in arrays])


def fill_layers(domain: "Domain", ground: Ground | None, finest: float, lattice: Lattice, meshlet: int) -> None:
    """Fill in the fields of `domain` that bound the displacement of the layers.

    finest: metres of the shortest edges. meshlet: each leaf is drawn as 4**meshlet triangles. ground: a displacement,
    layers of it, or None.
    """
    from ...kernels import wp

    # levels: the first entry of each level of a mask's maxima, and their end
    parts, levels = bound_terms(ground, finest, lattice), mask_levels(lattice)
    domain.detailed, domain.max_detail = int(bool(parts)), highest(parts)
    domain.detail = shared(layer_tables(ground, finest, lattice, meshlet).reshape(-1, 2), wp.vec2f)
    domain.masked = sum(int(layer.mask is not None) for layer in layers_below(ground))
    # Maxima of each mask over blocks of cells: a pyramid, with the first entry of each level and the last level.
    domain.mask_max, domain.mask_top = flat(max_of_masks(ground), wp.uint8), len(levels) - 2
    domain.mask_first = shared(levels, wp.int64)


def pack_layers(ground: Ground | None, finest: float, lattice: Lattice) -> "kernels.PackedLayers":
    """Return the layers as kernels read them.

    finest: metres of the shortest edges. Raises TerrainError for a mask of another raster. ground: a displacement,
    layers of it, or None.
    """
    from ...kernels import wp
    from ...kernels.field import detail as kernels

    layers, heights, masks, packed = [], [], [], kernels.PackedLayers()
    num_pixels = num_mask_bytes = 0  # of the layers so far: where the next one begins in the joint arrays
    for layer in layers_below(ground):
        if isinstance(layer.detail, Tiled):  # a repeated image: its control heights are float32 from -1 to 1
            packed_layer, control_heights = layer.detail.packed(finest)
            packed_layer.pixel, num_pixels = num_pixels, num_pixels + control_heights.size
            heights.append(control_heights.reshape(-1))
        else:
            packed_layer = layer.detail.packed(finest)
        packed_layer.masked = int(layer.mask is not None)
        if layer.mask is not None:
            expected = lattice.height, lattice.width
            if layer.mask.values.shape != expected:
                raise TerrainError(
                    f"A mask of displacement has the shape {layer.mask.values.shape}",
                    expected=f"{expected}, the shape of the height map",
                )
            packed_layer.mask, num_mask_bytes = num_mask_bytes, num_mask_bytes + layer.mask.values.size
            masks.append(layer.mask.values)
        layers.append(packed_layer)
    packed.count, packed.layer = len(layers), wp.array(layers, dtype=kernels.PackedDetail, device="cpu")
    packed.pixels = flat(np.concatenate([np.empty(0, np.float32), *heights]), wp.float32)
    packed.masks = flat(_joined(masks), wp.uint8)
    packed.columns, packed.rows = lattice.width, lattice.height
    # The origin of the terrain's space, metres from the raster's middle.
    packed.anchor_x, packed.anchor_y = lattice.anchor_x, lattice.anchor_y
    # The raster's south-western corner from its middle, metres, and the cells in a metre.
    packed.west, packed.south = -0.5 * lattice.cells_x * lattice.step_x, -0.5 * lattice.cells_y * lattice.step_y
    packed.per_x, packed.per_y = 1.0 / lattice.step_x, 1.0 / lattice.step_y
    return packed
