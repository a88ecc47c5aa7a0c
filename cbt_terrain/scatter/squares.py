# SPDX-License-Identifier: GPL-3.0-or-later
"""The squares of the plan whose points views may show, and the number of points of each.

`squares_in_view` walks a quadtree over the plan: in its middle are tiles, above them squares of 2 x 2 tiles and so on,
below them the parts of tiles. A square is not divided if it needs few points, or if its density is about constant. From
a tile down, a square shows a window, a part of the one set of ranked points that all tiles repeat (tile.py). A point's
rank is its number in the order in which the points of a tile appear as the density grows.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.field.layout import Depth
from ...kernels.scatter import squares as kernels
from ...kernels.scatter.points import GROWING
from ...kernels.scatter.seen import Views
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.hierarchy import ranges_at
from ..field.known_ground import KnownTiles
from ..run import launch
from ..run.buffers import shared
from .tile import FINEST, POINTS, shifts, tile

FEW = 64  # points of a square that is not divided
EVEN = 1.5  # largest ratio of the densities of a square that is not divided
MAX_CANDIDATES = 1 << 26  # 3.4 GB
MAX_DIVIDED = MAX_CANDIDATES // (4 * FEW)  # squares of one size; each has more points than FEW
QUARTERS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.int32)  # of a square, column and row
# The fields of `Squares` without a square, so that there is something to concatenate.
NOTHING = np.empty(0, np.int32), np.empty((0, 2), np.int32), np.empty(0, np.int64), np.empty(0, bool)


@dataclass(frozen=True)
class Squares:
    """Squares of the plan.

    `halvings`: int32 [n], of the tile's side. `number`: int32 [n, 2], column and row among the squares of that size,
    from tile (0, 0) on. `count`: int64 [n], number of points, of the lowest ranks, that views may show. `clear`: bool
    [n], whether it is completely inside a frame.
    """

    halvings: np.ndarray
    number: np.ndarray
    count: np.ndarray
    clear: np.ndarray

    def of_tile(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the tile of each square, int32 [n, 2], and the number of its window, int64 [n]."""
        tiles = self.number >> self.halvings[:, None]
        inside = self.number & ((1 << self.halvings) - 1)[:, None]
        return tiles, tile().windows(self.halvings, inside, shifts(tiles, seed))


def too_many_error(count: str, expected: str = "") -> TerrainError:
    """Return the error for too many points in view. count: text for their number."""
    fix = "increase its spacing, or let its full density end nearer to the camera (Full Until; at 0 it never ends)"
    return TerrainError(f"The scatter has {count} points in view", expected=expected, fix=fix)


def squares_in_view(
    field: HeightField,
    domain: Domain,
    views: Views,
    west: float,
    south: float,
    side: float,
    seed: int,
    max_density: float,
    threads: int,
    tiles_with_ground: KnownTiles | None = None,
) -> Squares:
    """Return the squares of the plan that views may show, for tiles of `side` metres.

    The south-western corner of tile (0, 0) is at `west`, `south`. seed: selects each tile's shift of the pattern.
    max_density: of the points, 0 .. 1, as a fraction of those of a tile. tiles_with_ground: tiles that
    hold all points; None if these may be anywhere. Raises TerrainError for more than MAX_CANDIDATES points.
    """
    raster_west, raster_south, east, north = field.lattice.rectangle()
    # The raster's corners in tiles from the corner of tile (0, 0).
    begin, end = (np.array([x - west, y - south]) / side for x, y in ((raster_west, raster_south), (east, north)))
    tiles = max(1.0, *(end - np.floor(begin)))
    halvings = -max(0, int(np.ceil(np.log2(tiles))))  # below 0: a square of 2^-halvings tiles a side
    first, last = np.floor(begin * 2.0**halvings).astype(int), np.ceil(end * 2.0**halvings).astype(int)
    roots = np.meshgrid(*(np.arange(i, max(i + 1, j), dtype=np.int32) for i, j in zip(first, last, strict=True)))
    # Squares of this size to look at; fields of `Squares`.
    numbers, final_squares = np.stack(roots, axis=-1).reshape(-1, 2), []
    while len(numbers):
        if tiles_with_ground is not None:
            low_corners = numbers * (side * 2.0**-halvings) + (west - raster_west, south - raster_south)
            numbers = numbers[tiles_with_ground.meets(low_corners, low_corners + side * 2.0**-halvings)]
        density_range = np.empty((len(numbers), 2))
        packed = _pack_squares(field, west, south, side * 2.0**-halvings)
        arrays = [shared(numbers, wp.vec2i), wp.array(density_range, dtype=wp.vec2d, device=launch.DEVICE, copy=False)]
        # Writes an upper and a lower bound of the density in each square, 0 .. 1; 0 outside of all frames.
        inputs = [domain, views, packed, wp.float64(east), wp.float64(north), *arrays]
        launch.spread(kernels.density_range, len(numbers), inputs, step="squares", threads=threads, cost=10.0)
        high, low = density_range.T
        # Points have ranks: the lowest ones stay where the density is low. A point has a size above 0 where
        # (rank + 1/2) / POINTS < GROWING * density; 1e-6 covers rounding.
        limit = high * max_density * (float(GROWING) * (1 + 1e-6))
        ranks = np.minimum(np.ceil(limit * POINTS - 0.5), POINTS).astype(np.int64)  # those below the limit
        divided = ranks > 0  # squares without points are dropped
        # From a tile down, a square is final if it has few points, an even density or the smallest size.
        if halvings >= 0:
            depth = np.full(len(numbers), halvings, np.int32)
            _, windows = Squares(depth, numbers, ranks, divided).of_tile(seed)
            count = tile().count(halvings, windows, ranks)  # points of the square that have these ranks
            divided &= (count > FEW) & (high > EVEN * low) & (halvings < FINEST)
            final = ~divided & (count > 0)
            clear = low[final] > 0  # completely inside a frame
            final_squares.append((depth[final], numbers[final], count[final], clear))
        if divided.sum() > MAX_DIVIDED:
            raise too_many_error(f"more than {MAX_CANDIDATES:,}")
        numbers = (2 * numbers[divided][:, None] + QUARTERS).reshape(-1, 2)
        halvings += 1
    squares = Squares(*map(np.concatenate, zip(NOTHING, *final_squares, strict=True)))
    if squares.count.sum() > MAX_CANDIDATES:
        raise too_many_error(f"more than {MAX_CANDIDATES:,}")
    return squares


def _pack_squares(field: HeightField, west: float, south: float, side: float) -> kernels.ScatterSquares:
    """Return squares of a size as kernels read them, with ranges of heights.

    The ranges are of the smallest lattice cells that are as large as a square; larger squares than the root squares
    have that of the whole surface. west, south: corner of square 0, metres. side: metres.
    """
    lattice, q = field.lattice, kernels.ScatterSquares()
    q.west, q.south, q.side, q.low, q.high = west, south, side, field.min_height, field.max_height
    cells = max(side / min(lattice.step_x, lattice.step_y), 4.0)  # ranges are of 4 x 4 cells and more
    doublings = int(np.ceil(np.log2(cells * (1 + 1e-9))))  # of a cell's side to that of the cells with ranges
    q.ranges = Depth()  # empty: kernels use `low` and `high`
    if doublings <= lattice.levels:
        q.ranges = ranges_at(lattice, 2 * (lattice.levels - doublings) + 1)  # two bisections halve a side
        q.cell_x, q.cell_y = lattice.step_x * 2.0**doublings, lattice.step_y * 2.0**doublings
    return q
