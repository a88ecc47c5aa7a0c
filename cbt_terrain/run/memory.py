# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory of this machine."""

import ctypes
import os
import sys


def give_back() -> None:
    """Return freed memory of this process to the system, where the C library keeps it (glibc)."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(ctypes.c_size_t(0))


def physical_memory() -> int:
    """Return the bytes of memory in this machine; 8 GiB if the system does not report them."""
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return 8 << 30
