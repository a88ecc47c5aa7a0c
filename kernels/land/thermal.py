# SPDX-License-Identifier: GPL-3.0-or-later
"""Scree: rock that breaks above the angle of its bed, and slides above its own angle (Musgrave, Kolb and Mace 1989).

Pairs of neighbours exchange their excess above the angle, which conserves mass, and settle at most fully, so that any
slope and step is stable. World indices decide the order of pairs: slabs of two rows, first those with an even lower row
and then the others, or in reverse; within a slab pairs along its rows, across it, and along both diagonals. Slabs share
no row, so that threads do not change a bit.

Layers from below: `base`, constant rock; `left`, rock that may break off; `scree`. All are float32 [rows * columns]
metres; separate arrays keep millimetres on a mountain. `slope`, `s0`: these and the parameters. Boundary: NaN in `base`
is a wall that nothing passes.
"""

import warp as wp

from ..field.noise import value_noise


@wp.struct
class Slope:
    """A slope and its parameters; metres, angles as tangents.

    `first_row`, `first_column`: position of sample [0, 0] in the whole level. `repose`: tangent of scree. `soft`,
    `hard`: tangents at which the softest and the hardest bed break. `thick`: thickness of a bed. `dip_x`, `dip_y`:
    metres that beds fall to the next sample in the east and north. `share`: fraction of the excess that the upper
    sample of a pair gives, at most `max_fraction` of its scree. `weather`: fraction of the excess of bare rock that
    breaks off. Of each sample, `base`: height of the rock that cannot break, NaN at walls; `left`: rock on it that may
    still break; `scree`: on both; `facing`: cosine of the angle between downhill and the nearest of eight directions.
    """

    width: wp.int32
    height: wp.int32
    first_row: wp.int32
    first_column: wp.int32
    step_x: wp.float32
    step_y: wp.float32
    repose: wp.float32
    soft: wp.float32
    hard: wp.float32
    thick: wp.float32
    dip_x: wp.float32
    dip_y: wp.float32
    max_fraction: wp.float32
    share: wp.float32
    weather: wp.float32
    seed: wp.uint32
    base: wp.array(dtype=wp.float32)
    left: wp.array(dtype=wp.float32)
    scree: wp.array(dtype=wp.float32)
    facing: wp.array(dtype=wp.float32)


# Eight directions alone would make eight-sided cones, since between two of them the slope along either is less than the
# steepest one. So limits are multiplied by the cosine of the angle to the nearest direction. That angle is at most 22.5
# degrees, cosine 0.924: a smaller quotient is not one, but comes from a wall (NaN) or level ground (0 / 0).
FACE_ROW = """
    const float* __restrict b = s0.base.data;
    const float* __restrict l = s0.left.data;
    const float* __restrict s = s0.scree.data;
    float* __restrict out = s0.facing.data;
    const int nx = s0.width, south = y > 0 ? -nx : 0, north = y + 1 < s0.height ? nx : 0, rows = (north - south) / nx;
    const float by_x = 0.5f / s0.step_x, by_y = 1.0f / (s0.step_y * (float)(rows > 1 ? rows : 1));
    auto face = [&](int i, int west, int east, float by) __attribute__((always_inline)) {
        float u = ((b[i + east] + l[i + east] + s[i + east]) - (b[i + west] + l[i + west] + s[i + west])) * by;
        float v = ((b[i + north] + l[i + north] + s[i + north]) - (b[i + south] + l[i + south] + s[i + south])) * by_y;
        float p = __builtin_fabsf(u), q = __builtin_fabsf(v), fall = p > q ? p : q, d = (p + q) * 0.70710678f;
        fall = fall > d ? fall : d;
        float cosine = fall / __builtin_sqrtf(u * u + v * v);
        out[i] = cosine >= 0.92f ? cosine : 1.0f;
    };
    face(y * nx, 0, nx > 1, 2.0f * by_x);
    if (nx > 1) face(y * nx + nx - 1, -1, 0, 2.0f * by_x);
    #pragma clang loop vectorize(enable)
    for (int x = 1; x < nx - 1; ++x) face(y * nx + x, -1, 1, by_x);
"""


@wp.func_native(FACE_ROW)
def face_row(s0: Slope, y: int):
    """Set `facing` of row y: the cosine of the angle between downhill and the nearest of eight directions.

    It is 1 next to walls and on level ground.
    """
    ...


@wp.kernel
def face_rows(offset: int, slope: Slope):
    """Set `facing` of row `offset + tid`: the cosine of the angle between downhill and the nearest of eight directions.

    It is 1 next to walls and on level ground.
    """
    face_row(slope, offset + wp.tid())


# A bed of rock is `thick` metres high and has a random hardness, 0 .. 1, which changes to that of the next bed over its
# upper quarter. C code, eight pairs at once: 6 times as fast as Warp's loops.
SETTLE_SLAB = """
    const float* __restrict b = s0.base.data;
    float* __restrict l = s0.left.data;
    float* __restrict s = s0.scree.data;
    const float* __restrict facing = s0.facing.data;
    const float span = s0.hard - s0.soft, per_bed = 1.0f / s0.thick;
    auto hash = [&](unsigned n) __attribute__((always_inline)) {
        n = n * 0x9E3779B9u + s0.seed;
        n = (n ^ (n >> 15)) * 0x7FEB352Du;
        n = (n ^ (n >> 15));
        return (float)(int)(n >> 8) * 5.9604645e-08f;
    };
    auto settle = [&](int i, int j, float run, float dip) __attribute__((always_inline)) {
        float li = l[i], lj = l[j], zi = b[i] + li, zj = b[j] + lj, si = s[i], sj = s[j];
        float fi = facing[i], fj = facing[j];
        float drop = (zi + si) - (zj + sj);
        bool down = drop >= 0.0f;  // sample i is the higher one; names that end in h are of the higher one
        float zh = down ? zi : zj, zl = down ? zj : zi, sh = down ? si : sj, sl = down ? sj : si;
        float lh = down ? li : lj;
        run *= down ? fi : fj;
        float move = s0.share * ((down ? drop : -drop) - s0.repose * run);
        float limit = s0.max_fraction * sh;
        limit = limit < move ? limit : move;
        move = limit > 0.0f ? limit : 0.0f;
        float rest = sh - move;
        sl += sh - rest;
        sh = rest;
        float bare = zh - (zl + sl);
        float t = (zh + dip) * per_bed;
        int n = (int)t;
        n -= (float)n > t ? 1 : 0;
        float u = hash((unsigned)n), v = hash((unsigned)n + 1u);
        float w = (t - (float)n) * 4.0f - 3.0f;
        w = w > 0.0f ? w : 0.0f;
        float hardness = u * (1.0f - w) + v * w;
        float fade = s0.thick / (bare > s0.thick ? bare : s0.thick);
        hardness = 0.5f + (hardness - 0.5f) * fade;
        float over = bare - (s0.soft + span * hardness) * run, cover = 1.0f - sh;
        over = over > 0.0f ? over : 0.0f;
        cover = cover > 0.0f ? cover : 0.0f;
        float cut = s0.weather * cover * over;
        cut = cut < lh ? cut : lh;
        rest = lh - cut;
        sl += lh - rest;
        lh = rest;
        l[i] = down ? lh : li;
        l[j] = down ? lj : lh;
        s[i] = down ? sh : sl;
        s[j] = down ? sl : sh;
    };
    const int nx = s0.width, at = y * nx;
    const float diagonal = __builtin_sqrtf(s0.step_x * s0.step_x + s0.step_y * s0.step_y);
    for (int row = y; along && row < y + 2 && row < s0.height; ++row) {
        if (row < 0) continue;
        const float dip = s0.dip_y * (float)(s0.first_row + row);
        for (int p = 0; p < 2; ++p) {
            const int start = (p ^ turn ^ s0.first_column) & 1, pairs = (nx - start) / 2;
            #pragma clang loop vectorize(enable)
            for (int k = 0; k < pairs; ++k) {
                int x = start + 2 * k;
                settle(row * nx + x, row * nx + x + 1, s0.step_x, s0.dip_x * (float)(s0.first_column + x) + dip);
            }
        }
    }
    if (y < 0 || y + 1 >= s0.height) return;
    const float dip = s0.dip_y * (float)(s0.first_row + y);
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < nx; ++x)
        settle(at + x, at + nx + x, s0.step_y, s0.dip_x * (float)(s0.first_column + x) + dip);
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < nx - 1; ++x)
        settle(at + x, at + nx + x + 1, diagonal, s0.dip_x * (float)(s0.first_column + x) + dip);
    #pragma clang loop vectorize(enable)
    for (int x = 1; x < nx; ++x)
        settle(at + x, at + nx + x - 1, diagonal, s0.dip_x * (float)(s0.first_column + x) + dip);
"""


@wp.func_native(SETTLE_SLAB)
def settle_slab(s0: Slope, y: int, along: int, turn: int):
    """Move rock and scree down between samples in rows y and y + 1 where they are steeper than their angles of repose.

    In each pair of samples the scree moves first. Then rock of the upper sample breaks off and becomes scree of the
    lower one, the less the more scree covers it, and none under 1 m of scree. In faces higher than a bed, the angles of
    soft and hard beds differ less. Rows outside the raster are skipped. along: 1 to settle pairs along the rows, too,
    first those whose western column in the whole level has the parity of `turn`.
    """
    ...


@wp.kernel
def settle_slabs(offset: int, start: int, along: int, turn: int, slope: Slope):
    """Settle slab `offset + tid`: the pairs of samples in rows start + 2 * (offset + tid) and the next.

    start: -1 or 0. along: 1 to settle pairs along the rows, too, first those whose western column in the whole level
    has the parity of `turn`.
    """
    settle_slab(slope, start + 2 * (offset + wp.tid()), along, turn)


@wp.kernel
def vary_repose(offset: int, slope: Slope, longest: wp.float32, octaves: int, tangent: wp.float32):
    """Add noise to `base` in row `offset + tid`, so that the angle at which scree rests varies by about `tangent`.

    The noise has waves of `longest` metres and `octaves` - 1 shorter ones, at the same positions on every level.
    tangent: of the change of the angle. Scree settles on this rough base, and its depth is then added to the smooth
    one.
    """
    row = offset + wp.tid()
    for column in range(slope.width):
        x = wp.float64(slope.first_column + column) * wp.float64(slope.step_x)
        y = wp.float64(slope.first_row + row) * wp.float64(slope.step_y)
        wave = wp.float64(longest)
        total = wp.float64(0.0)
        for octave in range(octaves):
            seed = slope.seed + wp.uint32(octave + 1) * wp.uint32(-0x61C88647)  # 0x9E3779B9
            total += wave * value_noise(x / wave, y / wave, seed)[2]
            wave *= wp.float64(0.5)
            turned = wp.float64(0.8) * x - wp.float64(0.6) * y  # lattices of noise do not align
            y = wp.float64(0.6) * x + wp.float64(0.8) * y
            x = turned
        i = row * slope.width + column
        slope.base[i] = slope.base[i] + tangent * wp.float32(total)
