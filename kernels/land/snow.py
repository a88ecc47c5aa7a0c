# SPDX-License-Identifier: GPL-3.0-or-later
"""Snow: its depth by temperature, wind and sky, and slides on steep ground."""

import warp as wp

from ..effects.logarithm import exponential

# Lapse rate of air in kelvin per metre of height.
LAPSE = wp.constant(wp.float64(0.0065))
# Kelvin of the transition from rain to snow, and the fraction of snow that melts at once.
BLEND, MELTS = wp.constant(wp.float64(0.8)), wp.constant(wp.float64(0.02))
# Fraction that falls without visible sky; amplitude and steepness of the drift by the wind's shelter.
UNDER_COVER, SHELTER, STEEPENING = (wp.constant(wp.float64(v)) for v in (0.4, 0.8, 2.5))
# Metres that cling to level ground; slopes from which on this decreases and is 0.
CLINGS, LESS_CLINGS, NONE_CLINGS = (wp.constant(wp.float64(v)) for v in (0.35, 0.8, 2.2))


@wp.struct
class Weather:
    """The weather over a raster.

    `width`, `height`: samples. `per_x`, `per_y`: 1 / spacing in 1/m. `line`: height in metres where rain turns to snow.
    `fall`: metres of snow on open, level ground far above it. `aspect`: kelvin between ground that faces the noon sun
    and ground in its shade. `sun`: sine and cosine of that sun's height, the cosine positive for a sun in the south.
    """

    width: wp.int32
    height: wp.int32
    per_x: wp.float64
    per_y: wp.float64
    line: wp.float64
    fall: wp.float64
    aspect: wp.float64
    sun: wp.vec2d


@wp.kernel
def fall(
    offset: int,
    weather: Weather,
    heights: wp.array(dtype=wp.float32),
    bare: wp.array(dtype=wp.uint8),
    sky: wp.array(dtype=wp.float32),
    lee: wp.array(dtype=wp.float32),
    fallen: wp.array(dtype=wp.float32),
    stuck: wp.array(dtype=wp.float32),
):
    """Write the metres of snow in row `offset + tid` to `fallen`, and the part that clings to the ground to `stuck`.

    snow = fall * cold(T) * (UNDER_COVER + (1 - UNDER_COVER) sky) * drift(lee), T by height and aspect, cold a logistic
    function less MELTS, 0 .. 1; 0 where `bare` is not 0. sky: visible part, 0 .. 1. lee: shelter from the wind, above 0
    where snow gathers; drift is 0.2 .. 1.8. weather.sun: sine and cosine of the sun's height. weather.line: height,
    metres, at which half of the precipitation is snow. weather.fall: metres of snow on cold, level, open ground.
    weather.aspect: kelvin between ground that faces the noon sun and ground in its shade. weather.per_x, per_y: 1 over
    the step between samples, 1/m. Boundary: slopes are one-sided at the border.
    """
    one = wp.float64(1.0)
    y = offset + wp.tid()
    south = wp.max(y - 1, 0)
    north = wp.min(y + 1, weather.height - 1)
    for x in range(weather.width):
        i = y * weather.width + x
        west = wp.max(x - 1, 0)
        east = wp.min(x + 1, weather.width - 1)
        row = y * weather.width
        to_east = wp.float64(heights[row + east] - heights[row + west]) * weather.per_x / wp.float64(east - west)
        to_north = wp.float64(heights[north * weather.width + x] - heights[south * weather.width + x])
        to_north *= weather.per_y / wp.float64(north - south)
        slope2 = to_east * to_east + to_north * to_north
        facing = wp.clamp((to_north * weather.sun[1] + weather.sun[0]) / wp.sqrt(one + slope2), wp.float64(0.0), one)
        # Above the temperature at which rain turns to snow. Aspect adds 0 on level ground, where `facing` is sun[0].
        kelvin = (weather.line - wp.float64(heights[i])) * LAPSE + weather.aspect * (facing - weather.sun[0])
        cold = one / (one + exponential(wp.clamp(kelvin / BLEND, wp.float64(-50.0), wp.float64(50.0))))
        cold = wp.max(cold - MELTS, wp.float64(0.0)) / (one - MELTS)
        drift = STEEPENING * wp.float64(lee[i])
        drift = wp.clamp(one + SHELTER * drift / wp.sqrt(one + drift * drift), wp.float64(0.1), wp.float64(2.0))
        exposure = UNDER_COVER + (one - UNDER_COVER) * wp.float64(sky[i])
        snow = weather.fall * cold * exposure * drift
        if bare[i] != wp.uint8(0):
            snow = wp.float64(0.0)
        holds = (NONE_CLINGS - wp.sqrt(slope2)) / (NONE_CLINGS - LESS_CLINGS)  # 1 on gentle ground, 0 where none clings
        fallen[i] = wp.float32(snow)
        stuck[i] = wp.min(fallen[i], wp.float32(CLINGS * wp.clamp(holds, wp.float64(0.0), one)))


@wp.struct
class Slides:
    """Loose snow on a bed, samples in rows."""

    width: wp.int32
    height: wp.int32
    falls: wp.vec3f  # largest stable differences of two neighbours' surfaces, metres: to the east, north, diagonally
    bed: wp.array(dtype=wp.float32)  # metres, NaN at walls, which no snow passes
    snow: wp.array(dtype=wp.float32)  # metres on the bed


# Each pair exchanges snow, which conserves it; C code, eight pairs at once.
_SLIDE = """
#pragma clang fp contract(off)
    const int width = slides.width, height = slides.height, at = y * width, next = at + width;
    const float to_east = slides.falls[0], to_north = slides.falls[1], across = slides.falls[2];
    const float *b = slides.bed.data;
    float *s = slides.snow.data, *__restrict low = s + at, *__restrict high = s + next;
    auto settle = [&](float &si, float &sj, float between, float fall) __attribute__((always_inline)) {
        const float drop = between + (si - sj), size = drop < 0.0f ? -drop : drop;
        const float upper = drop < 0.0f ? sj : si, lower = drop < 0.0f ? si : sj;
        float q = 0.5f * (size - fall);
        q = q > 0.0f ? q : 0.0f;  // 0 for NaN, the walls
        q = q < upper ? q : upper;
        const float kept = upper - q, got = lower + (upper - kept);
        si = drop < 0.0f ? got : kept;
        sj = drop < 0.0f ? kept : got;
    };
    for (int row = y; along && row < y + 2 && row < height; ++row) {
        if (row < 0) continue;
        for (int p = 0; p < 2; ++p) {
            const int start = row * width + ((p ^ turn) & 1), end = row * width + width - 1;
            #pragma clang loop vectorize(enable)
            for (int i = start; i < end; i += 2) settle(s[i], s[i + 1], b[i] - b[i + 1], to_east);
        }
    }
    if (y < 0 || y + 1 >= height) return;
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < width; ++x) settle(low[x], high[x], b[at + x] - b[next + x], to_north);
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < width - 1; ++x) settle(low[x], high[x + 1], b[at + x] - b[next + x + 1], across);
    #pragma clang loop vectorize(enable)
    for (int x = 1; x < width; ++x) settle(low[x], high[x - 1], b[at + x] - b[next + x - 1], across);
"""


@wp.func_native(_SLIDE)
def slide_slab(slides: Slides, y: int, along: int, turn: int):
    """Move loose snow between pairs of samples in rows y and y + 1 until they differ by `slides.falls` or have none.

    slides.falls: largest stable height differences, metres, of neighbours to the east, north and diagonally. Only the
    upper sample's loose snow moves. A pair that is settled later may undo that for an earlier one. Rows outside the
    raster are skipped. along: 1 to settle pairs along the rows first, from those whose western column has the parity of
    `turn`; 0 to settle only pairs across and along the diagonals.
    """
    ...


@wp.kernel
def slide(offset: int, first: int, along: int, turn: int, slides: Slides):
    """Settle the loose snow of slab `offset + tid`: rows first + 2 * (offset + tid) and the next.

    Slabs share no row. first: -1 or 0, the first slab's lower row; rows outside the raster are skipped. along: 1 to
    settle pairs along the rows first, from those whose western column has the parity of `turn`; 0 to settle only pairs
    across and along the diagonals.
    """
    slide_slab(slides, first + 2 * (offset + wp.tid()), along, turn)
