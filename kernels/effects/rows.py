# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of a raster's drainage, and C snippets for the loops of routing over all samples.

The receiver is the neighbour that a sample drains to; `to` has its direction, 3 * (dy + 1) + dx + 1, and 4 for a root.
tests/kernels/test_routing_rows.py has each snippet in Python. No statement has a product and a sum, which some
processors would fuse and round differently. Nanoseconds for a sample of the island at 1025 x 1025, in C and in Warp:
receivers 1.3 and 18, donors 0.2 and 11, passes 3 and 11, pits 1 and 7, basins 7 and 10, order with areas 9 and 12.
"""

import warp as wp


@wp.struct
class Grid:
    """Samples in rows, and weights by direction: east-west, north-south, diagonal.

    `inverse_distance`: 1 / distance in 1/m. `share`: weight of the flow to several neighbours for a metre of fall.
    """

    width: wp.int32
    height: wp.int32
    inverse_distance: wp.vec3f
    share: wp.vec3d


@wp.struct
class DrainageArrays:
    """A raster and its drainage; arrays have an entry for each of its n samples, row by row."""

    grid: Grid
    h: wp.array(dtype=wp.float32)  # metres
    base: wp.array(dtype=wp.uint8)  # 1 where water leaves
    to: wp.array(dtype=wp.uint8)  # direction of the receiver: 3 * (dy + 1) + dx + 1; 4 for a root, which has none
    label: wp.array(dtype=wp.int32)  # number of the basin
    donors: wp.array(dtype=wp.uint8)  # number of donors
    order: wp.array(dtype=wp.int32)  # samples, donors before receivers
    area: wp.array(dtype=wp.float64)  # drainage area in samples; empty if it is not computed
    filled: wp.array(dtype=wp.float32)  # surface with lakes


@wp.func_native("""
    const int width = d.grid.width;
    const float* __restrict m = d.h.data + (size_t)y * width;
    const float* __restrict s = m - width;
    const float* __restrict n = m + width;
    const unsigned char* __restrict stops = d.base.data + (size_t)y * width;
    unsigned char* __restrict out = d.to.data + (size_t)y * width;
    const float ew = inverse_distance[0], ns = inverse_distance[1], across = inverse_distance[2];
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        unsigned a = noise + (unsigned)x, b;  // hashes: eight random bytes, one for each neighbour
        a = (a ^ (a >> 16)) * 0x7FEB352Du;
        a = (a ^ (a >> 15)) * 0x846CA68Bu;
        a = a ^ (a >> 16);
        b = (a ^ (a >> 15)) * 0x2C1B3C6Du;
        b = b ^ (b >> 16);
        float z = m[x], best = 0.0f, v, f;
        int k = 4;
        f = (float)(int)(a & 255) * step; f = f + lowest; v = (z - s[x - 1]) * across; v = v * f;
        k = v > best ? 0 : k; best = v > best ? v : best;
        f = (float)(int)((a >> 8) & 255) * step; f = f + lowest; v = (z - s[x]) * ns; v = v * f;
        k = v > best ? 1 : k; best = v > best ? v : best;
        f = (float)(int)((a >> 16) & 255) * step; f = f + lowest; v = (z - s[x + 1]) * across; v = v * f;
        k = v > best ? 2 : k; best = v > best ? v : best;
        f = (float)(int)(a >> 24) * step; f = f + lowest; v = (z - m[x - 1]) * ew; v = v * f;
        k = v > best ? 3 : k; best = v > best ? v : best;
        f = (float)(int)(b & 255) * step; f = f + lowest; v = (z - m[x + 1]) * ew; v = v * f;
        k = v > best ? 5 : k; best = v > best ? v : best;
        f = (float)(int)((b >> 8) & 255) * step; f = f + lowest; v = (z - n[x - 1]) * across; v = v * f;
        k = v > best ? 6 : k; best = v > best ? v : best;
        f = (float)(int)((b >> 16) & 255) * step; f = f + lowest; v = (z - n[x]) * ns; v = v * f;
        k = v > best ? 7 : k; best = v > best ? v : best;
        f = (float)(int)(b >> 24) * step; f = f + lowest; v = (z - n[x + 1]) * across; v = v * f;
        k = v > best ? 8 : k;
        out[x] = stops[x] ? 4 : (unsigned char)k;
    }
""")
def find_receivers_of_row(
    d: DrainageArrays, y: int, inverse_distance: wp.vec3f, lowest: wp.float32, step: wp.float32, noise: wp.uint32
):
    """Find the receivers of row y: steepest descents, each slope times a random factor.

    inverse_distance: 1 / metres to a neighbour east-west, north-south and on a diagonal. A factor is lowest + step *
    byte, the bytes from hashes of noise + column. Samples of `d.base` and those without a lower neighbour become roots.
    """
    ...


@wp.func_native("""
    const int width = d.grid.width;
    const unsigned char* __restrict m = d.to.data + (size_t)y * width;
    const unsigned char* __restrict s = m - width;
    const unsigned char* __restrict n = m + width;
    unsigned char* __restrict out = d.donors.data + (size_t)y * width;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x) {
        unsigned char low = (s[x - 1] == 8) + (s[x] == 7) + (s[x + 1] == 6) + (m[x - 1] == 5);
        unsigned char high = (m[x + 1] == 3) + (n[x - 1] == 2) + (n[x] == 1) + (n[x + 1] == 0);
        out[x] = low + high;
    }
""")
def count_donors_of_row(d: DrainageArrays, y: int):
    """Count the donors of the samples of row y, except its two ends; `count_donors` does those."""
    ...


@wp.func_native("""
    const int n = d.grid.width * d.grid.height;
    const unsigned char* __restrict t = d.to.data;
    const unsigned char* __restrict b = d.base.data;
    while (i < n) {
        // Pass over 64 samples without a pit.
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
def next_pit(d: DrainageArrays, i: int) -> int:
    """Return the first pit from sample i on: without a receiver and not an outlet; the number of samples if none."""
    ...


@wp.func_native("""
    const int width = d.grid.width;
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    int* l = d.label.data;
    const unsigned char* t = d.to.data;
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
def label_samples(d: DrainageArrays, first: int, end: int):
    """Label samples first .. end - 1, and those downstream of them, with the basin of their root.

    A label of 0 means that the sample has none yet; a root without a label has label 1.
    """
    ...


@wp.func_native("""
    const int width = d.grid.width;
    const int* __restrict m = d.label.data + (size_t)y * width;
    const int* __restrict n = m + width;
    int count = 0;
    #pragma clang loop vectorize(enable) interleave(enable)
    for (int x = 1; x < width - 1; ++x)
        count += (m[x] != m[x + 1]) + (m[x] != n[x - 1]) + (m[x] != n[x]) + (m[x] != n[x + 1]);
    return count + (m[0] != m[1]) + (m[0] != n[0]) + (m[0] != n[1]) + (m[width - 1] != n[width - 2])
        + (m[width - 1] != n[width - 1]);
""")
def passes_of_row(d: DrainageArrays, y: int) -> int:
    """Return the number of passes of row y: pairs of neighbours in different basins, to the east or north."""
    ...


@wp.func_native("""
    const int width = d.grid.width;
    const int* __restrict m = d.label.data + (size_t)y * width;
    const int* __restrict n = m + width;
    int* __restrict e = edge.data;
    const int ahead[4] = {1, width - 1, width, width + 1};
    for (int x = 0; x < width; ++x) {
        // Pass over 16 samples that have the label of all neighbours ahead.
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
                if (m[x] != m[x + ahead[q]]) e[at++] = (y * width + x) * 4 + q;
            }
        --x;
    }
""")
def list_passes_of_row(d: DrainageArrays, y: int, at: wp.int64, edge: wp.array(dtype=wp.int32)):
    """List the passes of row y from entry `at` on. edge: 4 * sample + direction - 5, directions 5 - 8."""
    ...


@wp.func_native("""
    const int width = d.grid.width;
    const int away[9] = {-width - 1, -width, 1 - width, -1, 0, 1, width - 1, width, width + 1};
    unsigned char* left = d.donors.data;
    const unsigned char* t = d.to.data;
    int* __restrict out = d.order.data;
    double* a = d.area.data;  // null: no areas
    for (int spring = 0; spring < width * d.grid.height; ++spring) {
        int i = spring;
        while (left[i] == 0) {
            left[i] = 255;
            *out++ = i;
            if (t[i] != 4) {
                const int j = i + away[t[i]];
                if (a) a[j] += a[i];
                --left[j];
                i = j;
            }
        }
    }
""")
def walk_downstream(d: DrainageArrays):
    """Fill `order` with donors before receivers, and add the area of each sample, if there are any, to its receiver's.

    It walks down from every spring, a sample without donors, and stops at a sample with a donor that is not yet in
    `order`. Overwrites `donors`: numbers of those that are not, and 255 for a sample in `order`.
    """
    ...


# A stable radix sort of numbers by 32-bit keys, the lower half first. It stores only the upper half of a key, between
# its two passes. KEY: bits of an unsigned key of number `i`, which increase in the order of the sort.
_SORT = """
    auto key = [&](int i) {
        KEY
    };
    int* __restrict out = numbers.data;
    int* __restrict half_sorted = scratch.data;
    unsigned short* __restrict upper = upper_halves.data;
    int *by_lower = starts.data, *by_upper = by_lower + 65536;
    for (int q = 0; q < count; ++q) {
        const unsigned k = key(out[q]);
        ++by_lower[k & 65535];
        ++by_upper[k >> 16];
    }
    for (int half = 0; half < 2; ++half) {  // from numbers of keys to the first entry of each
        int *start = half ? by_upper : by_lower, first = 0;
        for (int k = 0; k < 65536; ++k) {
            const int same = start[k];
            start[k] = first;
            first += same;
        }
    }
    for (int q = 0; q < count; ++q) {
        const unsigned k = key(out[q]);
        const int at = by_lower[k & 65535]++;
        half_sorted[at] = out[q];
        upper[at] = (unsigned short)(k >> 16);
    }
    for (int q = 0; q < count; ++q) out[by_upper[upper[q]]++] = half_sorted[q];
"""
# Bits of a float, which is not -0, as an unsigned number that increases with it.
_BITS = """unsigned bits;
        __builtin_memcpy(&bits, &z, 4);
        bits = bits >> 31 ? ~bits : bits | 0x80000000u;"""


@wp.func_native(
    _SORT.replace(
        "KEY",
        f"""const float z = d.filled.data[i] + 0.0f;  // 0 for -0
        {_BITS}
        return ~bits;""",
    )
)
def sort_from_top(
    d: DrainageArrays,
    count: int,
    numbers: wp.array(dtype=wp.int32),
    scratch: wp.array(dtype=wp.int32),
    upper_halves: wp.array(dtype=wp.uint16),
    starts: wp.array(dtype=wp.int32),
):
    """Sort `count` samples stably by `d.filled`, the highest first.

    numbers: the samples, sorted in place. scratch, upper_halves: [count], overwritten. starts: [2 * 65536] zeros,
    overwritten.
    """
    ...


@wp.func_native(
    _SORT.replace(
        "KEY",
        f"""const int width = d.grid.width, q = i & 3, a = i >> 2, b = a + (q ? width + q - 2 : 1);
        float z = d.h.data[a] > d.h.data[b] ? d.h.data[a] : d.h.data[b];
        z = z + 0.0f;  // 0 for -0
        {_BITS}
        return bits;""",
    )
)
def sort_passes_from_bottom(
    d: DrainageArrays,
    count: int,
    numbers: wp.array(dtype=wp.int32),
    scratch: wp.array(dtype=wp.int32),
    upper_halves: wp.array(dtype=wp.uint16),
    starts: wp.array(dtype=wp.int32),
):
    """Sort `count` passes stably by their heights, those of the higher sample in `d.h`, the lowest first.

    A pass is a pair of neighbours. numbers: the passes as 4 * sample + k, sorted in place; the other sample is the next
    one in the row (k = 0), or in the next row one column before, in the same, or one after it (k = 1, 2, 3). scratch,
    upper_halves: [count], overwritten. starts: [2 * 65536] zeros, overwritten.
    """
    ...
