# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels: arrays and numbers in, arrays out. No files, no state, no bpy."""

import os

import warp as wp


def _initialise_quietly() -> None:
    """Start Warp without its banner, and without the warning about a missing GPU that its C++ code writes to stderr."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        sink, kept = os.open(os.devnull, os.O_WRONLY), os.dup(2)
    except OSError:  # a window without a console has no stderr
        wp.init()
        return
    try:
        os.dup2(sink, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(sink)
        os.close(kept)


_initialise_quietly()
