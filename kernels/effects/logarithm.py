# SPDX-License-Identifier: GPL-3.0-or-later
"""Logarithm and exponential by arithmetic alone: the C library's last bits depend on the processor."""

import warp as wp

LN_2 = wp.constant(wp.float64(0.6931471805599453))
ONE_BITS = wp.constant(wp.int64(0x3FF0000000000000))
FRACTION_BITS = wp.constant(wp.int64(0x000FFFFFFFFFFFFF))


@wp.func
def natural_log(x: wp.float64) -> wp.float64:
    """Return ln x = e ln 2 + 2 artanh((m - 1) / (m + 1)) of a normal number x = m 2^e > 0, within 1e-15."""
    bits = wp.cast(x, wp.int64)
    e = wp.float64((bits >> wp.int64(52)) - wp.int64(1023))
    m = wp.cast((bits & FRACTION_BITS) | ONE_BITS, wp.float64)
    if m > wp.float64(1.4142135623730951):
        m *= wp.float64(0.5)
        e += wp.float64(1.0)
    s = (m - wp.float64(1.0)) / (m + wp.float64(1.0))
    square = s * s
    series = wp.float64(0.0)
    for k in range(10):
        series = series * square + wp.float64(1.0) / wp.float64(19 - 2 * k)
    return e * LN_2 + wp.float64(2.0) * s * series


@wp.func
def exponential(x: wp.float64) -> wp.float64:
    """Return e^x = 2^k e^r with |r| <= ln 2 / 2, within a relative 1e-15, for -700 < x < 700."""
    k = wp.floor(x / LN_2 + wp.float64(0.5))
    r = x - k * LN_2
    series = wp.float64(1.0)
    for n in range(14):
        series = wp.float64(1.0) + series * r / wp.float64(14 - n)
    # The last factor is 2^k, made from its exponent bits.
    return series * wp.cast((wp.int64(k) + wp.int64(1023)) << wp.int64(52), wp.float64)
