# SPDX-License-Identifier: GPL-3.0-or-later
"""Files while they are written: in a private folder beside their destination, locked by its living writer.

An unlocked folder was left by a killed process, and is removed. A process number would not do: numbers are used again,
and other machines and containers have the same ones. The system releases a lock however its holder ends. Some file
systems have no locks, and some network folders keep them to one machine. So the folder's name begins with the machine's
mark, and a free lock counts only on that machine; other folders are removed when they are a day old.

    .partial-MARK.../lock    held by the writer
    .partial-MARK.../NAME    will be renamed to ../NAME
    .partial-MARK...-NAME    the same for a file with relative paths to other files
    .partial-DIGEST/lock     held by the writer of a file and of others that it describes
"""

import errno
import functools
import hashlib
import os
import platform
import re
import secrets
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

from ..errors import TerrainError, shown
from . import owned_files
from .owned_files import NotOursError, open_folder

PREFIX, LOCK = ".partial-", "lock"
STALE_SECONDS = 86_400.0
# Another process may remove a folder that is just being created; then it is created again.
ATTEMPTS = 100
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # O_NONBLOCK: do not wait for a pipe
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_NAME = re.compile(re.escape(PREFIX) + r"[0-9a-f]{32}")


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """Yield a path for the new content of `path`; rename it to `path` when the block ends well, else remove it.

    So no incomplete file ever has the final name. The new file has that name already, in a folder that only this user
    may write: exporters choose a format by it, and it cannot be replaced by a link. Raises OSError, and NotOursError if
    `path` may not be replaced.
    """
    path = Path(path)
    check_replaceable(path)
    with private_folder(path.parent) as folder:
        yield folder / path.name
        with open_folder(folder) as inner, open_folder(path.parent, may_be_link=True) as parent:
            parent.replace(path.name, inner, path.name)


@contextmanager
def written_among(path: Path) -> Iterator[Path]:
    """Yield a path in the folder of `path` for its new content, and rename it to `path` when the block ends well.

    Else it is removed. Unlike with `written_beside`, relative paths in the file stay right. The temporary name is
    unpredictable, so no link can have it.
    """
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
    """Raise OSError if `path` is not a file: renaming would replace a device or a pipe, as root even /dev/null."""
    if os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if is_device(path):
        raise FileExistsError(errno.EEXIST, "a device or a pipe is there", str(path))


def is_device(path: str | os.PathLike) -> bool:
    """Return whether a path exists and is not a file. /dev/stdout, a link to any file, counts as a device."""
    is_descriptor = os.path.islink(path) and os.path.abspath(path).startswith(("/dev/", "/proc/"))
    return os.path.exists(path) and (is_descriptor or not os.path.isfile(path))


@contextmanager
def private_folder(parent: Path) -> Iterator[Path]:
    """Create a folder in `parent` for the time of the block, and yield it."""
    folder = parent / f"{PREFIX}{new_token()}"
    lock = make_folder(folder, 0o700)  # for this user alone
    try:
        yield folder
    finally:
        os.close(lock)
        with suppress(OSError, NotOursError):
            owned_files.remove_tree(folder, may_be_link=True)


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold a lock for the time of the block, which writes `path` and other files that it describes.

    The lock is in a folder beside `path`, named by a digest of its name. Raises TerrainError if another writer holds
    it, and OSError.
    """
    digest = hashlib.blake2b(path.name.casefold().encode(errors="surrogatepass"), digest_size=16).hexdigest()
    folder = path.parent / f"{PREFIX}{digest}"
    try:
        lock = make_folder(folder, 0o700, may_exist=True)
    except FileExistsError as reason:
        what = f"{shown(path)} and the files with it are being written by another export"
        raise TerrainError(what, fix="wait for its end, or choose another name or folder") from reason
    try:
        yield
    finally:
        # The lock is removed before its release, because another writer may be about to take it.
        if sys.platform == "win32":  # Windows removes no open file
            os.close(lock)
        with suppress(OSError, NotOursError):
            owned_files.remove_tree(folder, may_be_link=True)
        if sys.platform != "win32":
            os.close(lock)


def is_partial_name(name: str) -> bool:
    """Return whether a name is that of an incomplete file or folder."""
    return _NAME.fullmatch(name) is not None


def final_names(text: str) -> str:
    """Return a message without the private folders in its paths, because users know only final names."""
    return re.sub(_NAME.pattern + r"(-|[/\\]+)", "", text)


def new_token() -> str:
    """Return 32 unpredictable hexadecimal digits for a folder's name; the first eight are this machine's mark."""
    return _machine() + secrets.token_hex(12)


@functools.cache
def _machine() -> str:
    """Return eight hexadecimal digits for this system until it is restarted; its containers share them.

    They mark the range in which locks are certainly known.
    """
    try:
        known = _BOOT.read_text()
    except OSError:
        known = platform.node()
    return hashlib.blake2b(known.encode(), digest_size=4).hexdigest()


def make_folder(folder: Path, mode: int = 0o777, parents: bool = False, may_exist: bool = False) -> int:
    """Create a folder and return its lock, an open file; the folder counts as in use until it is closed.

    parents: also create the folders above it; the last of them may then be no link. may_exist: the folder may be there,
    in use by no process. Raises OSError, among others FileExistsError, and NotOursError. mode: its permissions.
    """
    for attempt in range(ATTEMPTS):
        try:
            # The attempt before may have made the folder.
            lock = _make_locked(folder, mode, parents, may_exist or attempt > 0)
        except FileNotFoundError:
            if attempt == ATTEMPTS - 1:
                raise
        else:
            # `_try_lock` returns None where there are no locks.
            if _try_lock(lock) is not False and _is_there(folder / LOCK, lock):
                return lock
            os.close(lock)
        time.sleep(0.001)  # a process that removes abandoned folders holds the lock now
    raise FileExistsError(f"{folder} is held by another process")


def _make_locked(folder: Path, mode: int, parents: bool, may_exist: bool) -> int:
    """Create a folder and open the lock in it; return its descriptor. Raises as `make_folder`.

    parents: also create the folders above. may_exist: the folder may be there.
    """
    with open_folder(folder.absolute().parent, make=parents, may_be_link=not parents) as above:
        try:
            os.mkdir(**above.at(folder.name), mode=mode)
        except FileExistsError:
            if not may_exist:
                raise
        with above.open_inner(folder.name) as inner:
            return os.open(**inner.at(LOCK), flags=os.O_RDWR | os.O_CREAT | NO_LINK, mode=0o600)


def end_work(folder: Path, lock: int) -> None:
    """Release and remove the lock of a folder, which stays. lock: descriptor of the open lock."""
    os.close(lock)
    owned_files.remove_file(folder / LOCK)


def remove_abandoned(parent: Path) -> None:
    """Remove the private folders in `parent` that belong to no living process."""
    try:
        with os.scandir(parent) as entries:
            folders = [Path(entry.path) for entry in entries if is_partial_name(entry.name)]
    except OSError:
        return
    for folder in folders:
        remove_if_abandoned(folder, folder.name.removeprefix(PREFIX))


def is_in_use(folder: Path) -> bool:
    """Return whether a living process has locked a folder; False where there are no locks. Raises OSError."""
    lock = _open_lock(folder)
    try:
        return lock is not None and _try_lock(lock) is False
    finally:
        if lock is not None:
            os.close(lock)


def remove_if_abandoned(
    folder: Path,
    token: str,
    is_needed: Callable[[], bool] = lambda: False,
    may_remove: Callable[[str, bool], bool] | None = None,
) -> None:
    """Remove a folder of `make_folder` if no living process uses it. A folder that cannot be removed is no error.

    A folder of another machine, or where there are no locks, has to be older than STALE_SECONDS.

    token: that of `new_token` in the folder's name; it begins with the machine's mark. is_needed: called once no
    process uses the folder; it returns True if the writer ended well: then only the lock is removed. may_remove:
    returns whether this program created an entry, from its name and whether it is a folder; None for a private folder,
    all of whose entries are removed.
    """
    try:
        if not _is_ours(folder):
            return
        lock = _open_lock(folder)
        try:
            free = lock is None or _try_lock(lock)  # None if the file system has no locks: then its age decides
            if free is False or (lock is not None and not _is_there(folder / LOCK, lock)):
                return  # another process may have removed the folder, and its owner created it again
            if is_needed():
                owned_files.remove_file(folder / LOCK)  # the writer was killed before `end_work`
            elif (free and token.startswith(_machine())) or _age(folder) > STALE_SECONDS:
                if sys.platform == "win32" and lock is not None:  # Windows removes no open file
                    os.close(lock)
                    lock = None
                for file in folder.parent.glob(f"{folder.name}-*"):  # those of `written_among`
                    owned_files.remove_file(file, may_be_link=True)
                # A private folder may be in a folder that the user reaches through a link.
                owned_files.remove_tree(folder, may_remove, may_be_link=may_remove is None)
        finally:
            if lock is not None:
                os.close(lock)
    except (OSError, NotOursError):
        return  # a link, or another process has just renamed or removed the folder


def _try_lock(lock: int) -> bool | None:
    """Return whether a lock could be acquired; None if the file system has no locks."""
    try:
        if sys.platform == "win32":
            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


def _open_lock(folder: Path) -> int | None:
    """Return a folder's open lock file; None if its work has ended. Raises OSError if the folder is gone.

    An empty folder is removed.
    """
    for _ in range(ATTEMPTS):
        try:
            return os.open(folder / LOCK, os.O_RDWR | NO_LINK)
        except FileNotFoundError:
            names = os.listdir(folder)
            if not names:
                owned_files.remove_empty(folder)  # left by a killed process, or new: then it is created again
                raise
            if LOCK not in names:  # a writer would have one
                return None
            # It was created between both calls: open it.
    raise FileNotFoundError(folder / LOCK)


def _is_there(path: Path, file: int) -> bool:
    """Return whether the open `file` is still the one at `path`, because another process may replace it."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _is_ours(folder: Path) -> bool:
    """Return whether a folder is a real one of this user; nothing in a link or in another user's folder is opened."""
    status = folder.lstat()
    return stat.S_ISDIR(status.st_mode) and (not hasattr(os, "getuid") or status.st_uid == os.getuid())


def _age(folder: Path) -> float:
    """Return the seconds since anything in a folder was written."""
    return time.time() - max(path.lstat().st_mtime for path in (folder, *folder.iterdir()))
