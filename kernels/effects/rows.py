# SPDX-License-Identifier: GPL-3.0-or-later
"""Snippets of C for the loops of routing that every sample passes; tests/kernels/test_routing_rows.py says in Python
what each stands for. No product and sum stand in one statement: fused, they would round otherwise.

Rows, which Warp's own loops leave scalar, and walks, where its index checks and strides are half of the time.
Nanoseconds a sample of the island at 1025 x 1025, with them and in Warp alone: receivers 1.4 and 18, donors 0.3 and 11,
passes 14 and 14, pits 4 and 4, basins 13 and 13, order with areas 22 and 22.
"""

import warp as wp


@wp.func_native("""
    const float* __restrict m = h.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const unsigned char* __restrict stops = base.data + (size_t)y * width;
    unsigned char* __restrict out = to.data + (size_t)y * width;
    const float ew = nearness[0], ns = nearness[1], across = nearness[2];
    if (step == 0.0f) {
        #pragma clang loop vectorize(enable) interleave(enable)
        for (int x = 1; x < width - 1; ++x) {
            float z = m[x], best = 0.0f, v;
            int k = 4;
            v = (z - s[x - 1]) * across; k = v > best ? 0 : k; best = v > best ? v : best;
            v = (z - s[x]) * ns;         k = v > best ? 1 : k; best = v > best ? v : best;
            v = (z - s[x + 1]) * across; k = v > best ? 2 : k; best = v > best ? v : best;
            v = (z - m[x - 1]) * ew;     k = v > best ? 3 : k; best = v > best ? v : best;
            v = (z - m[x + 1]) * ew;     k = v > best ? 5 : k; best = v > best ? v : best;
            v = (z - n[x - 1]) * across; k = v > best ? 6 : k; best = v > best ? v : best;
            v = (z - n[x]) * ns;         k = v > best ? 7 : k; best = v > best ? v : best;
            v = (z - n[x + 1]) * across; k = v > best ? 8 : k;
            out[x] = stops[x] ? 4 : (unsigned char)k;
        }
        return;
    }
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        unsigned a = noise + (unsigned)x, b;
        a = (a ^ (a >> 16)) * 0x7FEB352Du;
        a = (a ^ (a >> 15)) * 0x846CA68Bu;
        a = a ^ (a >> 16);
        b = (a ^ (a >> 15)) * 0x2C1B3C6Du;
        b = b ^ (b >> 16);
        float z = m[x], best = 0.0f, v, f;
        int k = 4;
        f = (float)(int)(a & 255) * step; f = f + least; v = (z - s[x - 1]) * across; v = v * f;
        k = v > best ? 0 : k; best = v > best ? v : best;
        f = (float)(int)((a >> 8) & 255) * step; f = f + least; v = (z - s[x]) * ns; v = v * f;
        k = v > best ? 1 : k; best = v > best ? v : best;
        f = (float)(int)((a >> 16) & 255) * step; f = f + least; v = (z - s[x + 1]) * across; v = v * f;
        k = v > best ? 2 : k; best = v > best ? v : best;
        f = (float)(int)(a >> 24) * step; f = f + least; v = (z - m[x - 1]) * ew; v = v * f;
        k = v > best ? 3 : k; best = v > best ? v : best;
        f = (float)(int)(b & 255) * step; f = f + least; v = (z - m[x + 1]) * ew; v = v * f;
        k = v > best ? 5 : k; best = v > best ? v : best;
        f = (float)(int)((b >> 8) & 255) * step; f = f + least; v = (z - n[x - 1]) * across; v = v * f;
        k = v > best ? 6 : k; best = v > best ? v : best;
        f = (float)(int)((b >> 16) & 255) * step; f = f + least; v = (z - n[x]) * ns; v = v * f;
        k = v > best ? 7 : k; best = v > best ? v : best;
        f = (float)(int)(b >> 24) * step; f = f + least; v = (z - n[x + 1]) * across; v = v * f;
        k = v > best ? 8 : k;
        out[x] = stops[x] ? 4 : (unsigned char)k;
    }
""")
def find_receivers_of_row(
    y: wp.int32,
    width: wp.int32,
    nearness: wp.vec3f,
    least: wp.float32,
    step: wp.float32,
    noise: wp.uint32,
    h: wp.array(dtype=wp.float32),
    base: wp.array(dtype=wp.uint8),
    to: wp.array(dtype=wp.uint8),
): ...


@wp.func_native("""
    const unsigned char* __restrict m = to.data + (size_t)y * width;
    const unsigned char* __restrict s = m - width;
    const unsigned char* __restrict n = m + width;
    unsigned char* __restrict out = donors.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        unsigned char low = (s[x - 1] == 8) + (s[x] == 7) + (s[x + 1] == 6) + (m[x - 1] == 5);
        unsigned char high = (m[x + 1] == 3) + (n[x - 1] == 2) + (n[x] == 1) + (n[x + 1] == 0);
        out[x] = low + high;
    }
""")
def count_donors_of_row(
    y: wp.int32, width: wp.int32, to: wp.array(dtype=wp.uint8), donors: wp.array(dtype=wp.uint8)
): ...


@wp.func_native("""
    const unsigned char* __restrict t = to.data;
    const unsigned char* __restrict b = base.data;
    while (i < n) {
        if (i + 64 <= n) {
            unsigned char found = 0;
            #pragma clang loop vectorize(enable)
            for (int x = 0; x < 64; ++x) found |= (unsigned char)((t[i + x] == 4) & (b[i + x] == 0));
            if (!found) {
                i += 64;
                continue;
            }
        }
        const int end = i + 64 < n ? i + 64 : n;
        for (; i < end; ++i)
            if (t[i] == 4 && b[i] == 0) return i;
    }
    return n;
""")
def next_pit(i: wp.int32, n: wp.int32, to: wp.array(dtype=wp.uint8), base: wp.array(dtype=wp.uint8)) -> wp.int32:
    """The first sample from i on without a receiver that is not of `base`; n if there is none."""
    ...


@wp.func_native("""
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    int* l = label.data;
    const unsigned char* t = to.data;
    for (int i = first; i < end; ++i) {
        if (l[i]) continue;
        int at = i;
        while (!l[at] && t[at] != 4) at += away[t[at]];
        const int root = l[at] ? l[at] : 1;
        at = i;
        while (!l[at]) {
            l[at] = root;
            at += away[t[at]];
        }
    }
""")
def label_samples(
    first: wp.int32, end: wp.int32, width: wp.int32, to: wp.array(dtype=wp.uint8), label: wp.array(dtype=wp.int32)
): ...


@wp.func_native("""
    const int* __restrict m = label.data + (size_t)y * width;
    const int* __restrict n = m + width;
    int count = 0;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x)
        count += (m[x] != m[x + 1]) + (m[x] != n[x - 1]) + (m[x] != n[x]) + (m[x] != n[x + 1]);
    return count + (m[0] != m[1]) + (m[0] != n[0]) + (m[0] != n[1]) + (m[width - 1] != n[width - 2])
        + (m[width - 1] != n[width - 1]);
""")
def passes_of_row(y: wp.int32, width: wp.int32, label: wp.array(dtype=wp.int32)) -> wp.int32:
    """How many neighbours to the east and in the next row are of another basin."""
    ...


@wp.func_native("""
    const int* __restrict m = label.data + (size_t)y * width;
    const int* __restrict n = m + width;
    const float* __restrict z = h.data + (size_t)y * width;
    float* __restrict k = key.data;
    int* __restrict e = edge.data;
    const int ahead[4] = {1, width - 1, width, width + 1};
    for (int x = 0; x < width; ++x) {
        if (x >= 1 && x + 17 <= width) {
            int found = 0;
            #pragma clang loop vectorize(enable)
            for (int i = x; i < x + 16; ++i)
                found |= (m[i] ^ m[i + 1]) | (m[i] ^ n[i - 1]) | (m[i] ^ n[i]) | (m[i] ^ n[i + 1]);
            if (!found) {
                x += 15;
                continue;
            }
        }
        const int end = x + 16 < width ? x + 16 : width;
        for (; x < end; ++x)
            for (int q = 0; q < 4; ++q) {
                if ((q == 1 && x == 0) || ((q == 0 || q == 3) && x == width - 1)) continue;
                if (m[x] == m[x + ahead[q]]) continue;
                const float a = z[x], b = z[x + ahead[q]];
                k[at] = a > b ? a : b;
                e[at++] = (y * width + x) * 4 + q;
            }
        --x;
    }
""")
def list_passes_of_row(
    y: wp.int32,
    width: wp.int32,
    h: wp.array(dtype=wp.float32),
    label: wp.array(dtype=wp.int32),
    at: wp.int64,
    key: wp.array(dtype=wp.float32),
    edge: wp.array(dtype=wp.int32),
): ...


@wp.func_native("""
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    unsigned char* d = donors.data;
    const unsigned char* t = to.data;
    int* __restrict out = order.data;
    double* a = area.data;
    for (int spring = 0; spring < n; ++spring) {
        int i = spring;
        while (d[i] == 0) {
            d[i] = 255;
            *out++ = i;
            if (t[i] != 4) {
                const int j = i + away[t[i]];
                a[j] += a[i];
                --d[j];
                i = j;
            }
        }
    }
""")
def walk_downstream(
    n: wp.int32,
    width: wp.int32,
    to: wp.array(dtype=wp.uint8),
    donors: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    area: wp.array(dtype=wp.float64),
): ...
