# SPDX-License-Identifier: GPL-3.0-or-later
"""How much memory this machine has."""

import os


def physical_memory() -> int:
    """Bytes of memory in this machine; 8 GiB where that cannot be asked."""
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return 8 << 30
