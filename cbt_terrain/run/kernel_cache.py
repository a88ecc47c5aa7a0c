# SPDX-License-Identifier: GPL-3.0-or-later
"""Loading of kernels from Warp's cache, and compilation of missing or damaged ones.

Warp trusts its cache: a damaged object may crash the process or compute wrong numbers. So each object has a file with
its checksum beside it, and an object that does not match one is compiled again. LLVM ends the process on a full disk,
so room is reserved first. If the cache cannot be written, as in a read-only home, compiled kernels are written to a
temporary folder of this process and its children.
"""

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

import warp as wp

from ...kernels import has_temporary_cache, use_temporary_cache
from ..errors import TerrainError, shown
from . import compile_note
from .named_file import read_regular

CPU_BLOCK = 1  # threads of a block on the CPU: part of a compiled module's name
ROOM_BYTES = 4 << 20  # the largest module takes 0.7 MB: its source and its object
CHECKSUM = ".checksum"
MAX_OBJECT_BYTES = 1 << 28


def load(name: str) -> None:
    """Load the kernels of the Warp module `name`, from one thread at a time.

    If the cache fails, a temporary folder takes its place for this process, and loading is tried again. Raises
    TerrainError.
    """
    try:
        _load(name)
    except Exception as reason:  # Warp raises many kinds for its cache and its compiler
        if has_temporary_cache():
            raise _compile_error(name, reason) from reason
        _leave_cache(reason)
        wp.get_module(name).mark_modified()  # otherwise Warp does not retry a module that has failed
        try:
            _load(name)
        except Exception as again:
            raise _compile_error(name, again) from again


def compiled_file(name: str) -> Path:
    """Return the path of a module's object for this processor; the file appears when it is complete.

    A module's identifier is its name with a hash of its kernels, for blocks of one thread as on every CPU. A cache may
    serve several machines, as in a shared home: each kind of processor has a separate file in the folder.
    """
    identifier = wp.get_module(name).get_module_identifier(CPU_BLOCK)
    processor = wp.get_cpu_kernel_cache_key().rpartition("-")[2]
    return Path(wp.config.kernel_cache_dir) / identifier / f"{identifier}.cpu{processor}.o"


def ensure_writable() -> None:
    """Use a temporary folder if the cache cannot be written. Raises TerrainError."""
    try:
        with _build_folder():
            pass
    except OSError as reason:
        if not has_temporary_cache():
            _leave_cache(reason)


def _leave_cache(reason: Exception) -> None:
    """Write compiled kernels to a temporary folder, because the cache fails for `reason`. Raises TerrainError."""
    try:
        use_temporary_cache(shown(reason))
    except OSError as failed:
        raise TerrainError(
            f"Compiled kernels cannot be kept in the user's cache ({shown(reason)}) or a temporary folder",
            where=failed.filename or "",
            fix="set WARP_CACHE_PATH or TMPDIR to a folder that can be written",
        ) from failed


def _compile_error(name: str, reason: Exception) -> TerrainError:
    """Return the error of a module that cannot be compiled, with the cause."""
    return TerrainError(
        f"The kernels of {name} cannot be compiled in {wp.config.kernel_cache_dir} ({shown(reason)})",
        fix="make room there, or set WARP_CACHE_PATH to a folder that can be written",
    )


def _load(name: str) -> None:
    """Load a module's intact object, or compile it in a private folder and move it into the cache.

    Warp writes to the folder that its configuration names, so that folder is exchanged during the compilation.
    """
    file = compiled_file(name)
    if _is_whole(file):
        wp.load_module(name, device="cpu")
        return
    compile_note.note()
    cache = wp.config.kernel_cache_dir
    with _build_folder() as build:
        wp.config.kernel_cache_dir = build
        try:
            wp.load_module(name, device="cpu")
        finally:
            wp.config.kernel_cache_dir = cache
        with suppress(OSError):  # the kernels are loaded; the next process compiles them again
            _publish(Path(build) / file.parent.name, file)


def _build_folder() -> tempfile.TemporaryDirectory:
    """Make a folder in the cache with room for a compiled module, which the caller removes. Raises OSError."""
    folder = tempfile.TemporaryDirectory(prefix="build_", dir=wp.config.kernel_cache_dir, ignore_cleanup_errors=True)
    # A full disk raises here, and not in the middle of a compilation.
    with tempfile.TemporaryFile(dir=folder.name) as probe:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(probe.fileno(), 0, ROOM_BYTES)
        else:
            probe.write(bytes(ROOM_BYTES))
    return folder


def _publish(built: Path, file: Path) -> None:
    """Move a compiled module into the cache, while other processes may do the same or read. Raises OSError.

    built: the module's folder. file: path of its object in the cache.
    """
    object_file = built / file.name
    object_file.with_suffix(CHECKSUM).write_text(_checksum(object_file))
    try:
        built.rename(file.parent)
    except OSError:  # the folder is there: another processor's object, a damaged one, or another process was faster
        names = sorted(path.name for path in built.iterdir())
        for name in sorted(names, key=lambda name: name == file.name):  # the object last: others wait for its file
            (built / name).replace(file.parent / name)


def _is_whole(file: Path) -> bool:
    """Return whether a compiled object and its description match the checksum beside them."""
    try:
        return read_regular(file.with_suffix(CHECKSUM), max_bytes=100).decode("ascii") == _checksum(file)
    except (OSError, ValueError):
        return False


def _checksum(file: Path) -> str:
    """Return the checksum of an object and of the description that Warp reads with it. Raises OSError."""
    description = file.with_name(f"{file.parent.name}.meta")
    content = read_regular(file, MAX_OBJECT_BYTES) + read_regular(description, MAX_OBJECT_BYTES)
    return hashlib.blake2b(content, digest_size=16).hexdigest()
