# SPDX-License-Identifier: GPL-3.0-or-later
"""The level of a pixel's footprint: the scale of attributes that pictures show; and the finest level at a point.

A level is log2 of the samples of the raster that a pixel covers. `eyes` are the views, `positions` points in metres.

Levels below 0, finer than the raster, are those of *finer tiles*: squares of the raster with heights at a fraction of
its step.
"""

import warp as wp

from ..field.finer import SIDE, TILE_BITS
from ..unchecked import item_at

BLOCK = wp.constant(1024)  # points whose footprints fit into the L1 cache
FADE = wp.constant(wp.float64(64.0))  # finer cells from the border of the tiles with finer heights to the finest level


@wp.struct
class FootprintEye:
    """A view for footprints."""

    linear: wp.mat33d  # from the terrain's space to the camera's; 0 for parallel rays, with a shift of length 1
    shift: wp.vec3d
    pixel2: wp.float64  # squared samples that a pixel covers at unit distance


@wp.struct
class FinerPlaces:
    """The tiles with finer heights of a raster, and how far it is from a point to others."""

    bits: wp.int32  # a raster cell has 2^bits finer cells a side
    columns: wp.int32  # of the table of tiles
    # For each place of the table: bit 3 j + i is 1 if the neighbour i columns east and j rows north of the
    # south-western one has no finer heights; -1 for a place that has none itself.
    missing_neighbours: wp.array(dtype=wp.int32)
    cells_x: wp.int32  # finer cells of the raster
    cells_y: wp.int32
    west: wp.float64  # position of the raster's first sample, metres
    south: wp.float64
    per_x: wp.float64  # finer cells per metre
    per_y: wp.float64


# Vectorized loops take 2 ns for a point, Warp's 10. A level in eighths is log2 of the squared footprint in quarters:
# its exponent, and the number of thresholds 2^(1/8), 2^(3/8), 2^(5/8) and 2^(7/8) that its mantissa reaches. Integer
# comparisons of bits are the same on every machine.
@wp.func_native("""
    const wp::vec3f* place = positions.data + first;
    float* __restrict out = levels.data + first;
    const double largest = (double)(2ll << 2 * max_level);  // above max_level, to which it is limited below
    const float smallest = 1.0f / (float)(1 << -2 * min_level);
    // First the squares of the samples that a pixel covers, the smallest of all eyes. (a, b, c): the point in the
    // eye's camera space; pixel2: squared samples that a pixel covers at unit distance from it.
    for (int e = 0; e < (int)eyes.shape[0]; ++e) {
        const auto& eye = eyes.data[e];
        const auto& m = eye.linear.data;
        const auto& s = eye.shift.c;
        for (int k = 0; k < count; ++k) {
            const double x = place[k].c[0], y = place[k].c[1], z = place[k].c[2];
            const double a = m[0][0] * x + m[0][1] * y + m[0][2] * z + s[0];
            const double b = m[1][0] * x + m[1][1] * y + m[1][2] * z + s[1];
            const double c = m[2][0] * x + m[2][1] * y + m[2][2] * z + s[2];
            const double squared = (a * a + b * b + c * c) * eye.pixel2;
            const float found = squared < largest ? squared : largest;
            out[k] = found < out[k] ? found : out[k];
        }
    }
    for (int k = 0; k < count; ++k) {
        const float squared = out[k] > smallest ? out[k] : smallest;
        int bits;
        __builtin_memcpy(&bits, &squared, 4);
        const int m = bits & 0x7FFFFF;
        // Quarters of log2 of the square, rounded: the limits are the mantissas of 2^(1/8), 2^(3/8), 2^(5/8), 2^(7/8).
        const int steps = (m >= 0x0B95C2) + (m >= 0x25FED7) + (m >= 0x45672B) + (m >= 0x6AC0C7);
        const int eighths = 4 * ((bits >> 23) - 127) + steps;
        out[k] = (eighths < 8 * max_level ? eighths : 8 * max_level) * 0.125f;
    }
""")
def levels_of(
    positions: wp.array(dtype=wp.vec3f),
    first: int,
    count: int,
    eyes: wp.array(dtype=FootprintEye),
    min_level: int,
    max_level: int,
    levels: wp.array(dtype=wp.float32),
):
    """Write the finest level of any eye for `count` points from `first` on, in steps of 1/8.

    A level is log2 of the samples that a pixel covers, at least `min_level`, which is 0 or a little less, and at most
    `max_level`. positions: metres. `levels` holds infinity before.
    """
    ...


@wp.kernel
def footprint_levels(
    offset: int,
    positions: wp.array(dtype=wp.vec3f),
    eyes: wp.array(dtype=FootprintEye),
    min_level: int,
    max_level: int,
    levels: wp.array(dtype=wp.float32),
):
    """Compute the level of the finest pixel footprint of any eye, for block `offset + tid` of points.

    A level is log2 of the samples that a pixel covers, `min_level` to `max_level` in steps of 1/8; `levels` holds
    infinity before.
    """
    first = (offset + wp.tid()) * BLOCK
    levels_of(positions, first, wp.min(levels.shape[0] - first, BLOCK), eyes, min_level, max_level, levels)


@wp.func
def finest_level(places: FinerPlaces, x: wp.float64, y: wp.float64) -> wp.float32:
    """Return the finest level at x, y metres: -bits inside tiles with finer heights, 0 outside and at their border.

    Within FADE finer cells of that border it is linear in the distance, the larger of those in x and y: it is
    continuous. places: the table of these tiles, which has the missing neighbours of each as bits, and -1 for a tile
    without finer heights; cells_x, cells_y: finer cells of the raster; per_x, per_y: finer cells a metre.
    """
    cell_x = wp.clamp((x - places.west) * places.per_x, wp.float64(0.0), wp.float64(places.cells_x))
    cell_y = wp.clamp((y - places.south) * places.per_y, wp.float64(0.0), wp.float64(places.cells_y))
    column = wp.min(wp.int32(cell_x), places.cells_x - 1) >> TILE_BITS
    row = wp.min(wp.int32(cell_y), places.cells_y - 1) >> TILE_BITS
    missing_neighbours = item_at(places.missing_neighbours, row * places.columns + column)
    level = wp.float64(0.0)
    if missing_neighbours >= 0:
        side = wp.float64(SIDE)
        west = cell_x - wp.float64(column) * side
        south = cell_y - wp.float64(row) * side
        level = FADE  # until it is scaled: the distance from the border in finer cells, at most FADE
        if missing_neighbours != 0:
            for k in range(9):
                if ((missing_neighbours >> k) & 1) != 0:  # neighbour k, 3 * (dy + 1) + dx + 1, has no finer heights
                    distance_x = wp.where(k % 3 == 0, west, wp.where(k % 3 == 2, side - west, wp.float64(0.0)))
                    distance_y = wp.where(k / 3 == 0, south, wp.where(k / 3 == 2, side - south, wp.float64(0.0)))
                    level = wp.min(level, wp.max(distance_x, distance_y))
        level *= -wp.float64(places.bits) / FADE
    return wp.float32(level)


@wp.kernel
def limit_levels(
    offset: int,
    places: FinerPlaces,
    positions: wp.array(dtype=wp.vec3f),
    levels: wp.array(dtype=wp.float32),
):
    """Raise levels[offset + tid] to `finest_level` at its point, if it is below that."""
    v = offset + wp.tid()
    if levels[v] < 0.0:
        p = positions[v]
        levels[v] = wp.max(levels[v], finest_level(places, wp.float64(p[0]), wp.float64(p[1])))
