# SPDX-License-Identifier: GPL-3.0-or-later
"""Details with masks: coats of a terrain, each a detail times how much of it lies where. They are added up.

A mask has a byte for every sample of the raster, 255 for all, and is bilinear in between.
"""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import warp as wp

from ...kernels.field import detail as kernels
from ..ask.linear import add_up
from ..errors import TerrainError
from ..run.buffers import flat
from .blocks import halvings
from .detail import Detail
from .detail_bounds import Part, masked, tables
from .lattice import Lattice
from .tiled import Tiled

# All, in the bytes of a mask.
ALL = 255
ROUNDING = np.float32(1.0 + 2.0**-19)  # above what a sum of a dozen float32 rounds


@dataclass(frozen=True, eq=True)
class Mask:
    """`values`: uint8 [height, width], one for each sample; `digest`: equal for equal ones."""

    values: np.ndarray = field(compare=False, repr=False)
    digest: str = ""

    def __post_init__(self):
        values = np.ascontiguousarray(self.values, np.uint8)
        object.__setattr__(self, "values", values)
        content = repr(values.shape).encode() + values.data
        object.__setattr__(self, "digest", hashlib.blake2b(content, digest_size=16).hexdigest())

    @cached_property
    def most(self) -> np.ndarray:
        """uint8 [n]: the most of each cell, and of 2 x 2 of those, and so on to one of all; row by row, level by level,
        as `mask_levels` has them."""
        v = self.values
        cells = np.maximum(np.maximum(v[1:, 1:], v[1:, :-1]), np.maximum(v[:-1, 1:], v[:-1, :-1]))
        return np.concatenate([level.reshape(-1) for level in halvings(cells, np.maximum)])


@dataclass(frozen=True)
class Coat:
    """A detail, all over the terrain or where its mask is."""

    detail: Detail | Tiled
    mask: Mask | None = None


@dataclass(frozen=True)
class Coats:
    """Details that are added up; those with a mask last."""

    coats: tuple[Coat, ...]

    @property
    def amplitude(self) -> float:
        """Metres that they rise or fall together, at most."""
        return add_up(coat.detail.amplitude for coat in self.coats)

    @property
    def key(self) -> str:
        """Equal for equal coats."""
        text = repr([(coat.detail.key, coat.mask and coat.mask.digest) for coat in self.coats])
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


Ground = Detail | Tiled | Coats


def coats_of(ground: Ground | None) -> tuple[Coat, ...]:
    """The coats, those without a mask first."""
    coats = ground.coats if isinstance(ground, Coats) else (Coat(ground),) if ground else ()
    return tuple(sorted(coats, key=lambda coat: coat.mask is not None))


def parts_of(ground: Ground | None, finest: float, lattice: Lattice) -> list[Part]:
    """All that bounds are taken of; `finest`: metres of the shortest edges."""
    return [part for group in _groups(ground, finest, lattice) for part in group]


def _groups(ground: Ground | None, finest: float, lattice: Lattice) -> list[list[Part]]:
    """Of all coats without a mask together, and of each with one."""
    coats = coats_of(ground)
    everywhere = [part for coat in coats if coat.mask is None for part in coat.detail.parts(finest)]
    steps = lattice.step_x, lattice.step_y
    return [everywhere, *(masked(coat.detail.parts(finest), steps) for coat in coats if coat.mask is not None)]


def coat_tables(ground: Ground | None, finest: float, lattice: Lattice, meshlet: int) -> np.ndarray:
    """float32 [1 + masks, 64, 2] metres: `tables` of what has no mask, and those of each with a mask for one of its
    255 parts; but what edges climb, which is all in the first."""
    steps, cell = (lattice.step_x, lattice.step_y), 2 * lattice.levels + 1
    first, *others = _groups(ground, finest, lattice)
    found = [tables(first, steps, lattice.levels, meshlet)]
    for parts in others:
        table = tables(parts, steps, lattice.levels, meshlet, smooth_from=cell)
        found[0][:, 1] += table[:, 1]
        table[:, 0] *= np.float32(1.0 / ALL) * ROUNDING
        found.append(table)
    found[0][:, 1] *= ROUNDING if others else np.float32(1.0)
    return np.stack(found)


def mask_levels(lattice: Lattice) -> np.ndarray:
    """int64 [levels + 1]: where each level of `Mask.most` begins, and their number of entries."""
    columns, rows, first = lattice.width - 1, lattice.height - 1, [0]
    while True:
        first.append(first[-1] + columns * rows)
        if columns * rows <= 1:
            return np.array(first, np.int64)
        columns, rows = (columns + 1) // 2, (rows + 1) // 2


def most_of_masks(ground: Ground | None) -> np.ndarray:
    """uint8 [masks * entries]: `Mask.most` of each coat with a mask, in the order of `coat_tables`."""
    most = [coat.mask.most for coat in coats_of(ground) if coat.mask is not None]
    return most[0] if len(most) == 1 else np.concatenate([np.empty(0, np.uint8), *most])


def packed(ground: Ground | None, finest: float, lattice: Lattice) -> kernels.Coats:
    """As the kernels read them. Raises TerrainError for a mask of another raster."""
    coats, heights, masks, c = [], [], [], kernels.Coats()
    pixels = bytes_ = 0
    for coat in coats_of(ground):
        if isinstance(coat.detail, Tiled):
            d, net = coat.detail.packed(finest)
            d.pixel, pixels = pixels, pixels + net.size
            heights.append(net.reshape(-1))
        else:
            d = coat.detail.packed(finest)
        d.masked = int(coat.mask is not None)
        if coat.mask is not None:
            expected = lattice.height, lattice.width
            if coat.mask.values.shape != expected:
                raise TerrainError(
                    f"A mask of detail has the shape {coat.mask.values.shape}; expected {expected}, as the height map."
                )
            d.mask, bytes_ = bytes_, bytes_ + coat.mask.values.size
            masks.append(coat.mask.values.reshape(-1))
        coats.append(d)
    c.count, c.coat = len(coats), wp.array(coats, dtype=kernels.Detail, device="cpu")
    c.pixels = flat(np.concatenate([np.empty(0, np.float32), *heights]), wp.float32)
    c.masks = flat(masks[0] if len(masks) == 1 else np.concatenate([np.empty(0, np.uint8), *masks]), wp.uint8)
    c.columns, c.rows = lattice.width, lattice.height
    c.west, c.south, _, _ = lattice.rectangle()
    c.per_x, c.per_y = 1.0 / lattice.step_x, 1.0 / lattice.step_y
    return c
