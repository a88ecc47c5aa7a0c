# SPDX-License-Identifier: GPL-3.0-or-later
"""The level of a pixel's footprint: the scale at which what pictures show is evaluated."""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Of the mantissa of the squared footprint, 1 .. 2: 2**((k + 1/2) / 4), from where on it belongs to the next eighth.
STEP_0 = wp.constant(wp.float64(1.0905077326652577))
STEP_1 = wp.constant(wp.float64(1.2968395546510096))
STEP_2 = wp.constant(wp.float64(1.5422108254079407))
STEP_3 = wp.constant(wp.float64(1.8340080864093424))
MANTISSA = wp.constant(wp.int64(0xFFFFFFFFFFFFF))
ONE = wp.constant(wp.int64(0x3FF0000000000000))


@wp.struct
class Eye:
    """A view, as the footprint has it."""

    linear: wp.mat33d  # from the terrain's space to the camera's
    shift: wp.vec3d
    pixel2: wp.float64  # squared samples that a pixel covers: at unit distance, or if `parallel` anywhere
    parallel: wp.int32


@wp.func
def eighths(squared: wp.float64) -> wp.int32:
    """The level of a squared footprint in samples, in eighths, to the nearest: by its bits, the same everywhere."""
    bits = wp.cast(squared, wp.int64)
    exponent = wp.int32(bits >> wp.int64(52)) - 1023
    mantissa = wp.cast((bits & MANTISSA) | ONE, wp.float64)
    part = wp.where(mantissa >= STEP_0, 1, 0) + wp.where(mantissa >= STEP_1, 1, 0)
    part += wp.where(mantissa >= STEP_2, 1, 0) + wp.where(mantissa >= STEP_3, 1, 0)
    return 4 * exponent + part


@wp.kernel
def footprint_levels(
    offset: int,
    positions: wp.array(dtype=wp.vec3f),
    eyes: wp.array(dtype=Eye),
    most: int,
    levels: wp.array(dtype=wp.float32),
):
    """Of the eye that sees a place finest: 0 to `most`, in steps of 1/8."""
    v = offset + wp.tid()
    f = positions[v]
    p = wp.vec3d(wp.float64(f[0]), wp.float64(f[1]), wp.float64(f[2]))
    finest = wp.float64(wp.inf)
    for e in range(eyes.shape[0]):
        eye = eyes[e]
        squared = eye.pixel2
        if eye.parallel == 0:
            c = eye.linear * p + eye.shift
            squared *= wp.dot(c, c)
        finest = wp.min(finest, squared)
    levels[v] = wp.float32(wp.clamp(eighths(finest), 0, 8 * most)) * 0.125
