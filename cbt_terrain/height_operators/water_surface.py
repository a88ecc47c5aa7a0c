# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of water as a mesh, cut at the shore, where the depth is 0.

Ground and water are linear along the sides of triangles, so that the shore is where the water level meets the ground.
A dry sample next to water gets the level of that water, below the ground. If the ground there is below the level of a
river, the sample gets a depth that ends the river half-way.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..field.heightfield import HeightField
from ..field.known_ground import known_samples
from ..field.lattice import Lattice, fit
from ..mesh.attributes import FACE, LEVEL, NORMALS, POINT, UV, Attribute
from ..mesh.cut import Side, cut
from ..mesh.surface import Surface
from ..view.linear import add_up
from .flat_floor import assumed_depth, level_floor, merge_cells
from .height_operator import OperatorGround
from .water import DEPTH, DISCHARGE, SPEED, STREAM, WATER

MAX_SAMPLES = 1025  # along a side of the raster that the surface is built from
NAMES = DEPTH.name, SPEED.name, DISCHARGE.name
MIN_DEPTH = 0.05  # metres
OVER_FLAT_SEA = 0.1  # metres: deep enough to show
# Largest difference in metres between the heights of one lake.
SAME = 1e-3
# Samples of the smallest piece of water. Pits of fewer samples cannot be told from the noise of elevation models: white
# noise of 2 m and of 5 m makes 15,000 and 41,000 pieces on the built-in mountains at 1,025 samples, 240 and 450 of them
# this large; without noise 160 of 1,830 are, with 98 % of the wet area.
MIN_SAMPLES = 9
# Rows that are read together.
ROWS = 256
# Shares of the ground: from which on ground below 0 m is a sea, and that inland water covers.
MIN_SEA, INLAND = 0.01, 0.05


def default_sea(field: HeightField) -> float:
    """Return a level of the sea in metres that shows water.

    It is 0 m at a coast, where at least a fraction MIN_SEA of the ground is at or below 0 m. Inland it floods the
    lowest fraction INLAND of the ground. Holes and wide gaps are no ground. If most ground at or below the level is at
    exactly this level, as where a file stores the sea as 0 or holds a lake's surface, it is OVER_FLAT_SEA higher.
    """
    valid = known_samples(field)
    count = field.samples.size if valid is None else np.count_nonzero(valid)
    ground, filled = np.empty(count, np.float32), 0  # `filled`: heights so far
    for first in range(0, field.lattice.height, ROWS):
        heights = field.heights(slice(first, first + ROWS)).reshape(-1)
        if valid is not None:
            heights = heights[valid[first : first + ROWS].reshape(-1) != 0]
        ground[filled : filled + heights.size] = heights
        filled += heights.size
    is_coast = np.count_nonzero(ground <= 0.0) >= MIN_SEA * count
    level = 0.0 if is_coast else float(np.quantile(ground, INLAND, overwrite_input=True))
    is_flat = 2 * np.count_nonzero(ground == level) > np.count_nonzero(ground <= level)
    return level + OVER_FLAT_SEA if is_flat else level


def water_of(field: HeightField, threads: int = 1, sea: float | None = None) -> Surface:
    """Return the surface of a height field's water layers, or of the *Water* operator if it has none or `sea` is given.

    sea: level of the operator's sea in metres, None for its default.
    A raster with more than MAX_SAMPLES along a side is reduced to every second sample, every fourth and so on.
    """
    stride = 1
    while (max(field.lattice.width, field.lattice.height) - 1) // stride >= MAX_SAMPLES:
        stride *= 2

    def thin_out(samples: np.ndarray) -> np.ndarray:
        """Return each `stride`-th sample along both axes."""
        return np.ascontiguousarray(samples[::stride, ::stride])

    every = slice(None, None, stride)
    lattice, heights = field.lattice, np.ascontiguousarray(field.heights(every, every))
    steps = lattice.step_x * stride, lattice.step_y * stride
    missing = None if field.valid is None else thin_out(field.valid) == 0
    if sea is None and DEPTH.name in field.layers:
        layers = {name: thin_out(field.layers[name]) for name in NAMES if name in field.layers}
    else:
        values = WATER.defaults() | ({} if sea is None else {"sea": sea})
        layers = WATER.apply(OperatorGround(heights, *steps, missing=missing, threads=threads), values, None).layers
    water_lattice = fit(heights.shape[1], heights.shape[0], *steps)  # of the reduced raster, about its middle
    water_lattice = replace(water_lattice, anchor_x=lattice.anchor_x, anchor_y=lattice.anchor_y)
    depth, speed, discharge = layers[NAMES[0]], layers.get(NAMES[1]), layers.get(NAMES[2])
    surface = water_surface(water_lattice, heights, depth, speed, discharge, missing, threads=threads)
    # Both lattices have their anchor about their middle, and the reduced one may end short of the field's border.
    offset = np.subtract(lattice.rectangle()[:2], water_lattice.rectangle()[:2])
    return replace(surface, positions=surface.positions + np.array([*offset, 0.0], np.float32))


def water_surface(
    lattice: Lattice,
    heights: np.ndarray,
    depth: np.ndarray,
    speed: np.ndarray | None = None,
    discharge: np.ndarray | None = None,
    missing: np.ndarray | None = None,
    min_depth: float = MIN_DEPTH,
    threads: int = 1,
) -> Surface:
    """Return the surface of water, with its depth and speed as attributes.

    Over level ground, which is the surface of a sea or lake and not its floor, the attribute has an assumed depth, and
    cells are merged to few triangles (flat_floor.py). Water is shown if it is `min_depth` deep or deeper and stands, or
    flows with STREAM or more, in connected pieces of MIN_SAMPLES or more. Each other cell with water at a corner gives
    two triangles, which are cut at the shore and face up. Without water the surface is empty. heights: of the ground;
    depth: of the water on it; both float32 [rows, columns], metres. speed, discharge: float32 of the same shape, m/s
    and m^3/s; without a discharge all water stands. missing: bool of that shape, holes that no triangle touches, or
    None. min_depth: metres.
    """
    wet = _shown(heights.astype(np.float64) + depth, depth, discharge, missing, min_depth)
    # signed_depth: negative at dry samples, where the water level is below the ground, so that the shore is at 0.
    signed_depth, water_height, wet = _extend_to_shore(heights, depth, wet, min_depth)
    floor, material_depth = level_floor(heights, signed_depth, wet), signed_depth
    if floor.any():
        material_depth = signed_depth + assumed_depth(floor, missing, lattice.step_x, lattice.step_y)
        corners, sides = _merged_triangles(floor, signed_depth, material_depth, wet, missing)
    else:
        corners, sides = _triangles(signed_depth, _cells_with_water(wet, missing))
    # Vertices are the samples at corners of triangles, numbered in the order of samples.
    used, vertex_numbers = _number_items(corners, heights.size)
    row, column = np.divmod(used, heights.shape[1])
    west, south, _, _ = lattice.rectangle()
    x, y = west + column * lattice.step_x, south + row * lattice.step_y
    positions = np.stack([x, y, water_height.ravel()[used]], axis=-1).astype(np.float32)
    uv = np.stack([column / (heights.shape[1] - 1), row / (heights.shape[0] - 1)], axis=-1).astype(np.float32)
    speeds = np.zeros(len(used), np.float32) if speed is None else np.where(wet, speed, 0.0).ravel()[used]
    attributes = {
        NORMALS: Attribute(np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(used), 1)), POINT),
        UV: Attribute(uv, POINT),
        "water_depth": Attribute(material_depth.ravel()[used].astype(np.float32), POINT, "m"),
        "water_speed": Attribute(speeds.astype(np.float32), POINT, "m/s"),
        LEVEL: Attribute(np.zeros(len(corners) // 3, np.int32), FACE),  # each surface has it; refinement, here 0
    }
    lines, line_numbers = _number_items(sides, 8 * heights.size)  # see `_triangles` and `_merged_triangles`
    ends = np.empty((len(lines), 2), np.int64)
    ends[line_numbers[sides]] = np.sort(_sides_of(corners), axis=1)
    surface = Surface(positions, vertex_numbers[corners], line_numbers[sides], vertex_numbers[ends], attributes)
    depths = signed_depth.ravel()[used]
    surface, _ = cut(surface, [Side(lambda _positions: depths)], threads=threads)  # keeps the side of positive depths
    replaced = {NORMALS: Attribute(_normals(surface), POINT)}
    for name in ("water_depth", "water_speed"):
        attribute = surface.attributes[name]
        replaced[name] = replace(attribute, array=np.maximum(attribute.array, 0.0))
    return surface.with_attributes(replaced)


def sea_depth(heights: np.ndarray, level: float) -> np.ndarray:
    """Return the depth of a sea of this level, float32 [rows, columns], metres."""
    return np.maximum(np.float32(level) - heights, np.float32(0.0))


def _shown(
    surface: np.ndarray, depth: np.ndarray, discharge: np.ndarray | None, missing: np.ndarray | None, min_depth: float
) -> np.ndarray:
    """Return the samples whose water is shown, bool [rows, columns].

    surface: height of the water's surface, float64 metres; the others as for `water_surface`; all [rows, columns].
    """
    wet = depth >= min_depth
    if discharge is not None:
        # Standing water is level with its neighbours, and in canals none is lower. A film on an even slope is level
        # with the two along the contour, and there are lower ones, such as beyond the border.
        num_level, has_lower = np.zeros(wet.shape, np.int8), np.zeros(wet.shape, bool)
        for other in _neighbours(np.where(wet, surface, np.inf), -np.inf):
            num_level += abs(other - surface) < SAME
            has_lower |= other < surface - SAME
        is_standing = wet & ((num_level > 2) | ((num_level > 0) & ~has_lower))
        wet = is_standing | ((discharge >= STREAM) & (depth > 0.0))
    if missing is not None:
        wet &= ~missing
    return _without_small_pieces(wet)


def _without_small_pieces(wet: np.ndarray) -> np.ndarray:
    """Return wet samples without connected pieces of fewer than MIN_SAMPLES, bool; wet: bool [rows, columns]."""
    dry = wet.size
    numbers = np.where(wet, np.arange(wet.size, dtype=np.int32).reshape(wet.shape), dry)
    # Each sample takes the lowest number around it. After MIN_SAMPLES - 1 rounds a small piece has one number and keeps
    # it. Of a larger piece, each number has MIN_SAMPLES samples or changes at one of them in the last round.
    for _ in range(MIN_SAMPLES):
        before = numbers
        for other in _neighbours(before, dry):
            numbers = np.minimum(numbers, other)
        numbers = np.where(wet, numbers, dry)
    is_large = np.bincount(before.ravel(), minlength=wet.size + 1) >= MIN_SAMPLES
    is_large[before[numbers != before]] = True
    return wet & is_large[before]


def _extend_to_shore(
    heights: np.ndarray, depth: np.ndarray, wet: np.ndarray, min_depth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Extend water to the dry samples next to it, the shore.

    Return its signed depth, negative at the shore, and the height of its surface, float64 [rows, columns] m, and the
    wet samples with the shallow borders of lakes, bool. heights, depth: metres. wet: bool, samples under water.
    min_depth: metres.
    """
    ground = heights.astype(np.float64)
    surface = ground + depth
    # Dry samples next to water, and the mean level of the water next to them.
    is_shore, near_level, _ = _shore(surface, depth, wet)
    # The shallow border of a lake belongs to it, so that its shore is where the ground comes out of the water.
    wet = wet | (is_shore & (depth > 0.0) & (ground < near_level) & (abs(surface - near_level) < SAME))
    is_shore, near_level, near_depth = _shore(surface, depth, wet)
    # How far the water's surface is below the ground at the shore: down to the level of the water nearby. Where the
    # ground is below that level, a shallow border ends between samples, and a river above its banks half-way. A border
    # is shallow if its own water, too thin to be wet, reaches the level nearby.
    is_shallow = surface >= near_level - min_depth
    below = np.where(near_level < ground, ground - near_level, np.where(is_shallow, near_level - ground, near_depth))
    signed = np.where(wet, depth, np.where(is_shore, -below, 0.0))
    return signed, np.where(wet, surface, ground + signed), wet


def _shore(surface: np.ndarray, depth: np.ndarray, wet: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the dry samples next to wet ones, and the mean surface and depth, metres, of their wet neighbours."""
    # Sums over the wet neighbours, and their number; the number is at least 1 in the means.
    level, depths, count = (_sum_neighbours(np.where(wet, array, 0.0)) for array in (surface, depth, 1.0))
    is_shore, count = ~wet & (count > 0), np.maximum(count, 1.0)
    return is_shore, level / count, depths / count


def _sum_neighbours(array: np.ndarray) -> np.ndarray:
    """Return the sum of the eight neighbours of each sample; samples beyond the border count as 0."""
    total = np.zeros_like(array)
    for other in _neighbours(array, 0.0):
        total += other
    return total


def _neighbours(array: np.ndarray, beyond: float) -> Iterator[np.ndarray]:
    """Yield for each of eight directions the neighbours of all samples in it; `beyond` the border, that value."""
    rows, columns = array.shape
    padded = np.pad(array, 1, constant_values=beyond)
    for dy in range(3):
        for dx in range(3):
            if (dy, dx) != (1, 1):
                yield padded[dy : dy + rows, dx : dx + columns]


# The sides of a cell's two triangles: first corner, counter-clockwise from the south-west, and direction. The diagonal
# goes from the south-west to the north-east, or from the south-east to the north-west.
EAST, NORTH, NORTH_EAST, NORTH_WEST = range(4)
SIDES_NORTH_EAST = ((0, EAST), (1, NORTH), (0, NORTH_EAST), (0, NORTH_EAST), (3, EAST), (0, NORTH))
SIDES_NORTH_WEST = ((0, EAST), (1, NORTH_WEST), (0, NORTH), (1, NORTH), (3, EAST), (1, NORTH_WEST))


def _cells_with_water(wet: np.ndarray, missing: np.ndarray | None) -> np.ndarray:
    """Return the cells with water at a corner and no hole, bool [rows - 1, columns - 1].

    wet: samples with water; missing: holes or None; both bool [rows, columns].
    """
    cells = wet[:-1, :-1] | wet[:-1, 1:] | wet[1:, :-1] | wet[1:, 1:]
    if missing is not None:
        cells &= ~(missing[:-1, :-1] | missing[:-1, 1:] | missing[1:, :-1] | missing[1:, 1:])
    return cells


def _merged_triangles(
    floor: np.ndarray, deep: np.ndarray, material_depth: np.ndarray, wet: np.ndarray, missing: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return corners and sides of triangles as `_triangles` does, where those over a level floor are merged.

    A side that is longer than those of cells has the number 4 * samples + that of its middle on a lattice of half a
    step. floor: samples of the floor, bool; material_depth: metres; the others as for `_triangles`.
    """
    rows, columns = floor.shape
    merged, are_alone = merge_cells(floor, material_depth)
    corners, sides = _triangles(deep, _cells_with_water(wet, missing) & are_alone)
    start, end = np.sort(_sides_of(merged.ravel()), axis=1).T
    (row, column), (end_row, end_column) = np.divmod(start, columns), np.divmod(end, columns)
    up, along = end_row - row, end_column - column
    # By (rows up, columns along + 1): a side of a cell has a direction.
    direction = np.array([[-1, -1, EAST], [NORTH_WEST, NORTH, NORTH_EAST]])[
        np.minimum(up, 1), np.clip(along, -1, 1) + 1
    ]
    middle = (row + end_row) * (2 * columns - 1) + column + end_column
    is_long = np.maximum(up, abs(along)) > 1
    merged_sides = np.where(is_long, 4 * rows * columns + middle, 4 * start + direction)
    return np.concatenate([corners, merged.ravel()]), np.concatenate([sides, merged_sides])


def _sides_of(corners: np.ndarray) -> np.ndarray:
    """Return the two ends of each triangle's three sides, int64 [3 n, 2]; corners: int64 [3 n]."""
    triangles = corners.reshape(-1, 3)
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)


def _triangles(deep: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples at the corners of two triangles for each of some cells, int64 [3 n], and their sides.

    deep: depth, metres, negative on dry samples, [rows, columns]; cells: bool [rows - 1, columns - 1]. A side's number
    is 4 * its first sample + direction (EAST to NORTH_WEST), the same for both triangles that share it. Of both
    diagonals the one is taken whose shallower end is deeper, so that a river across cells is not cut in two.
    """
    columns = deep.shape[1]
    row, column = np.nonzero(cells)
    # Corners are counted counter-clockwise from the south-west, as in SIDES_NORTH_EAST.
    cell_corners = (row * columns + column)[:, None] + np.array([0, 1, columns + 1, columns])
    corner_depths = deep.ravel()[cell_corners]
    north_east = (
        np.minimum(corner_depths[:, 0], corner_depths[:, 2]) >= np.minimum(corner_depths[:, 1], corner_depths[:, 3])
    )[:, None]
    corners = np.where(north_east, cell_corners[:, [0, 1, 2, 0, 2, 3]], cell_corners[:, [0, 1, 3, 1, 2, 3]])
    # For each side of the two triangles, the corner where it starts and its direction; by direction of the diagonal.
    kinds = SIDES_NORTH_EAST, SIDES_NORTH_WEST
    north_east_sides, north_west_sides = (
        np.stack([4 * cell_corners[:, c] + towards for c, towards in kind], axis=-1) for kind in kinds
    )
    return corners.ravel(), np.where(north_east, north_east_sides, north_west_sides).ravel()


def _number_items(items: np.ndarray, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the unique items in ascending order, int64, and the index among them of each number below `end`.

    The second is int32 [end]; entries of numbers that do not occur are meaningless. items: int64, below `end`.
    """
    used = np.zeros(end, bool)
    used[items] = True
    return np.flatnonzero(used), np.cumsum(used, dtype=np.int32) - np.int32(1)


def _normals(surface: Surface) -> np.ndarray:
    """Return the area-weighted mean of the triangles' normals at each vertex, float32 [V, 3]."""
    p = surface.positions.astype(np.float64)[surface.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    count, corners = len(surface.positions), surface.triangles
    sums = [add_up(np.bincount(corners[:, c], face[:, k], count) for c in range(3)) for k in range(3)]
    normals = np.stack(sums, axis=-1)
    return (normals / np.sqrt(np.sum(normals * normals, axis=1, keepdims=True))).astype(np.float32)
