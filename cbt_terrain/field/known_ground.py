# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a terrain whose heights come from its source: all but holes and filled gaps.

A store marks the samples of holes. Of filled samples it has the number alone. But where all files of a mosaic with wide
gaps have finer tiles (mosaic/finer_plan.py), these show where its files are.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .finer_tiles import SIDE, has_known
from .heightfield import LOADED, HeightField


@dataclass(frozen=True, eq=False)
class KnownTiles:
    """The tiles that files of a mosaic with wide gaps meet.

    Attributes:
        is_known: bool [rows, columns], row 0 south, whether a file meets the tile.
        size: metres of a tile along x and y.
    """

    is_known: np.ndarray
    size: tuple[float, float]

    def meets(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return whether rectangles meet a known tile, bool [n].

        low, high: float64 [n, 2], their south-western and north-eastern corners, metres from that of the raster.
        """
        counts, last = self._counts, np.array(self.is_known.shape[::-1]) - 1  # last column and row
        first_tile, last_tile = (np.clip(np.floor(corner / self.size), 0, last).astype(int) for corner in (low, high))
        (west, south), (east, north) = first_tile.T, last_tile.T + 1
        return counts[north, east] - counts[south, east] - counts[north, west] + counts[south, west] > 0

    @cached_property
    def _counts(self) -> np.ndarray:
        """Return the number of known tiles south and west of each corner of tiles, int32 [rows + 1, columns + 1]."""
        return np.pad(self.is_known.astype(np.int32).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))


def ground_fraction(field: HeightField) -> float:
    """Return the fraction of a raster that has ground: all but holes and wide gaps, also filled ones.

    Other filled samples count as ground, because nothing tells where they are. Above 0 and at most 1.
    """
    if field.valid is None and known_tiles_of(field) is None:
        return 1.0
    count = field.lattice.width * field.lattice.height
    return max(count - field.filled, 1) / count


def known_tiles_of(field: HeightField) -> KnownTiles | None:
    """Return the tiles with known heights of a mosaic with wide gaps; None for any other field.

    In such a mosaic no height outside of these tiles is known. So there are at least as many filled samples as there
    are samples outside. An incomplete import may lack tiles, so None is returned for it.
    """
    finer, lattice = field.raster.finer, field.lattice
    if finer is None or not field.filled or LOADED in field.provenance:
        return None
    is_known = has_known(finer.numbers)
    known = lattice.width * lattice.height - field.filled
    if known > int(is_known.sum()) * (SIDE >> finer.bits) ** 2:  # the samples in known tiles, those of the border too
        return None
    cells = SIDE >> finer.bits  # of the raster along a tile
    return KnownTiles(is_known, (cells * lattice.step_x, cells * lattice.step_y))


def is_in_gap(field: HeightField, positions: np.ndarray) -> np.ndarray:
    """Return whether positions on the raster are in a filled gap of a mosaic with wide gaps, bool [n].

    Near the files it is known to one tile. False everywhere for other fields. positions: float64 [n, 2], metres in the
    terrain's space.
    """
    tiles, corner = known_tiles_of(field), field.lattice.rectangle()[:2]
    if tiles is None:
        return np.zeros(len(positions), bool)
    from_corner = np.asarray(positions, np.float64) - corner
    return ~tiles.meets(from_corner, from_corner)


def known_samples(field: HeightField) -> np.ndarray | None:
    """Return the marks of samples with ground: uint8 [height, width], 0 in holes and in wide gaps, filled ones too.

    None if all of them have ground, or if nothing tells where heights were filled.
    """
    if field.valid is not None:
        return field.valid
    tiles, finer, lattice = known_tiles_of(field), field.raster.finer, field.lattice
    if tiles is None or finer is None:
        return None
    rows, columns = (np.arange(count) // (SIDE >> finer.bits) for count in (lattice.height, lattice.width))
    return tiles.is_known[rows][:, columns].astype(np.uint8)
