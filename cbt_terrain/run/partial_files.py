# SPDX-License-Identifier: GPL-3.0-or-later
"""Files while they are written: in a private folder beside their place, which its living writer holds by a lock.

A folder that nobody holds is what a killed process has left, and is removed. A process number cannot tell: it is used
again, and other machines and containers have their own. The lock can, as the system gives it back however its holder
ends. Some network folders keep locks to one machine. So the folder's name begins with the machine's mark, and a lock
that is free is trusted on that machine only; of others a folder goes when it is a day old.

    .partial-MARK.../lock    held by the writer
    .partial-MARK.../NAME    what will be renamed to ../NAME
    .partial-MARK...-NAME    the same of a file that names others as seen from its own folder
"""

import errno
import functools
import hashlib
import os
import platform
import re
import secrets
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None
    import msvcrt

from . import owned_files
from .owned_files import NotOursError, open_folder

PREFIX, LOCK = ".partial-", "lock"
STALE_SECONDS = 86_400.0
# Whoever takes abandoned folders away may take one that is just being made; then it is made again.
ATTEMPTS = 100
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # nor wait for what is a pipe
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_NAME = re.compile(re.escape(PREFIX) + r"[0-9a-f]{32}")


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """Yield a path for the new content of `path`; when the block ends well it is renamed to `path`, else it is removed.

    Nothing half-written ever stands under the final name. The file has that name already, in a folder that only this
    user may write: exporters choose a format by it, and nobody can put a link in its place.
    """
    path = Path(path)
    check_replaceable(path)
    with private_folder(path.parent) as folder:
        yield folder / path.name
        with open_folder(folder) as inner, open_folder(path.parent, may_be_link=True) as parent:
            parent.replace(path.name, inner, path.name)


@contextmanager
def written_among(path: Path) -> Iterator[Path]:
    """Do as `written_beside`, but in the folder of `path` itself, since the file will name others relative to it. The
    name is unpredictable, so there is no link in its place."""
    check_replaceable(path)
    with private_folder(path.parent) as folder:
        partial = folder.with_name(f"{folder.name}-{path.name}")
        try:
            yield partial
            with open_folder(path.parent, may_be_link=True) as parent:
                parent.replace(path.name, parent, partial.name)
        finally:
            owned_files.remove_file(partial, may_be_link=True)


def check_replaceable(path: Path) -> None:
    """Raise OSError where something other than a file stands: a rename would put a file in the place of a device or a
    pipe, as root of /dev/null for the whole machine."""
    if os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if is_device(path):
        raise FileExistsError(errno.EEXIST, "a device or a pipe is there", str(path))


def is_device(path: str | os.PathLike) -> bool:
    """Tell whether something other than a file stands at a path. /dev/stdout is a link, perhaps to a file: a device."""
    is_descriptor = os.path.islink(path) and os.path.abspath(path).startswith(("/dev/", "/proc/"))
    return os.path.exists(path) and (is_descriptor or not os.path.isfile(path))


@contextmanager
def private_folder(parent: Path) -> Iterator[Path]:
    """A new folder in `parent` for the time of the block."""
    folder = parent / f"{PREFIX}{new_token()}"
    lock = make_folder(folder, 0o700)  # for this user alone
    try:
        yield folder
    finally:
        os.close(lock)
        with suppress(OSError, NotOursError):
            owned_files.remove_tree(folder, may_be_link=True)


def is_partial_name(name: str) -> bool:
    return _NAME.fullmatch(name) is not None


def final_names(text: str) -> str:
    """A message without the private folders in its paths: users know a file by its final name."""
    return re.sub(_NAME.pattern + r"(-|[/\\]+)", "", text)


def new_token() -> str:
    """Return 32 unpredictable hexadecimal digits for a folder's name; the first eight are this machine's mark."""
    return _machine() + secrets.token_hex(12)


@functools.cache
def _machine() -> str:
    """Eight hexadecimal digits that all processes of this system have in common, those of containers too, until it is
    started again: as far as a lock is surely known."""
    try:
        known = _BOOT.read_text()
    except OSError:
        known = platform.node()
    return hashlib.blake2b(known.encode(), digest_size=4).hexdigest()


def make_folder(folder: Path, mode: int = 0o777, parents: bool = False) -> int:
    """Make a folder; returns its lock, an open file: until it is closed, the folder is at work.

    parents: make the folders above it too, of which the last may then be no link. Raises OSError, FileExistsError among
    others, and NotOursError.
    """
    for attempt in range(ATTEMPTS):
        try:
            lock = _make_locked(folder, mode, parents, attempt > 0)
        except FileNotFoundError:
            if attempt == ATTEMPTS - 1:
                raise
        else:
            if _take(lock) is not False and _is_there(folder / LOCK, lock):
                return lock
            os.close(lock)
        time.sleep(0.001)  # who looks for abandoned folders has it now
    raise FileExistsError(f"{folder} is held by another process")


def _make_locked(folder: Path, mode: int, parents: bool, may_exist: bool) -> int:
    """Make a folder and open the lock in it. Raises as `make_folder`."""
    with open_folder(folder.absolute().parent, make=parents, may_be_link=not parents) as above:
        try:
            os.mkdir(**above.at(folder.name), mode=mode)
        except FileExistsError:
            if not may_exist:
                raise
        with above.open_inner(folder.name) as inner:
            return os.open(**inner.at(LOCK), flags=os.O_RDWR | os.O_CREAT | NO_LINK, mode=0o600)


def end_work(folder: Path, lock: int) -> None:
    """Give back the lock of a folder, which stays."""
    os.close(lock)
    owned_files.remove_file(folder / LOCK)


def remove_abandoned(parent: Path) -> None:
    """Take away the private folders in `parent` that belong to no living process."""
    try:
        with os.scandir(parent) as entries:
            found = [Path(entry.path) for entry in entries if is_partial_name(entry.name)]
    except OSError:
        return
    for folder in found:
        remove_if_abandoned(folder, folder.name.removeprefix(PREFIX))


def remove_if_abandoned(
    folder: Path,
    token: str,
    is_needed: Callable[[], bool] = lambda: False,
    may_remove: Callable[[str, bool], bool] | None = None,
) -> None:
    """Remove a folder that `make_folder` made, of a name with this token, if it is no living process's work.

    `is_needed` is called when that is known: what has ended may have ended well. may_remove: as of `remove_tree`.
    """
    try:
        if not _is_ours(folder):
            return
        lock = _open_lock(folder)
        try:
            free = lock is None or _take(lock)
            if free is False or (lock is not None and not _is_there(folder / LOCK, lock)):
                return  # what was taken may be the lock of what another has removed, and its maker made again
            if is_needed():
                owned_files.remove_file(folder / LOCK)  # its process had no time to
            elif (free and token.startswith(_machine())) or _age(folder) > STALE_SECONDS:
                if fcntl is None and lock is not None:  # Windows removes no open file
                    os.close(lock)
                    lock = None
                for file in folder.parent.glob(f"{folder.name}-*"):
                    owned_files.remove_file(file, may_be_link=True)
                owned_files.remove_tree(folder, may_remove, may_be_link=may_remove is None)
        finally:
            if lock is not None:
                os.close(lock)
    except (OSError, NotOursError):
        return  # its process, or another that looks for abandoned ones, has just renamed or removed it; or a link


def _take(lock: int) -> bool | None:
    """Whether a lock could be taken; None where the file system has no locks."""
    try:
        if fcntl is None:
            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


def _open_lock(folder: Path) -> int | None:
    """The file that is a folder's lock; None where its work has ended. Raises OSError where it is gone."""
    for _ in range(ATTEMPTS):
        try:
            return os.open(folder / LOCK, os.O_RDWR | NO_LINK)
        except FileNotFoundError:
            found = os.listdir(folder)
            if not found:
                owned_files.remove_empty(
                    folder
                )  # it has just been made, which is then done again, or its maker was killed
                raise
            if LOCK not in found:  # whoever writes into it has one
                return None
    raise FileNotFoundError(folder / LOCK)


def _is_there(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _is_ours(folder: Path) -> bool:
    """A real folder of this user; in what a link or another user's folder leads to nothing is opened."""
    found = folder.lstat()
    return stat.S_ISDIR(found.st_mode) and (not hasattr(os, "getuid") or found.st_uid == os.getuid())


def _age(folder: Path) -> float:
    """Return the seconds since anything in a folder was written."""
    return time.time() - max(path.lstat().st_mtime for path in (folder, *folder.iterdir()))
