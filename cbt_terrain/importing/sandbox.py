# SPDX-License-Identifier: GPL-3.0-or-later
"""What a process gives up before it opens a file from outside: the network, other programs, writing anywhere else.

On Linux a seccomp filter refuses sockets and programs, and a Landlock ruleset refuses to write below any folder but the
one named. Neither needs a privilege, and neither can be taken back. Elsewhere, and where the kernel has not got them,
nothing is given up and the process works all the same: `enter` says which. Numbers are those of the kernel's headers
(linux/landlock.h, linux/seccomp.h, asm/unistd.h).
"""

import ctypes
import os
import platform
import struct
import sys
from pathlib import Path

PR_SET_NO_NEW_PRIVS, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC = 38, 1, 1
LANDLOCK_CREATE_RULESET, LANDLOCK_ADD_RULE, LANDLOCK_RESTRICT_SELF = 444, 445, 446
ACCESS_WRITE_FILE, ACCESS_REMOVE_DIR, ACCESS_TRUNCATE = 1 << 1, 1 << 4, 1 << 14
# Write, remove (5: a file), make (6 to 12, of each kind), and 13: from one folder into another.
ACCESS_WRITES = ACCESS_WRITE_FILE | sum(int(1 << bit) for bit in range(4, 14))
# By machine: its AUDIT_ARCH, the call seccomp, and what is refused: socket, execve, execveat, ptrace,
# process_vm_writev and io_uring_setup, which can open sockets too.
MACHINES = {
    "x86_64": (0xC000003E, 317, (41, 59, 322, 101, 311, 425)),
    "aarch64": (0xC00000B7, 277, (198, 221, 281, 117, 271, 425)),
}
LOAD, JUMP_EQUAL, JUMP_AT_LEAST, RETURN = 0x20, 0x15, 0x35, 0x06  # of classic BPF
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | 13  # 13: EACCES
X32 = 0x40000000  # calls of x86_64's other numbering begin here
KEPT = "kept"  # what a process still has


def enter(folder: Path | None) -> dict[str, str]:
    """Give up what can be, for this process and for good; say of each whether it was: "dropped", or "kept" and why.

    folder: existing folder in which files may still be written; None: nowhere. Only the thread that calls and those
    that it starts later are held back from writing, so it is to be called before there are others.
    """
    if sys.platform != "linux" or sys.maxsize < 2**32:
        return dict.fromkeys(("network", "programs", "writes"), f"{KEPT}: only 64-bit Linux can drop it")
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, *map(ctypes.c_ulong, (1, 0, 0, 0)))
    writes = _outcome(_drop_writes, libc, folder)
    calls = _outcome(_drop_calls, libc)
    return {"network": calls, "programs": calls, "writes": writes}


def _outcome(drop, *arguments) -> str:
    try:
        return drop(*arguments)
    except OSError as reason:
        return f"{KEPT}: this kernel refuses ({reason.strerror})"


def _call(libc, number: int, *arguments) -> int:
    """One system call. Raises OSError."""
    result = libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _drop_calls(libc) -> str:
    if platform.machine() not in MACHINES:
        return f"{KEPT}: not known how on {platform.machine()}"
    audit_arch, seccomp, refused = MACHINES[platform.machine()]
    end = len(refused) + 5  # the last instruction refuses, the one before it allows; jumps count what they skip
    program = [(LOAD, 0, 0, 4), (JUMP_EQUAL, 0, end - 2, audit_arch), (LOAD, 0, 0, 0), (JUMP_AT_LEAST, end - 4, 0, X32)]
    program += [(JUMP_EQUAL, end - at - 1, 0, number) for at, number in enumerate(refused, start=4)]
    program += [(RETURN, 0, 0, ALLOW), (RETURN, 0, 0, REFUSE)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in program))
    filter_ = ctypes.create_string_buffer(struct.pack("HP", len(program), ctypes.addressof(code)))
    _call(libc, seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC, filter_)
    return "dropped"


def _drop_writes(libc, folder: Path | None) -> str:
    version = _call(libc, LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    if version < 2:  # the first one lets no file be moved from one folder into another, which a store needs
        return f"{KEPT}: this kernel's Landlock is too old"
    handled = ACCESS_WRITES | (ACCESS_TRUNCATE if version >= 3 else 0)
    ruleset = _call(libc, LANDLOCK_CREATE_RULESET, struct.pack("Q", handled), ctypes.c_size_t(8), 0)
    try:
        if folder is not None:
            _allow(libc, ruleset, folder, handled)
            _allow(libc, ruleset, folder.absolute().parent, ACCESS_REMOVE_DIR)  # of the folder, once it is empty
        _call(libc, LANDLOCK_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)
    return "dropped" if version >= 3 else "dropped, but for cutting files short"


def _allow(libc, ruleset: int, folder: Path, access: int) -> None:
    opened = os.open(folder, os.O_PATH | os.O_CLOEXEC)
    try:
        _call(libc, LANDLOCK_ADD_RULE, ruleset, 1, struct.pack("=Qi", access, opened), 0)
    finally:
        os.close(opened)


def limit_memory(most: int) -> str:
    """Let this process allocate `most` bytes at most (mapped files do not count); says whether that holds."""
    if sys.platform != "linux":
        return f"{KEPT}: only Linux can limit it"
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    return f"{most / 1e9:.1f} GB at most"
