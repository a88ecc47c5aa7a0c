# SPDX-License-Identifier: GPL-3.0-or-later
"""The level of a pixel's footprint: the scale at which what pictures show is evaluated."""

import warp as wp

BLOCK = wp.constant(1024)  # places: their footprints stay in the first cache


@wp.struct
class Eye:
    """A view, as the footprint has it."""

    linear: wp.mat33d  # from the terrain's space to the camera's; of parallel rays 0, with a shift of length 1
    shift: wp.vec3d
    pixel2: wp.float64  # squared samples that a pixel covers at unit distance


# Loops that are vectorised: 2 ns a place, and 10 in Warp. Eighths of a level are quarters of the power of two that a
# squared footprint is: its exponent and, of its mantissa, how many of 2^(1/8), 2^(3/8), 2^(5/8) and 2^(7/8) it reaches.
# By bits, so the same everywhere.
@wp.func_native("""
    const wp::vec3f* place = positions.data + first;
    float* __restrict out = levels.data + first;
    const double largest = (double)(2ll << 2 * most);
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
        const int part = bits & 0x7FFFFF;
        const int steps = (part >= 0x0B95C2) + (part >= 0x25FED7) + (part >= 0x45672B) + (part >= 0x6AC0C7);
        const int eighths = 4 * ((bits >> 23) - 127) + steps;
        out[k] = (eighths < 8 * most ? eighths : 8 * most) * 0.125f;
    }
""")
def levels_of(
    positions: wp.array(dtype=wp.vec3f),
    first: int,
    count: int,
    eyes: wp.array(dtype=Eye),
    most: int,
    levels: wp.array(dtype=wp.float32),
): ...


@wp.kernel
def footprint_levels(
    offset: int,
    positions: wp.array(dtype=wp.vec3f),
    eyes: wp.array(dtype=Eye),
    most: int,
    levels: wp.array(dtype=wp.float32),
):
    """Block `offset + tid` of places, of the eye that sees each finest: 0 to `most`, in steps of 1/8. `levels` holds
    infinity."""
    first = (offset + wp.tid()) * BLOCK
    levels_of(positions, first, wp.min(levels.shape[0] - first, BLOCK), eyes, most, levels)
