# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels: arrays and numbers in, arrays out. No files, no state, no bpy."""

import os
import pkgutil

import warp as wp


def _initialise_quietly() -> None:
    """Start Warp without its banner, and without the warning about a missing GPU that its C++ code writes to stderr."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        sink, kept = os.open(os.devnull, os.O_WRONLY), os.dup(2)
    except OSError:  # a window without a console has no stderr
        _initialise()
        return
    try:
        os.dup2(sink, 2)
        _initialise()
    finally:
        os.dup2(kept, 2)
        os.close(sink)
        os.close(kept)


def _initialise() -> None:
    try:
        wp.init()
    except OSError as reason:
        advice = f"compiled kernels cannot be kept there ({reason.strerror}): set WARP_CACHE_PATH to a folder that can"
        raise OSError(reason.errno, f"{advice} be written", reason.filename) from None


def _without_gradients() -> None:
    """Compile no kernel's derivative, half of the time: nobody asks for it. Other add-ons' modules stay as they are."""
    for found in pkgutil.walk_packages(__path__, f"{__name__}."):
        wp.set_module_options({"enable_backward": False}, found.name)


_initialise_quietly()
_without_gradients()
