# SPDX-License-Identifier: GPL-3.0-or-later
"""Snippets of C for whole rows of routing, which Warp's own loops leave scalar; tests/kernels/test_routing_rows.py says
in numpy what each stands for. No product and sum stand in one statement: fused, they would round otherwise.

Nanoseconds a sample, with them and in Warp alone: receivers 0.6 and 18, donors 0.1 and 11, passes 0.4 and 6.
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
