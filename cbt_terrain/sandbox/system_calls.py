# SPDX-License-Identifier: GPL-3.0-or-later
"""Seccomp filters that limit the system calls of a process and the arguments of some calls.

`ALLOWED` lists the calls that imports of every format were seen to make, with the variants that other C libraries use.
The kernel refuses every other call with EPERM. Calls from the number `FIRST_NEW` on fail with ENOSYS, so that a C
library falls back to an older call: from clone3, whose flags a filter cannot read, to clone. Numbers and constants are
those of the kernel's headers (asm/unistd.h, linux/audit.h, linux/filter.h, linux/seccomp.h).
"""

import ctypes
import errno
import os
import platform
import struct

# By machine: its AUDIT_ARCH, and its column in the table of calls.
MACHINES = {"x86_64": (0xC000003E, 0), "aarch64": (0xC00000B7, 1)}
SECCOMP, LIMITS = (317, 277), (302, 261)  # numbers of seccomp and prlimit64, by column
FIRST_NEW = 424  # from here on both machines have the same numbers
X32 = 0x40000000  # calls of x86_64's second numbering begin here
# By name: the numbers on x86_64 and aarch64, None where the machine lacks the call.
ALLOWED: dict[str, tuple[int | None, int | None]] = {
    **{"read": (0, 63), "write": (1, 64), "readv": (19, 65), "writev": (20, 66), "pread64": (17, 67)},
    **{"pwrite64": (18, 68), "preadv": (295, 69), "pwritev": (296, 70), "lseek": (8, 62), "close": (3, 57)},
    **{"open": (2, None), "openat": (257, 56), "dup": (32, 23), "dup2": (33, None), "dup3": (292, 24)},
    **{"pipe": (22, None), "pipe2": (293, 59), "fcntl": (72, 25), "ioctl": (16, 29), "flock": (73, 32)},
    **{"stat": (4, None), "lstat": (6, None), "fstat": (5, 80), "newfstatat": (262, 79), "statx": (332, 291)},
    **{"access": (21, None), "faccessat": (269, 48), "readlink": (89, None), "readlinkat": (267, 78)},
    **{"getcwd": (79, 17), "getdents64": (217, 61), "statfs": (137, 43), "fstatfs": (138, 44)},
    **{"ftruncate": (77, 46), "fallocate": (285, 47), "fsync": (74, 82), "fdatasync": (75, 83)},
    **{"fadvise64": (221, 223), "copy_file_range": (326, 285), "sendfile": (40, 71)},
    **{"mkdir": (83, None), "mkdirat": (258, 34), "rmdir": (84, None), "unlink": (87, None), "unlinkat": (263, 35)},
    **{"rename": (82, None), "renameat": (264, 38), "renameat2": (316, 276)},
    **{"mmap": (9, 222), "munmap": (11, 215), "mremap": (25, 216), "mprotect": (10, 226), "madvise": (28, 233)},
    **{"msync": (26, 227), "brk": (12, 214), "clone": (56, 220), "exit": (60, 93), "exit_group": (231, 94)},
    **{"futex": (202, 98), "set_robust_list": (273, 99), "rseq": (334, 293), "tgkill": (234, 131)},
    **{"sched_yield": (24, 124), "sched_getaffinity": (204, 123), "prctl": (157, 167), "seccomp": SECCOMP},
    **{"rt_sigaction": (13, 134), "rt_sigprocmask": (14, 135), "rt_sigreturn": (15, 139), "sigaltstack": (131, 132)},
    **{"restart_syscall": (219, 128), "poll": (7, None), "ppoll": (271, 73), "select": (23, None)},
    **{"pselect6": (270, 72), "nanosleep": (35, 101), "clock_nanosleep": (230, 115), "clock_gettime": (228, 113)},
    **{"clock_getres": (229, 114), "gettimeofday": (96, 169), "time": (201, None), "getpid": (39, 172)},
    **{"gettid": (186, 178), "getppid": (110, 173), "getuid": (102, 174), "geteuid": (107, 175)},
    **{"getgid": (104, 176), "getegid": (108, 177), "uname": (63, 160), "sysinfo": (99, 179)},
    **{"getrusage": (98, 165), "times": (100, 153), "getrandom": (318, 278), "getcpu": (309, 168)},
    **{"getrlimit": (97, 163), "prlimit64": LIMITS},
}
O_ACCMODE, O_TRUNC = 3, 0x200
MAP_SHARED, MAP_ANONYMOUS = 0x01, 0x20
CLONE_THREAD, CLONE_NEW = 0x00010000, 0x7E020080  # the second: a new namespace of any kind
# Copies of descriptors, flags and locks; not F_SETOWN, which sends signals to other processes.
FCNTL = (0, 1, 2, 3, 4, 5, 6, 7, 36, 37, 38, 1030)
IOCTL = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)  # TCGETS, TIOCGWINSZ, FIONREAD, FIONBIO, FIONCLEX, FIOCLEX
PRCTL = (15, 16)  # name a thread

# Of classic BPF: load a word of `struct seccomp_data`, mask it, compare it, return. An instruction is (one of these
# codes, instructions to skip if the comparison is true, instructions to skip if it is false, operand).
LOAD, AND, JUMP_EQUAL, JUMP_NOT_BELOW, RETURN = 0x20, 0x54, 0x15, 0x35, 0x06
NUMBER_AT, ARCH_AT, ARGUMENTS_AT, WORD = 0, 4, 16, 0xFFFFFFFF
ALLOW, REFUSE, UNKNOWN = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS

# Test of a call's arguments: index of a 32-bit word, a mask, and the allowed values of the masked word.
Test = tuple[int, int, tuple[int, ...]]


def tested_arguments() -> dict[str, list[Test]]:
    """Return the tests of arguments by call, each (word, mask, values): word & mask must be one of the values.

    Word 2 i is the low half of argument i. A call with several tests must pass all. FCNTL, IOCTL and PRCTL list the
    commands of these calls that are allowed.
    """
    # All but O_TRUNC for reading, which cuts a file short: Landlock refuses that only from version 3.
    opened = (0, 1, 2, 3, O_TRUNC | 1, O_TRUNC | 2, O_TRUNC | 3)
    return {
        "open": [(2, O_ACCMODE | O_TRUNC, opened)],
        "openat": [(4, O_ACCMODE | O_TRUNC, opened)],
        # No anonymous shared memory, which RLIMIT_DATA ignores.
        "mmap": [(6, MAP_SHARED | MAP_ANONYMOUS, (0, MAP_SHARED, MAP_ANONYMOUS))],
        "clone": [(0, CLONE_THREAD | CLONE_NEW, (CLONE_THREAD,))],  # threads, no processes
        "tgkill": [(0, WORD, (os.getpid(),))],  # signals to this process alone
        "prlimit64": [(0, WORD, (0,))],  # limits of this process alone
        "fcntl": [(2, WORD, FCNTL)],
        "ioctl": [(2, WORD, IOCTL)],
        "prctl": [(0, WORD, PRCTL)],
        "seccomp": [(0, WORD, (1,))],  # may add filters
    }


def allow_only_listed(libc: ctypes.CDLL) -> None:
    """Refuse every call but those of `ALLOWED`, on all threads, for good. Raises OSError.

    `ALLOWED` has the numbers of a call on each kind of machine, None where there is no such call.
    """
    tests, column = tested_arguments(), MACHINES[platform.machine()][1]
    lines = []
    for name, numbers in ALLOWED.items():
        if (number := numbers[column]) is not None:
            lines += _allow(number, tests.get(name, []))
    _install(libc, [*lines, (RETURN, 0, 0, REFUSE)])


def keep_limits(libc: ctypes.CDLL) -> None:
    """Refuse changes of a resource limit, on all threads, for good. Raises OSError."""
    number = LIMITS[MACHINES[platform.machine()][1]]
    _install(libc, [*_allow(number, [(4, WORD, (0,)), (5, WORD, (0,))]), (RETURN, 0, 0, ALLOW)])  # no new limit


def _allow(number: int, tests: list[Test]) -> list[tuple]:
    """Return instructions that allow a call if its arguments pass the tests, refuse it otherwise, and skip other calls.

    They expect the call's number in the accumulator. tests: (index of a 32-bit word of the arguments, mask, allowed
    values of the masked word).
    """
    decision = []
    for word, mask, values in tests:
        decision += [(LOAD, 0, 0, ARGUMENTS_AT + 4 * word), (AND, 0, 0, mask)]
        # an allowed value jumps over the refusal
        decision += [(JUMP_EQUAL, len(values) - i, 0, value) for i, value in enumerate(values)]
        decision += [(RETURN, 0, 0, REFUSE)]
    decision += [(RETURN, 0, 0, ALLOW)]
    return [(JUMP_EQUAL, 0, len(decision), number), *decision]


def _install(libc: ctypes.CDLL, lines: list[tuple]) -> None:
    """Install a seccomp filter on all threads for good. `lines`: BPF instructions that decide about a call.

    They follow a preamble that refuses other architectures and the x32 ABI, and answers "unknown call" to calls that
    are newer than the list, so that libraries fall back to older ones. Raises OSError.
    """
    audit_arch, column = MACHINES[platform.machine()]
    program = [  # of the preamble: another architecture, x32, a new call
        *((LOAD, 0, 0, ARCH_AT), (JUMP_EQUAL, 1, 0, audit_arch), (RETURN, 0, 0, REFUSE)),
        *((LOAD, 0, 0, NUMBER_AT), (JUMP_NOT_BELOW, 0, 1, X32), (RETURN, 0, 0, REFUSE)),
        *((JUMP_NOT_BELOW, 0, 1, FIRST_NEW), (RETURN, 0, 0, UNKNOWN)),
        *lines,
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in program))
    filter_ = ctypes.create_string_buffer(struct.pack("HP", len(program), ctypes.addressof(code)))
    call(libc, SECCOMP[column], 1, 1, filter_)  # SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC


def call(libc: ctypes.CDLL, number: int, *arguments: object) -> int:
    """Make one system call and return its result. Raises OSError."""
    result = libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result
