# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a user, a folder or a scene names: the only module that opens them for reading.

Opening a named pipe waits for a writer, perhaps for ever, and so does opening some devices. This module opens only
regular files, without waiting, and reads no more than a caller expects.
"""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from ..errors import TerrainError, shown

BLOCK_BYTES = 1 << 20
# Descriptors of this process: a shell's `<(command)` and /dev/stdin are pipes that the user connected on purpose.
DESCRIPTORS = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")


def open_regular(file: str | os.PathLike, links: bool = False) -> BufferedReader:
    """Open a regular file for reading, through a link only if `links`. Raises OSError for anything else."""
    if not links and os.path.islink(file):
        raise OSError("it is a link, not a regular file")
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOCTTY", 0)
    flags |= getattr(os, "O_BINARY", 0) | (0 if links else getattr(os, "O_NOFOLLOW", 0))
    try:
        descriptor = os.open(file, flags)
    except OSError as reason:
        if reason.errno in (errno.ENXIO, errno.ENODEV, errno.EOPNOTSUPP):  # a socket, or a missing device
            raise OSError("it is not a regular file") from None
        raise
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    raise OSError("it is not a regular file")


def read_start(file: str | os.PathLike, num_bytes: int, links: bool = True) -> bytes:
    """Return the first `num_bytes` bytes of a regular file, or all of it. links: follow links. Raises OSError."""
    with open_regular(file, links) as handle:
        return handle.read(num_bytes)


def read_regular(file: str | os.PathLike, max_bytes: int, links: bool = True) -> bytes:
    """Return the content of a regular file.

    Raises OSError, and ValueError for more than `max_bytes`. links: follow links.
    """
    with open_regular(file, links) as handle:
        return _read_limited(handle, max_bytes)


def read_named(
    file: str | os.PathLike, what: str, expected: str, max_bytes: int, links: bool = True, descriptors: bool = False
) -> bytes:
    """Return the content of a file that a user or a scene names.

    Args:
        what: the file's role, in errors: "The camera path".
        expected: its content, in errors: "a JSON file of keyframes".
        links: follow links.
        descriptors: also read a descriptor of this process to its end, such as /dev/stdin.

    Raises:
        TerrainError: the file is missing, larger than `max_bytes`, or not a regular file.
    """
    try:
        if descriptors and os.fspath(file).startswith(DESCRIPTORS):
            with Path(file).open("rb") as handle:
                return _read_limited(handle, max_bytes)
        return read_regular(file, max_bytes, links)
    except (OSError, ValueError) as reason:
        raise TerrainError(f"{what} {shown(file)} cannot be read ({cause(reason)})", expected=expected) from None


def cause(reason: Exception) -> str:
    """Return an error's message for brackets: one line without a full stop."""
    return shown(getattr(reason, "strerror", None) or reason).rstrip(".")


def blocks_reader(path: str | os.PathLike) -> bool:
    """Return whether a path leads to a pipe, a socket or a device; False for a file, a folder and a missing entry."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _read_limited(handle: BinaryIO, max_bytes: int) -> bytes:
    """Return a file's content from here to its end. Raises ValueError for more than `max_bytes`."""
    content = bytearray()
    while block := handle.read(BLOCK_BYTES):
        content += block
        if len(content) > max_bytes:
            raise ValueError(f"it is larger than {max_bytes:,} bytes")
    return bytes(content)
