# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels: arrays and numbers in, arrays out. No files, no state, no bpy.

A kernel with a parameter `offset` adds it to `wp.tid()`: a launch covers a range of the items, which begins there.

Only this module knows of a folder: the one in which Warp keeps compiled kernels. It is the user's cache, or a temporary
one where that cannot be used.
"""

import os
import pkgutil
import sys
import tempfile

import warp as wp

_temporary: tempfile.TemporaryDirectory | None = None


def _initialise_quietly() -> None:
    """Start Warp without its banner, and without the warning about a missing GPU that its C++ code writes to stderr."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        sink, saved = os.open(os.devnull, os.O_WRONLY), os.dup(2)
    except OSError:  # a window without a console has no stderr
        _initialise()
        return
    try:
        os.dup2(sink, 2)
        _initialise()
    finally:
        os.dup2(saved, 2)
        os.close(sink)
        os.close(saved)


def _initialise() -> None:
    """Start Warp with a folder for compiled kernels: the user's cache, or a temporary folder if that fails.

    Raises OSError if no temporary folder can be made either.
    """
    try:
        if wp.config.kernel_cache_dir is None and os.name == "posix" and not os.environ.get("WARP_CACHE_PATH"):
            wp.config.kernel_cache_dir = _default_cache()
        wp.init()
    except OSError as reason:
        use_temporary_cache(reason.strerror or str(reason))
        wp.config.kernel_cache_dir = None  # the environment names it
        wp.init()


def _default_cache() -> str:
    """Return Warp's default cache folder, always an absolute path. Raises OSError for a user without a home folder."""
    parents = ["~/Library/Caches"] if sys.platform == "darwin" else [os.environ.get("XDG_CACHE_HOME", ""), "~/.cache"]
    for parent in map(os.path.expanduser, parents):
        if os.path.isabs(parent):
            return os.path.join(parent, "warp")
    raise OSError("this user has no home folder")


def has_temporary_cache() -> bool:
    """Return whether compiled kernels are kept in a temporary folder."""
    return _temporary is not None


def use_temporary_cache(why: str) -> None:
    """Keep compiled kernels in a temporary folder of this process, which its child processes use, too.

    It is removed when the process ends, or by `remove_temporary_cache`. `why`: why the user's cache cannot be used, for
    the error. Raises OSError if no temporary folder can be made.
    """
    global _temporary
    try:
        folder = tempfile.TemporaryDirectory(prefix="adaptive_terrain_kernels_", ignore_cleanup_errors=True)
        cache = os.path.join(folder.name, wp.config.version)
        os.mkdir(cache)
    except OSError as reason:
        advice = "set WARP_CACHE_PATH or TMPDIR to a folder that can be written"
        text = f"compiled kernels cannot be kept in the user's cache ({why}) or a temporary folder: {advice}"
        raise OSError(reason.errno, text, reason.filename) from reason
    _temporary = folder
    os.environ["WARP_CACHE_PATH"], wp.config.kernel_cache_dir = folder.name, cache


def remove_temporary_cache() -> None:
    """Remove the temporary folder now, because the process is about to give up writing. Loaded kernels stay loaded."""
    if _temporary is not None:
        _temporary.cleanup()


def _switch_gradients_off() -> None:
    """Set Warp to compile no derivatives of our kernels, which are not used; that halves the compile time.

    Other add-ons' kernels keep their settings.
    """
    for found in pkgutil.walk_packages(__path__, f"{__name__}."):
        wp.set_module_options({"enable_backward": False}, found.name)


_initialise_quietly()
_switch_gradients_off()
