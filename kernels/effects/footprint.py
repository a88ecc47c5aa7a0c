# SPDX-License-Identifier: GPL-3.0-or-later
"""The level of a pixel's footprint: the scale of attributes that pictures show."""

import warp as wp

BLOCK = wp.constant(1024)  # points whose footprints fit into the L1 cache


@wp.struct
class FootprintEye:
    """A view for footprints."""

    linear: wp.mat33d  # from the terrain's space to the camera's; 0 for parallel rays, with a shift of length 1
    shift: wp.vec3d
    pixel2: wp.float64  # squared samples that a pixel covers at unit distance


# Vectorized loops take 2 ns for a point, Warp's 10. A level in eighths is log2 of the squared footprint in quarters:
# its exponent, and the number of thresholds 2^(1/8), 2^(3/8), 2^(5/8) and 2^(7/8) that its mantissa reaches. Integer
# comparisons of bits are the same on every machine.
@wp.func_native("""
    const wp::vec3f* place = positions.data + first;
    float* __restrict out = levels.data + first;
    const double largest = (double)(2ll << 2 * max_level);
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
        const float squared = out[k] > 1.0f ? out[k] : 1.0f;
        int bits;
        __builtin_memcpy(&bits, &squared, 4);
        const int m = bits & 0x7FFFFF;
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
    max_level: int,
    levels: wp.array(dtype=wp.float32),
):
    """Write the finest level of any eye for `count` points from `first` on, 0 to `max_level` in steps of 1/8.

    A level is log2 of the samples that a pixel covers. `levels` holds infinity before.
    """
    ...


@wp.kernel
def footprint_levels(
    offset: int,
    positions: wp.array(dtype=wp.vec3f),
    eyes: wp.array(dtype=FootprintEye),
    max_level: int,
    levels: wp.array(dtype=wp.float32),
):
    """Compute the level of the finest pixel footprint of any eye, for block `offset + tid` of points.

    A level is log2 of the samples that a pixel covers, 0 to `max_level` in steps of 1/8; `levels` holds infinity
    before.
    """
    first = (offset + wp.tid()) * BLOCK
    levels_of(positions, first, wp.min(levels.shape[0] - first, BLOCK), eyes, max_level, levels)
