# SPDX-License-Identifier: GPL-3.0-or-later
"""Applies the import's sandbox to a process and tries to get out: `python escape_attempts.py FOLDER [UID]` prints JSON.

A second process of the same user is the victim. Started as root, both become the user UID first (0: they stay root).
Numbers of system calls are looked up in the kernel's headers, which share nothing with the sandbox's tables.
"""

import ctypes
import fcntl
import json
import mmap
import os
import platform
import re
import resource
import signal
import socket
import struct
import sys
import threading
import time
from pathlib import Path

HEADERS = {"x86_64": "/usr/include/x86_64-linux-gnu/asm/unistd_64.h", "aarch64": "/usr/include/asm-generic/unistd.h"}
libc = ctypes.CDLL(None, use_errno=True)


def kernel_numbers(machine: str) -> dict[str, int]:
    """Return the numbers of a machine's system calls by the kernel's header; {} where it is not installed."""
    try:
        text = Path(HEADERS[machine]).read_text()
    except (KeyError, OSError):
        return {}
    shared = {"fstatat": "newfstatat"}  # names that asm-generic/unistd.h gives to calls of 32 and 64 bits together
    found = re.findall(r"#define __NR(3264)?_(\w+) (\d+)\n", text)
    return {shared.get(name, name) if both else name: int(number) for both, name, number in found}


NUMBERS = kernel_numbers(platform.machine())


def raw(name: str, *arguments) -> int:
    """Make a system call by its name. Raises OSError."""
    ctypes.set_errno(0)
    result = libc.syscall(ctypes.c_long(NUMBERS[name]), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def start_victim(folder: Path) -> int:
    """Fork a process that owns a datagram socket and waits."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        server = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        server.bind(str(folder / "service"))
        libc.prctl(4, 1, 0, 0, 0)  # dumpable, as any program is that has not changed its user
        os.write(writer, b"x")
        for stream in (1, 2):  # the test waits for their end
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        time.sleep(600)
        os._exit(0)
    os.read(reader, 1)
    return pid


def socket_attempts(folder: Path, *_):
    service = str(folder / "service")
    yield "socket", socket.socket
    yield "unix socket", lambda: socket.socket(socket.AF_UNIX)
    yield "netlink socket", lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)
    yield "socketpair", socket.socketpair
    yield "datagram", lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].sendto(b"x", service)
    yield "bound datagram", lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].bind("\0abstract")
    yield "io_uring_setup", lambda: raw("io_uring_setup", 8, ctypes.create_string_buffer(120))


def process_attempts(_folder: Path, victim: int):
    hard = resource.RLIM_INFINITY
    yield "fork", fork
    yield "vfork", lambda: raw("clone", 0x4000 | signal.SIGCHLD, 0, 0, 0, 0)
    yield "clone3", lambda: raw("clone3", ctypes.create_string_buffer(struct.pack("8Q", 0, *[0] * 3, 17, 0, 0, 0)), 64)
    yield "execve", lambda: os.execv("/bin/true", ["true"])
    yield "posix_spawn", lambda: os.posix_spawn("/bin/true", ["true"], {})
    yield "kill", lambda: os.kill(victim, signal.SIGUSR1)
    yield "kill without a signal", lambda: os.kill(victim, 0)
    yield "kill the parent", lambda: os.kill(os.getppid(), signal.SIGUSR1)
    yield "kill all", lambda: os.kill(-1, 0)
    yield "killpg", lambda: os.killpg(victim, signal.SIGUSR1)
    yield "tgkill", lambda: raw("tgkill", victim, victim, signal.SIGUSR1)
    yield "tkill", lambda: raw("tkill", victim, signal.SIGUSR1)
    yield "rt_sigqueueinfo", lambda: raw("rt_sigqueueinfo", victim, 10, ctypes.create_string_buffer(128))
    yield "pidfd_open", lambda: raw("pidfd_open", victim, 0)
    yield "signal of a pipe", lambda: fcntl.fcntl(os.pipe()[0], fcntl.F_SETOWN, victim)
    yield "signal of a pipe's thread", lambda: fcntl.fcntl(os.pipe()[0], 15, struct.pack("ii", 0, victim))
    yield "prlimit", lambda: resource.prlimit(victim, resource.RLIMIT_FSIZE, (0, 0))
    yield "read limits", lambda: resource.prlimit(victim, resource.RLIMIT_FSIZE)
    yield "setpriority", lambda: os.setpriority(os.PRIO_PROCESS, victim, 19)
    yield "ioprio_set", lambda: raw("ioprio_set", 1, victim, 3 << 13)
    yield "sched_setaffinity", lambda: os.sched_setaffinity(victim, {0})
    yield "sched_setscheduler", lambda: os.sched_setscheduler(victim, os.SCHED_IDLE, os.sched_param(0))
    yield "setpgid", lambda: os.setpgid(0, os.getppid())
    yield "setsid", os.setsid
    yield "ptrace", lambda: raw("ptrace", 16, victim, 0, 0)
    yield "process_vm_readv", lambda: raw("process_vm_readv", victim, 0, 0, 0, 0, 0)
    yield "process_vm_writev", lambda: raw("process_vm_writev", victim, 0, 0, 0, 0, 0)
    yield "process_madvise", lambda: raw("process_madvise", 0, 0, 0, 0, 0)
    yield "kcmp", lambda: raw("kcmp", os.getpid(), victim, 0, 0, 0)
    yield "migrate_pages", lambda: raw("migrate_pages", victim, 1, ctypes.create_string_buffer(8), None)
    yield "memory of the victim", lambda: open(f"/proc/{victim}/mem", "r+b")
    yield "environment of the victim", lambda: open(f"/proc/{victim}/environ", "rb").read()
    yield "maps of the victim", lambda: open(f"/proc/{victim}/maps", "rb").read()
    yield "own memory", lambda: open("/proc/self/mem", "r+b")
    yield "own limit", lambda: resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
    yield "same limit", lambda: resource.setrlimit(resource.RLIMIT_DATA, resource.getrlimit(resource.RLIMIT_DATA))
    yield "core files", lambda: resource.setrlimit(resource.RLIMIT_CORE, (hard, hard))
    yield "out of memory score", lambda: Path("/proc/self/oom_score_adj").write_text("0")
    yield "dumpable", lambda: check(libc.prctl(4, 1, 0, 0, 0))
    yield "setuid", lambda: os.setuid(1)
    yield "capset", lambda: raw("capset", struct.pack("Ii", 0x20080522, 0), struct.pack("6I", *[0xFFFFFFFF] * 6))


def fork() -> None:
    if os.fork() == 0:
        os._exit(0)


def check(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def kernel_attempts(folder: Path, *_):
    for flag in (0x10000000, 0x20000, 0x40000000, 0x08000000, 0x04000000, 0x20000000, 0x02000000, 0x80):
        yield f"unshare {flag:#x}", lambda flag=flag: raw("unshare", flag)
    yield "clone of a namespace", lambda: raw("clone", 0x10000000 | 0x10000 | 0x800 | 0x100, 0, 0, 0, 0)
    yield "setns", lambda: raw("setns", os.open("/proc/self/ns/net", os.O_RDONLY), 0)
    yield "mount", lambda: raw("mount", b"none", str(folder).encode(), b"tmpfs", 0, 0)
    yield "open_tree", lambda: raw("open_tree", -100, b"/", 0)
    yield "fsopen", lambda: raw("fsopen", b"tmpfs", 0)
    yield "pivot_root", lambda: raw("pivot_root", b".", b".")
    yield "chroot", lambda: os.chroot(folder)
    yield "add_key", lambda: raw("add_key", b"user", b"hostile", b"x", 1, -3)
    yield "request_key", lambda: raw("request_key", b"user", b"hostile", None, 0)
    yield "keyctl", lambda: raw("keyctl", 1, None)
    yield "userfaultfd", lambda: raw("userfaultfd", 1)
    yield "bpf", lambda: raw("bpf", 0, ctypes.create_string_buffer(128), 128)
    attributes = struct.pack("II", 1, 112) + bytes(104)
    yield "perf_event_open", lambda: raw("perf_event_open", ctypes.create_string_buffer(attributes), 0, -1, -1, 0)
    yield "fanotify_init", lambda: raw("fanotify_init", 0, 0)
    yield "inotify_init", lambda: check(libc.inotify_init())
    yield "personality", lambda: raw("personality", 0x0040000)
    yield "sethostname", lambda: raw("sethostname", b"x", 1)
    yield "settimeofday", lambda: raw("settimeofday", ctypes.create_string_buffer(16), None)
    yield "syslog", lambda: raw("syslog", 3, ctypes.create_string_buffer(16), 16)
    yield "reboot", lambda: raw("reboot", 0, 0, 0, 0)
    yield "quotactl", lambda: raw("quotactl", 0, None, 0, None)
    yield "seccomp listener", lambda: raw("seccomp", 2, 0, ctypes.create_string_buffer(b"\0\0\xff\x7f", 4))
    yield "a later landlock", lambda: raw("landlock_create_ruleset", struct.pack("Q", 1), 8, 0)
    if platform.machine() == "x86_64":
        yield "call of the x32 numbering", lambda: check(libc.syscall(ctypes.c_long(0x40000000 + 39)))
        yield "call of 32 bits", call_of_32_bits


def call_of_32_bits() -> None:
    """Call getpid through int 0x80."""
    code = mmap.mmap(-1, 4096, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=7)
    code.write(b"\xb8\x14\0\0\0\xcd\x80\xc3")
    result = ctypes.CFUNCTYPE(ctypes.c_int)(ctypes.addressof(ctypes.c_char.from_buffer(code)))()
    if result < 0:
        raise OSError(-result, os.strerror(-result))


def memory_attempts(folder: Path, *_):
    yield "more memory", lambda: mmap.mmap(-1, 2 << 30, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    yield "shared memory", lambda: mmap.mmap(-1, 2 << 30)
    yield "memfd", lambda: os.memfd_create("x")
    yield "memfd_secret", lambda: raw("memfd_secret", 0)
    yield "shmget", lambda: raw("shmget", 0x1234567, 4096, 0o1600)
    yield "semget", lambda: raw("semget", 0x1234567, 1, 0o1600)
    yield "msgget", lambda: raw("msgget", 0x1234567, 0o1600)
    yield "mq_open", lambda: raw("mq_open", b"hostile", os.O_CREAT | os.O_RDWR, 0o600, None)
    yield "POSIX shared memory", lambda: open("/dev/shm/hostile", "w")
    yield "zero pages", lambda: mmap.mmap(os.open("/dev/zero", os.O_RDONLY), 2 << 30, prot=mmap.PROT_READ)
    yield "mlock", lambda: check(libc.mlockall(3))


def file_attempts(folder: Path, victim: int):
    file, empty, store = folder / "victim.txt", folder / "empty", folder / "store"
    yield "new file", lambda: open(folder / "x", "w")
    yield "new file under a path with dots", lambda: open(store / ".." / "x", "w")
    yield "new folder", lambda: os.mkdir(folder / "y")
    yield "new file in the temporary folder", lambda: open("/tmp/hostile_escape", "w")
    yield "write", lambda: open(file, "r+")
    yield "append", lambda: open(file, "a")
    yield "write through a link in the store", lambda: open(store / "link", "r+")
    yield "write into a folder through a link in the store", lambda: open(store / "out" / "x", "w")
    yield "truncate", lambda: os.truncate(file, 0)
    yield "truncate while opening", lambda: os.open(file, os.O_RDONLY | os.O_TRUNC)
    yield "unlink", lambda: os.unlink(file)
    yield "rmdir", lambda: os.rmdir(empty)
    yield "rename", lambda: os.rename(file, folder / "y")
    yield "rename into the store", lambda: os.rename(file, store / "y")
    yield "rename out of the store", lambda: os.rename(store / "own", folder / "own")
    yield "rename of the store", lambda: os.rename(store, folder / "other")
    yield "exchange", lambda: raw("renameat2", -100, bytes(file), -100, bytes(store / "own"), 2)
    yield "hard link into the store", lambda: os.link(file, store / "y")
    yield "hard link out of the store", lambda: os.link(store / "own", folder / "y")
    yield "symbolic link in the store", lambda: os.symlink("/etc", store / "y")
    yield "pipe in the store", lambda: os.mkfifo(store / "y")
    yield "device in the store", lambda: os.mknod(store / "y", 0o020600, os.makedev(1, 3))
    yield "socket file in the store", lambda: os.mknod(store / "y", 0o140600)
    yield "chmod", lambda: os.chmod(file, 0o777)
    yield "fchmod", lambda: os.fchmod(os.open(file, os.O_RDONLY), 0o777)
    yield "chmod of a folder", lambda: os.chmod(empty, 0)
    yield "chown", lambda: os.chown(file, -1, os.getgid())
    yield "utime", lambda: os.utime(file, (0, 0))
    yield "futimens", lambda: os.utime(os.open(file, os.O_RDONLY), (0, 0))
    yield "setxattr", lambda: os.setxattr(file, "user.x", b"1")
    yield "fsetxattr", lambda: os.setxattr(os.open(file, os.O_RDONLY), "user.x", b"1")
    yield "removexattr", lambda: os.removexattr(file, "user.x")
    yield "flags of a file", lambda: fcntl.ioctl(os.open(file, os.O_RDONLY), 0x40086602, struct.pack("l", 0))
    yield "lease", lambda: fcntl.fcntl(os.open(file, os.O_RDONLY), fcntl.F_SETLEASE, fcntl.F_RDLCK)
    yield "notify", lambda: fcntl.fcntl(os.open(folder, os.O_RDONLY), fcntl.F_NOTIFY, fcntl.DN_MODIFY)
    yield "handle", lambda: raw("name_to_handle_at", -100, bytes(file), ctypes.create_string_buffer(136), None, 0)
    yield "open_by_handle_at", lambda: raw("open_by_handle_at", 3, 0, 0)
    yield "pipe outside", lambda: os.open(folder / "pipe", os.O_WRONLY | os.O_NONBLOCK)
    yield "null device for writing", lambda: open("/dev/null", "w")
    yield "terminal", lambda: os.open("/dev/ptmx", os.O_RDONLY)
    yield "console", lambda: os.open("/dev/console", os.O_RDONLY | os.O_NOCTTY)
    yield "descriptor of the victim", lambda: open(f"/proc/{victim}/fd/0", "w")
    yield "setting of the kernel", lambda: open("/proc/sys/kernel/core_pattern", "w")
    yield "name of the victim", lambda: open(f"/proc/{victim}/comm", "w")
    yield "control group", lambda: open("/sys/fs/cgroup/cgroup.procs", "w")


def needed_attempts(folder: Path, *_):
    """Yield what must stay possible, since an import does it."""
    store = folder / "store"
    threads = []

    def thread() -> None:
        other = threading.Thread(target=lambda: threads.append((store / "thread").write_text("x")))
        other.start()
        other.join()
        if not threads:
            raise OSError(1, "the thread could not write")

    yield "write in the store", lambda: (store / "new").write_text("x")
    yield "folder in the store", lambda: (store / "data").mkdir()
    yield "rename in the store", lambda: os.rename(store / "new", store / "data" / "new")
    yield "map in the store", lambda: mmap.mmap(os.open(store / "data" / "new", os.O_RDWR), 1)
    yield "truncate in the store", lambda: os.ftruncate(os.open(store / "data" / "new", os.O_RDWR), 9)
    yield "unlink in the store", lambda: os.unlink(store / "data" / "new")
    yield "rmdir in the store", lambda: os.rmdir(store / "data")
    yield "a thread that writes in the store", thread
    yield "read a file", lambda: open(folder / "victim.txt").read()
    yield "read random numbers", lambda: open("/dev/urandom", "rb").read(1)
    yield "a signal to itself", lambda: signal.raise_signal(signal.SIGCHLD)


def attempt(do) -> str:
    """Return "" where an attempt succeeds, else why it did not."""
    try:
        do()
    except (OSError, MemoryError, ValueError) as reason:
        return str(reason) or type(reason).__name__
    return ""


def new_folder(folder: Path) -> None:
    """Create the targets of the attempts."""
    for name in ("store", "empty"):
        (folder / name).mkdir()
    (folder / "victim.txt").write_text("precious")
    (folder / "store" / "own").write_text("own")
    (folder / "store" / "link").symlink_to(folder / "victim.txt")
    (folder / "store" / "out").symlink_to(folder)
    os.mkfifo(folder / "pipe")


def main(folder: Path, uid: int) -> None:
    from adaptive_terrain.cbt_terrain.sandbox import sandbox

    if os.getuid() == 0 and uid:
        os.setgroups([])
        os.setgid(uid)
        os.setuid(uid)
    new_folder(folder)
    victim = start_victim(folder)
    held = os.open(folder / "pipe", os.O_RDONLY | os.O_NONBLOCK)  # otherwise no writer can open it
    report = sandbox.enter(folder / "store") | {"memory": sandbox.limit_memory(1 << 30)}
    found, groups = {}, (socket_attempts, process_attempts, kernel_attempts, memory_attempts, file_attempts)
    for group in (*groups, needed_attempts):
        found[group.__name__] = {name: attempt(do) for name, do in group(folder, victim)}
    os.close(held)
    print(json.dumps({"report": report, "attempts": found, "victim": victim}), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int((*sys.argv[2:], "65534")[0]))
