# SPDX-License-Identifier: GPL-3.0-or-later
"""Atomic operations and bit scans in C: on the CPU Warp's own atomics are a load, an operation and a store."""

import warp as wp


@wp.func_native("return __atomic_fetch_or(a.data + i, bits, __ATOMIC_RELAXED);")
def fetch_or(a: wp.array(dtype=wp.uint64), i: wp.int32, bits: wp.uint64) -> wp.uint64:
    """Set the bits of `bits` in a[i] in one atomic step; return the value of a[i] before."""
    ...


@wp.func_native("return __atomic_fetch_and(a.data + i, bits, __ATOMIC_RELAXED);")
def fetch_and(a: wp.array(dtype=wp.uint64), i: wp.int32, bits: wp.uint64) -> wp.uint64:
    """Clear all bits of a[i] that are 0 in `bits`, in one atomic step; return the value of a[i] before."""
    ...


@wp.func_native("return __atomic_fetch_xor(a.data + i, bits, __ATOMIC_RELAXED);")
def fetch_xor(a: wp.array(dtype=wp.uint64), i: wp.int32, bits: wp.uint64) -> wp.uint64:
    """Flip the bits of `bits` in a[i] in one atomic step; return the value of a[i] before."""
    ...


@wp.func_native("return __atomic_fetch_add(a.data + i, value, __ATOMIC_RELAXED);")
def fetch_add(a: wp.array(dtype=wp.int32), i: wp.int32, value: wp.int32) -> wp.int32:
    """Add `value` to a[i] in one atomic step; return the value of a[i] before."""
    ...


@wp.func_native(
    "int found = old; __atomic_compare_exchange_n(a.data + i, &found, value, false, __ATOMIC_ACQ_REL, "
    "__ATOMIC_ACQUIRE); return found;"
)
def compare_exchange(a: wp.array(dtype=wp.int32), i: wp.int32, old: wp.int32, value: wp.int32) -> wp.int32:
    """Set a[i] to `value` if it is `old`, in one atomic step; return the value before, which is `old` if it was set."""
    ...


@wp.func_native("return __builtin_popcountll(bits);")
def count_bits(bits: wp.uint64) -> wp.int32:
    """Return the number of bits that are 1."""
    ...


@wp.func_native("return bits ? __builtin_ctzll(bits) : 64;")
def lowest_bit(bits: wp.uint64) -> wp.int32:
    """Return the number of the lowest bit that is 1, counted from 0; 64 if none is."""
    ...


@wp.func_native("return 63 - __builtin_clzll(bits);")
def highest_bit(bits: wp.uint64) -> wp.int32:
    """Return the number of the highest bit that is 1, counted from 0; one must be."""
    ...
