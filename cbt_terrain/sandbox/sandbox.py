# SPDX-License-Identifier: GPL-3.0-or-later
"""The rights that a process drops before it opens a file from outside. docs/trust.md lists them and the rest.

On Linux a seccomp filter allows only the system calls that an import needs (system_calls.py), and a Landlock ruleset
refuses to write outside one folder. Neither needs a privilege, and neither can be undone. The process also works on a
system without them: `enter` reports each. Constants are those of linux/landlock.h and linux/capability.h.
"""

import ctypes
import os
import platform
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from .system_calls import MACHINES, allow_only_listed, call, keep_limits

PR_SET_NO_NEW_PRIVS = 38
LANDLOCK_CREATE_RULESET, LANDLOCK_ADD_RULE, LANDLOCK_RESTRICT_SELF = 444, 445, 446
EXECUTE, WRITE_FILE, READ_FILE = 1, 2, 4
REMOVE_DIR, REMOVE_FILE, MAKE_DIR, MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
REFER, TRUNCATE, IOCTL_DEV = 1 << 13, 1 << 14, 1 << 15
ALL_WRITES = EXECUTE | WRITE_FILE | REFER | sum(int(1 << bit) for bit in range(4, 13))  # 4, 5: remove; 6 .. 12: make
IN_STORE = READ_FILE | WRITE_FILE | REMOVE_DIR | REMOVE_FILE | MAKE_DIR | MAKE_REG | REFER | TRUNCATE
READABLE_DEVICES = [Path("/dev", name) for name in ("null", "random", "urandom", "shm")]
BIND_AND_CONNECT_TCP, ABSTRACT_SOCKETS_AND_SIGNALS = 3, 3
CAPABILITIES_VERSION = 0x20080522
# Root may still read other users' files and write a store into another user's folder.
FILE_CAPABILITIES = 1 << 1 | 1 << 2  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
REMAINS = "kept"  # prefix of the report on a right that was not dropped


def enter(folder: Path | None) -> dict[str, str]:
    """Drop rights of this process for good, and return for each "dropped", or "kept: " and the reason.

    Landlock and capabilities hold for the calling thread and those that it starts later, so call this before others.

    Args:
        folder: existing folder in which files may still be written; None for no folder.
    """
    names = ("network", "programs", "processes", "writes")
    if sys.platform != "linux" or sys.maxsize < 2**32:
        return dict.fromkeys(names, f"{REMAINS}: only 64-bit Linux can drop it")
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, *map(ctypes.c_ulong, (1, 0, 0, 0)))  # the condition for Landlock and seccomp
    _die_first()  # if memory runs out
    writes = _outcome(_drop_writes, libc, folder)
    calls = _outcome(_drop_calls, libc)
    return dict.fromkeys(names, calls) | {"writes": writes}


def limit_memory(max_bytes: int) -> str:
    """Limit this process's allocated memory for good, and return the limit as text. Mapped files do not count."""
    if sys.platform != "linux":
        return f"{REMAINS}: only Linux can limit it"
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = max_bytes if hard == resource.RLIM_INFINITY else min(max_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    if platform.machine() in MACHINES:
        with suppress(OSError):  # without seccomp only root can raise the limit
            keep_limits(ctypes.CDLL(None, use_errno=True))
    return f"{limit / 1e9:.1f} GB at most"


def _outcome(drop: Callable[..., str], *arguments: object) -> str:
    """Call `drop` and return its text, or that the right remains because the kernel refuses."""
    try:
        return drop(*arguments)
    except OSError as reason:
        return f"{REMAINS}: this kernel refuses ({reason.strerror})"


def _die_first() -> None:
    """Let the kernel end this process before any other if memory runs out, and write no core file."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):  # no /proc
        Path("/proc/self/oom_score_adj").write_text("1000")


def _drop_calls(libc: ctypes.CDLL) -> str:
    """Drop root's capabilities and all system calls that are not listed; return the outcome in words.

    Raises OSError.
    """
    if platform.machine() not in MACHINES:
        return f"{REMAINS}: not known how on {platform.machine()}"
    _drop_capabilities(libc)
    allow_only_listed(libc)
    return "dropped"


def _drop_capabilities(libc: ctypes.CDLL) -> None:
    """Drop all of root's rights except those to read and write files. Raises OSError."""
    header, sets = struct.pack("Ii", CAPABILITIES_VERSION, 0), ctypes.create_string_buffer(24)
    if libc.capget(header, sets) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    # Effective, permitted and inheritable rights 0 .. 31, then those from 32 on, of which none is kept.
    effective, permitted, *_ = struct.unpack("6I", sets)
    reduced = struct.pack("6I", effective & FILE_CAPABILITIES, permitted & FILE_CAPABILITIES, 0, 0, 0, 0)
    if libc.capset(header, reduced) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _drop_writes(libc: ctypes.CDLL, folder: Path | None) -> str:
    """Restrict this process with Landlock: write in `folder` alone, read no devices; return the outcome in words.

    Later versions of Landlock also refuse TCP, device calls, abstract sockets and signals. Raises OSError.
    """
    version = call(libc, LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), 1)  # LANDLOCK_CREATE_RULESET_VERSION
    if version < 2:  # version 1 refuses every rename into another folder, which a store needs
        return f"{REMAINS}: this kernel's Landlock is too old"
    files = READ_FILE | ALL_WRITES | (TRUNCATE if version >= 3 else 0) | (IOCTL_DEV if version >= 5 else 0)
    network, scopes = [BIND_AND_CONNECT_TCP] * (version >= 4), [ABSTRACT_SOCKETS_AND_SIGNALS] * (version >= 6)
    # The rights that the ruleset refuses, 64 bits each: those to files, and what later versions know.
    attributes = struct.pack(f"{1 + len(network + scopes)}Q", files, *network, *scopes)
    ruleset = call(libc, LANDLOCK_CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), 0)
    try:
        for path in _readable():
            with suppress(OSError):  # such a path stays unreadable
                _allow(libc, ruleset, path, READ_FILE)
        if folder is not None:
            _allow(libc, ruleset, folder, IN_STORE & files)  # `files`: rights that this version knows
        call(libc, LANDLOCK_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)
    threads = len(os.listdir("/proc/self/task"))
    return "dropped" if threads == 1 else f"{REMAINS}: by {threads - 1} threads that were started before"


def _readable() -> list[Path]:
    """Return the folders of readable files: all but devices such as terminals, cameras and memory."""
    return [*(Path("/", name) for name in os.listdir("/") if name != "dev"), *READABLE_DEVICES]


def _allow(libc: ctypes.CDLL, ruleset: int, path: Path, access: int) -> None:
    """Add a right to a Landlock ruleset. access: bits of operations on `path` and all below. Raises OSError."""
    opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        rule_type, flags = 1, 0  # LANDLOCK_RULE_PATH_BENEATH
        call(libc, LANDLOCK_ADD_RULE, ruleset, rule_type, struct.pack("=Qi", access, opened), flags)
    finally:
        os.close(opened)
