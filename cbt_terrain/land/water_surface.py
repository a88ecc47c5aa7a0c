# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of water as a mesh: where it is deep enough, along its shore cut at depth 0.

Ground is between samples what it is on the sides of triangles, and so the shore lies where the water's level meets it.
Dry samples beside water have the level of that water, and end below the ground; where the ground beside a river falls
off, so far below it that the river ends half-way.
"""

from dataclasses import replace

import numpy as np

from ..ask.linear import add_up
from ..field.heightfield import HeightField
from ..field.lattice import Lattice, fit
from ..land_effects.land_effect import Ground
from ..land_effects.water import DEPTH, DISCHARGE, SPEED, WATER
from ..mesh.attributes import FACE, LEVEL, NORMALS, POINT, UV, Attribute
from ..mesh.cut import Side, cut
from ..mesh.surface import Surface

# Samples along a side, at most; what a surface is made of.
MOST_SAMPLES = 1025
NAMES = DEPTH.name, SPEED.name, DISCHARGE.name
# Metres of water that make a surface, at least.
LEAST_DEPTH = 0.05
# Metres by which the heights of one lake differ, at most.
SAME = 1e-3
# m^3/s, of streams: by their depth alone they would have gaps wherever they are fast. What half a square kilometre
# gives of a metre of rain a year.
LEAST_DISCHARGE = 0.016


def water_of(field: HeightField, threads: int = 1) -> Surface:
    """The surface of the water that the stack of a height field has left; where that has left none, of what the effect
    *Water* makes of it by its defaults. Of a raster with more than MOST_SAMPLES along a side, from every second sample,
    or fourth and so on."""
    every = 1
    while (max(field.lattice.width, field.lattice.height) - 1) // every >= MOST_SAMPLES:
        every *= 2

    def thinned(samples: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(samples[::every, ::every])

    lattice, heights = field.lattice, thinned(field.heights())
    steps = lattice.step_x * every, lattice.step_y * every
    missing = None if field.valid is None else thinned(field.valid) == 0
    if DEPTH.name in field.layers:
        layers = {name: thinned(field.layers[name]) for name in NAMES if name in field.layers}
    else:
        layers = WATER.apply(Ground(heights, *steps, missing=missing, threads=threads), WATER.defaults(), None).layers
    own = fit(heights.shape[1], heights.shape[0], *steps)
    surface = water_surface(own, heights, *map(layers.get, NAMES), missing, threads=threads)
    # Every lattice has its middle at 0, and this one may end short of the field's rim.
    moved = np.subtract(lattice.rectangle()[:2], own.rectangle()[:2])
    return replace(surface, positions=surface.positions + np.float32([*moved, 0.0]))


def water_surface(
    lattice: Lattice,
    heights: np.ndarray,
    depth: np.ndarray,
    speed: np.ndarray | None = None,
    discharge: np.ndarray | None = None,
    missing: np.ndarray | None = None,
    least: float = LEAST_DEPTH,
    threads: int = 1,
) -> Surface:
    """The surface of all water that is at least so deep, metres, or of a stream that carries LEAST_DISCHARGE, with the
    attributes `water_depth` and `water_speed`.

    lattice: of the samples; heights, depth: float32 [rows, columns] m; speed: m/s, and discharge: m^3/s, likewise, or
    None for still water; missing: bool, likewise, holes, which no triangle touches. Triangles are two for each cell
    that has water at a corner, cut at the shore; they face up. Without any water the surface is empty.
    """
    wet = depth >= least
    if discharge is not None:
        wet |= (discharge >= LEAST_DISCHARGE) & (depth > 0.0)
    if missing is not None:
        wet &= ~missing
    deep, level, wet = _to_the_shore(heights, depth, wet, least)
    corners, sides = _triangles(deep, wet, missing)
    used, numbers = _numbered(corners, heights.size)
    row, column = np.divmod(used, heights.shape[1])
    west, south, _, _ = lattice.rectangle()
    x, y = west + column * lattice.step_x, south + row * lattice.step_y
    positions = np.stack([x, y, level.ravel()[used]], axis=-1).astype(np.float32)
    uv = np.stack([column / (heights.shape[1] - 1), row / (heights.shape[0] - 1)], axis=-1).astype(np.float32)
    fast = np.zeros(len(used), np.float32) if speed is None else np.where(wet, speed, 0.0).ravel()[used]
    attributes = {
        NORMALS: Attribute(np.tile(np.float32([0.0, 0.0, 1.0]), (len(used), 1)), POINT),
        UV: Attribute(uv, POINT),
        "water_depth": Attribute(deep.ravel()[used].astype(np.float32), POINT, "m"),
        "water_speed": Attribute(fast.astype(np.float32), POINT, "m/s"),
        LEVEL: Attribute(np.zeros(len(corners) // 3, np.int32), FACE),
    }
    lines, line_numbers = _numbered(sides, 4 * heights.size)
    start, towards = np.divmod(lines, 4)
    width = heights.shape[1]
    ends = np.stack([start, start + np.array([1, width, width + 1, width - 1])[towards]], axis=-1)
    surface = Surface(positions, numbers[corners], line_numbers[sides], numbers[ends], attributes)
    values = deep.ravel()[used]
    surface, _ = cut(surface, [Side(lambda _positions: values)], threads=threads)
    attributes = {name: surface.attributes[name] for name in (NORMALS, "water_depth", "water_speed")}
    for name in ("water_depth", "water_speed"):
        attributes[name] = Attribute(np.maximum(attributes[name].array, 0.0), POINT, attributes[name].unit)
    attributes[NORMALS] = Attribute(_normals(surface), POINT)
    return surface.with_attributes(attributes)


def sea_depth(heights: np.ndarray, level: float) -> np.ndarray:
    """float32 [rows, columns] m: the depth of a sea of this level over all ground below it."""
    return np.maximum(np.float32(level) - heights, np.float32(0.0))


def _to_the_shore(
    heights: np.ndarray, depth: np.ndarray, wet: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """float64 [rows, columns] m: how far the water's surface is above the ground, below it at dry samples beside wet
    ones, and the surface's height; and what is wet, with the shallow rims of lakes."""
    ground = heights.astype(np.float64)
    surface = ground + depth
    near, beside, _ = _beside(surface, depth, wet)
    # The shallow rim of a lake is of the lake, so that its shore is where the ground comes out of the water.
    wet = wet | (near & (depth > 0.0) & (ground < beside) & (abs(surface - beside) < SAME))
    near, beside, thick = _beside(surface, depth, wet)
    # Where the rim is wider it ends in between; a river that is higher than its banks ends half-way.
    same = surface >= beside - least
    below = np.where(beside < ground, ground - beside, np.where(same, beside - ground, thick))
    over = np.where(wet, depth, np.where(near, -below, 0.0))
    return over, np.where(wet, surface, ground + over), wet


def _beside(surface: np.ndarray, depth: np.ndarray, wet: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dry samples beside wet ones, and the means of the surface and of the depth of those."""
    level, thick, count = (_sums(np.where(wet, array, 0.0)) for array in (surface, depth, 1.0))
    near, count = ~wet & (count > 0), np.maximum(count, 1.0)
    return near, level / count, thick / count


def _sums(array: np.ndarray) -> np.ndarray:
    """Of the eight neighbours of each sample."""
    rows, columns = array.shape
    padded = np.pad(array, 1)
    total = np.zeros_like(array)
    for dy in range(3):
        for dx in range(3):
            if (dy, dx) != (1, 1):
                total += padded[dy : dy + rows, dx : dx + columns]
    return total


# The sides of a cell's two triangles: from which corner, counter-clockwise from the south-west, and whereto.
EAST, NORTH, NORTH_EAST, NORTH_WEST = range(4)
RISING = ((0, EAST), (1, NORTH), (0, NORTH_EAST), (0, NORTH_EAST), (3, EAST), (0, NORTH))
FALLING = ((0, EAST), (1, NORTH_WEST), (0, NORTH), (1, NORTH), (3, EAST), (1, NORTH_WEST))


def _triangles(deep: np.ndarray, wet: np.ndarray, missing: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """int64 [3 n]: samples at the corners of two triangles for each cell with water at a corner; and the side from each
    corner to the next, as 4 * sample + direction.

    The diagonal is the one whose shallower end is deeper, so that a river across cells is not cut in two."""
    columns = deep.shape[1]
    cells = wet[:-1, :-1] | wet[:-1, 1:] | wet[1:, :-1] | wet[1:, 1:]
    if missing is not None:
        cells &= ~(missing[:-1, :-1] | missing[:-1, 1:] | missing[1:, :-1] | missing[1:, 1:])
    row, column = np.nonzero(cells)
    at = (row * columns + column)[:, None] + np.array([0, 1, columns + 1, columns])
    z = deep.ravel()[at]
    rising = (np.minimum(z[:, 0], z[:, 2]) >= np.minimum(z[:, 1], z[:, 3]))[:, None]
    corners = np.where(rising, at[:, [0, 1, 2, 0, 2, 3]], at[:, [0, 1, 3, 1, 2, 3]])
    sides = [np.stack([4 * at[:, c] + towards for c, towards in kind], axis=-1) for kind in (RISING, FALLING)]
    return corners.ravel(), np.where(rising, *sides).ravel()


def _numbered(items: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """int64: the different ones of `items` (less than `most`), ascending; int32 [most]: which of them each is."""
    there = np.zeros(most, bool)
    there[items] = True
    return np.flatnonzero(there), np.cumsum(there, dtype=np.int32) - np.int32(1)


def _normals(surface: Surface) -> np.ndarray:
    """float32 [V, 3]: the mean of the triangles' at each vertex, by their areas."""
    p = surface.positions.astype(np.float64)[surface.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    count, corners = len(surface.positions), surface.triangles
    sums = [add_up(np.bincount(corners[:, c], face[:, k], count) for c in range(3)) for k in range(3)]
    normals = np.stack(sums, axis=-1)
    return (normals / np.sqrt(np.sum(normals * normals, axis=1, keepdims=True))).astype(np.float32)
