# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory of this machine."""

import os


def physical_memory() -> int:
    """Return the bytes of memory in this machine; 8 GiB if the system does not report them."""
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return 8 << 30
