# SPDX-License-Identifier: GPL-3.0-or-later
"""A sweep's measurement of a triangle in single precision: its distance from the surface, and pushes on its corners.

A *push* on a corner is the weighted sum of the distances by which points of the triangle are farther from the surface
than the aim; the weights are those of linear interpolation between the corners.
"""

import warp as wp

from ..field.domain import Domain
from .facet import Facet, bulge, height_above, is_beyond_border, twist_over

Pushes = wp.types.vector(length=7, dtype=wp.float32)


@wp.func_native("""
#pragma clang fp contract(off)
    typedef float lanes __attribute__((vector_size(32)));
    typedef int masks __attribute__((vector_size(32)));
    const float* data = d.samples.floats.data;
    const int width = d.samples.columns, height = d.samples.rows;
    const long long size = (long long)width * height;
    const int bits = d.unit_bits - d.levels;
    const int apex_x = apex[0] >> bits, left_x = (left[0] - apex[0]) >> bits, right_x = (right[0] - apex[0]) >> bits;
    const int apex_y = apex[1] >> bits, left_y = (left[1] - apex[1]) >> bits, right_y = (right[1] - apex[1]) >> bits;
    const int n = wp::max(wp::abs(left_x), wp::abs(left_y));  // cells along a leg, in x or y
    const float per_leg = 1.0f / ((float)left_x * (float)left_x + (float)left_y * (float)left_y);
    const float slope_x = (corner_climbs[0] * (float)left_x + corner_climbs[1] * (float)right_x) * per_leg;
    const float slope_y = (corner_climbs[0] * (float)left_y + corner_climbs[1] * (float)right_y) * per_leg;
    // The apex is high + low_part: float32 heights are compared with `high`, so that differences keep their digits.
    const float high = (float)z;
    const float low_part = (float)(z - (double)high);
    const bool level = left_x == 0 || left_y == 0;  // the legs lie along a row and a column
    const bool upright = left_x == right_x;  // the longest side lies along a column
    const lanes number = {0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f};
    const masks magnitude = (masks){} + 0x7fffffff, one = (masks){} + 0x3f800000;
    // Per lane: the largest distance; of the points beyond `aim`, the number and the sum of distances beyond it, either
    // also times their x and y.
    lanes largest = {}, count = {}, count_x = {}, count_y = {}, push = {}, push_x = {}, push_y = {};
    const long long origin = (long long)apex_y * width + apex_x;
    const int right_border = width - 1 - apex_x, upper_border = height - 1 - apex_y;  // nothing counts beyond
    const int south = wp::min(wp::min(left_y, right_y), 0);
    const int north = wp::min(wp::max(wp::max(left_y, right_y), 0), upper_border);
    for (int y = south; y <= north; ++y) {
        const int away = wp::abs(y);  // the row's first sample and their number, as in `row_of` (facet.py)
        int first = level ? (left_x + right_x < 0 ? away - n : 0) : upright ? (left_x > 0 ? away : -n) : -away;
        const int samples = !level && !upright ? 2 * away + 1 : n + 1 - away;
        const long long row = origin + (long long)y * width;
        const int last = wp::min(first + samples - 1, right_border);
        const float base = low_part + slope_y * (float)y;
        for (int x = first; x <= last; x += 8) {
            long long from = row + x;
            lanes heights;
            if (size >= 8) {  // not beyond the last sample
                from = wp::min(from, size - 8);
                __builtin_memcpy(&heights, data + from, sizeof(heights));
            } else {
                for (int k = 0; k < 8; ++k)
                    heights[k] = data[wp::min(from + k, size - 1)];
            }
            const lanes at = number + (float)(from - row);
            const masks inside = (at >= (float)x) & (at <= (float)last);
            // r: heights of the surface above the triangle; far: their magnitudes, 0 for samples outside the row.
            const lanes r = (heights - high) - (base + slope_x * at);
            const lanes far = (lanes)((masks)r & magnitude & inside);
            const masks more = far > largest;
            largest = (lanes)(((masks)far & more) | ((masks)largest & ~more));
            const masks beyond = far > aim;  // over: far - aim with the sign of r
            const lanes over = (lanes)(((masks)(far - aim) | ((masks)r & ~magnitude)) & beyond);
            const lanes hit = (lanes)(one & beyond);
            count += hit;
            count_x += hit * at;
            count_y += hit * (float)y;
            push += over;
            push_x += over * at;
            push_y += over * (float)y;
        }
    }
    float worst = 0.0f;
    for (int k = 0; k < 8; ++k)
        worst = largest[k] > worst ? largest[k] : worst;
    const auto sum = [](lanes v) { return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7])); };
    float c = sum(count), c_x = sum(count_x), c_y = sum(count_y);
    float p = sum(push), p_x = sum(push_x), p_y = sum(push_y);
    // Along the diagonals of cells the distance is a parabola, r0 (1 - t) + r1 t - twist t (1 - t).
    for (int side = 0; side < (level ? 1 : 2); ++side) {
        int x = level ? left_x : 0, y = level ? left_y : 0;
        const int end_x = level || side ? right_x : left_x, end_y = level || side ? right_y : left_y;
        const int dx = end_x > x ? 1 : -1, dy = end_y > y ? 1 : -1;
        // Cells skip .. end - 1 of the side are inside the border.
        const int skip = wp::max(wp::max(dx < 0 ? x - right_border : 0, dy < 0 ? y - upper_border : 0), 0);
        const int cells = wp::min(wp::abs(end_x - x), dx > 0 ? right_border - x : n);
        const int end = wp::min(cells, dy > 0 ? upper_border - y : n);
        if (skip >= end)
            continue;
        x += skip * dx;
        y += skip * dy;
        long long at = origin + (long long)y * width + x;
        float r0 = (data[at] - high) - (low_part + slope_x * (float)x + slope_y * (float)y);
        for (int k = skip; k < end; ++k) {
            const long long across = at + dx, along = at + dy * width, next = along + dx;
            const float r1 = (data[next] - high) - (low_part + slope_x * (float)(x + dx) + slope_y * (float)(y + dy));
            const float twist = (data[at] - data[across]) - (data[along] - data[next]);
            const float turn = r1 - r0 - twist;
            const bool bent = (turn * twist < 0.0f) & (wp::abs(turn) < 2.0f * wp::abs(twist));
            const float t = (bent ? -turn : 0.0f) / (bent ? 2.0f * twist : 1.0f);
            const float r = r0 + t * (turn + twist * t);
            const float far = wp::abs(r);
            worst = far > worst ? far : worst;
            const float hit = (bent & (far > aim)) ? 1.0f : 0.0f;  // no branches: they would be mispredicted
            const float over = hit * (r > 0.0f ? far - aim : aim - far);
            const float at_x = (float)x + t * (float)dx, at_y = (float)y + t * (float)dy;
            c += hit;
            c_x += hit * at_x;
            c_y += hit * at_y;
            p += over;
            p_x += over * at_x;
            p_y += over * at_y;
            r0 = r1;
            at = next;
            x += dx;
            y += dy;
        }
    }
    // The weights of the left and the right corner are linear in x and y, so their sums follow from those of x and y.
    const float c_left = (c_x * (float)left_x + c_y * (float)left_y) * per_leg;
    const float c_right = (c_x * (float)right_x + c_y * (float)right_y) * per_leg;
    const float p_left = (p_x * (float)left_x + p_y * (float)left_y) * per_leg;
    const float p_right = (p_x * (float)right_x + p_y * (float)right_y) * per_leg;
    const float found[7] = {worst, c - c_left - c_right, p - p_left - p_right, c_left, p_left, c_right, p_right};
    wp::vec_t<7, float> pushes;
    for (int k = 0; k < 7; ++k)
        pushes[k] = found[k];
    return pushes;
""")
def pushes_of(
    d: Domain,
    left: wp.vec2i,
    apex: wp.vec2i,
    right: wp.vec2i,
    z: wp.float64,
    corner_climbs: wp.vec2f,
    aim: wp.float32,
) -> Pushes:
    """Measure a triangle with its corners on samples against the bilinear surface over it.

    left, apex, right: its corners, lattice units; the apex, at the right angle, may be beyond the raster's border,
    where nothing counts. z: height of the apex. corner_climbs: heights of the left and of the right corner above the
    apex. Returns the largest distance, then for the apex, the left and the right corner the sum of the weights of the
    points beyond `aim`, and the weighted sum of their distances beyond it, positive upwards. Heights, distances and
    `aim` are metres before scaling. Points: samples, and extrema along the diagonals of cells on the triangle's sides.
    Nearly all time of a sweep passes here, in vectors of eight samples of a row.
    """
    ...


@wp.func
def add_point(pushes: Pushes, r: wp.float64, u: wp.float64, v: wp.float64, aim: wp.float64) -> Pushes:
    """Return `pushes` with one point added, at which the surface is `r` above the triangle (metres before scaling).

    u, v: weights of the left and the right corner at the point. aim: distance that is small enough. pushes: largest
    distance, then weight and push of the apex, the left and the right corner.
    """
    far = wp.abs(r)
    pushes[0] = wp.max(pushes[0], wp.float32(far))
    if far > aim:
        excess = wp.where(r > wp.float64(0.0), far - aim, aim - far)
        apex = wp.float64(1.0) - u - v
        pushes[1] = pushes[1] + wp.float32(apex)
        pushes[2] = pushes[2] + wp.float32(excess * apex)
        pushes[3] = pushes[3] + wp.float32(u)
        pushes[4] = pushes[4] + wp.float32(excess * u)
        pushes[5] = pushes[5] + wp.float32(v)
        pushes[6] = pushes[6] + wp.float32(excess * v)
    return pushes


@wp.func
def pushes_in_cell(d: Domain, facet: Facet, aim: wp.float64) -> Pushes:
    """Return the pushes of a triangle inside one cell: largest distance, then weight and push of each corner.

    All are 0 beyond the raster's border. Corners: apex, left, right. Points are the corners and the extrema along the
    diagonal sides. A weight is the sum over the points beyond `aim`, a push the weighted sum of their distances beyond
    it, metres before scaling, positive upwards.
    """
    if is_beyond_border(d, facet):
        return Pushes()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    apex = height_above(d, facet, 0, 0)
    left = height_above(d, facet, facet.left_x, facet.left_y)
    right = height_above(d, facet, facet.right_x, facet.right_y)
    q = add_point(Pushes(), apex, zero, zero, aim)
    q = add_point(q, left, one, zero, aim)
    q = add_point(q, right, zero, one, aim)
    if facet.left_x == 0 or facet.left_y == 0:  # the legs lie along a row and a column: the longest side is diagonal
        twist = twist_over(
            d,
            facet.x + facet.left_x,
            facet.y + facet.left_y,
            facet.right_x - facet.left_x,
            facet.right_y - facet.left_y,
        )
        t, r = bulge(left, right, twist)
        if t > zero:
            q = add_point(q, r, one - t, t, aim)
    else:  # both legs are diagonal
        t, r = bulge(apex, left, twist_over(d, facet.x, facet.y, facet.left_x, facet.left_y))
        if t > zero:
            q = add_point(q, r, t, zero, aim)
        t, r = bulge(apex, right, twist_over(d, facet.x, facet.y, facet.right_x, facet.right_y))
        if t > zero:
            q = add_point(q, r, zero, t, aim)
    return q
