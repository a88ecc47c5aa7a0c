# SPDX-License-Identifier: GPL-3.0-or-later
"""Deletion of this program's files, and access to its folders below a project, without ever following a link.

A project may come from a stranger. A link in it could redirect a write or a removal into the user's other folders. So
this module does all deleting of the product, and opens the folders that the program derives from a user's path.

Components of a path that the user chose may be links (`/home`, the project folder, the folder of an export). Those that
the program derives may not (`derived_components`): `STORE_land` and everything below it, `STORE_maps`, `tiles`,
`masks`, `data-*` and `.partial-*`. The last component of a store that is written or removed may not be a
link either: a store is read and cached through a link, but never replaced.

Each folder is opened relative to the descriptor of the one above it (`O_NOFOLLOW | O_DIRECTORY`, `dir_fd`), and its
entries are created, renamed and removed relative to that descriptor. So a link that appears between a check and a use
is refused or has no effect. Windows has no such descriptors: each derived component is tested for a reparse point
(symbolic link or junction) right before the use.

The program owns a regular file, or a real folder, with a name that it generates and that no user picks by chance. Such
names hold 64 to 128 bits of a hash or a random token, or are inside a folder with such a name or in the index of a
folder of maps. A separate list of files would prove no more, because a stranger can write one too. Real files in a
stranger's folder belong to the stranger. `remove_tree` refuses a folder with any other entry. Removing a hard link
removes only its name: no published file is written in place.
"""

import errno
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from ..errors import TerrainError, shown

LAND = "_land"  # suffix of the folder of a store's shaped land, beside the store
MAX_DEPTH = 64  # nested folders; the program creates three
MAPS = "_maps"  # suffix of the folder of a store's baked maps, beside the store
# Folders in a store or in STORE_land, whose stores have 16 digits, and those of files that are being written.
_DERIVED = re.compile(r"tiles|masks|data-[0-9a-f]{32}|\.partial-[0-9a-f]{32}|[0-9a-f]{16}(_views)?")
_BY_DESCRIPTOR = {os.open, os.mkdir, os.unlink, os.rmdir, os.stat, os.rename} <= os.supports_dir_fd
_FOLDER, _NO_LINK = getattr(os, "O_DIRECTORY", 0), getattr(os, "O_NOFOLLOW", 0)
_PASS = getattr(os, "O_PATH", os.O_RDONLY)  # needs no right to list the folder
_REPARSE_POINT = getattr(stat, "FILE_ATTRIBUTE_REPARSE_POINT", 0x400)


class NotOursError(TerrainError):
    """A link or a user's file has the name of a file of this program."""


class OpenFolder(NamedTuple):
    """An open folder.

    `descriptor`: enough to reach entries of the folder, but not to list them (O_PATH); None on Windows, where `at`
    returns paths of entries.
    """

    path: Path
    descriptor: int | None

    def at(self, name: str) -> dict:
        """Return the arguments `path` and `dir_fd` of `os` functions for an entry of the folder."""
        if self.descriptor is None:
            return {"path": self.path / name, "dir_fd": None}
        return {"path": name, "dir_fd": self.descriptor}

    def find(self, name: str) -> os.stat_result | None:
        """Return the `lstat` of an entry of the folder, None if it is missing. Raises OSError."""
        try:
            return os.stat(**self.at(name), follow_symlinks=False)
        except FileNotFoundError:
            return None

    def entries(self) -> list[str]:
        """Return the names in the folder, sorted. Raises OSError."""
        if self.descriptor is None:
            return sorted(os.listdir(self.path))
        # `descriptor` cannot list the folder.
        listing = os.open(".", os.O_RDONLY | _FOLDER, dir_fd=self.descriptor)
        try:
            return sorted(os.listdir(listing))
        finally:
            os.close(listing)

    @contextmanager
    def open_inner(self, name: str) -> Iterator["OpenFolder"]:
        """Open a real folder in this one for the block. Raises NotOursError for a link, and OSError."""
        inner = _open_below(self, name, make=False)
        try:
            yield inner
        finally:
            _close(inner)

    def replace(self, name: str, source: "OpenFolder", source_name: str) -> None:
        """Move a file of another folder to `name` in this one, replacing a file there.

        Raises OSError, and NotOursError for a link, or another entry than a file, in a derived folder; in a folder that
        the user chose a link is replaced. source, source_name: that folder and the file's name in it.
        """
        status = self.find(name)
        if (
            status is not None
            and derived_components(self.path)
            and (is_link(status) or not stat.S_ISREG(status.st_mode))
        ):
            raise _not_ours(self.path / name, status, "a file")
        old, new = source.at(source_name), self.at(name)
        os.replace(old["path"], new["path"], src_dir_fd=old["dir_fd"], dst_dir_fd=new["dir_fd"])


def derived_components(path: Path) -> int:
    """Return how many components at the end of an absolute path this program named, such as a store's folders."""
    parts, count = path.parts, 0
    while count < len(parts) - 1 and _DERIVED.fullmatch(parts[-1 - count]):
        count += 1
    if not count and len(parts) > 2 and parts[-2].endswith(MAPS):
        count = 1  # in STORE_maps: the maps of one terrain
    # STORE_land or STORE_maps above these components, or at the end, counts, too.
    return count + (count < len(parts) - 1 and parts[-1 - count].endswith((LAND, MAPS)))


@contextmanager
def open_folder(path: str | os.PathLike, make: bool = False, may_be_link: bool = False) -> Iterator[OpenFolder]:
    """Open a folder for writing or deleting; neither it nor a derived component above it may be a link.

    Args:
        make: create the folder and those above it if they are missing.
        may_be_link: allow a link as the folder itself if the user chose it.

    Raises NotOursError if a component is a link or no folder, FileNotFoundError if one is missing, and other OSErrors.
    """
    path = Path(path).absolute()
    # Components that are opened one by one, none of which may be a link: at least the folder, unless it may be one.
    count = min(max(derived_components(path), not may_be_link), len(path.parts) - 1)
    names = path.parts[len(path.parts) - count :]
    above = Path(*path.parts[: len(path.parts) - count])
    if make:
        above.mkdir(parents=True, exist_ok=True)
    # `_PASS`: open without the right to list; `_FOLDER`: fail if it is no folder. Windows has no descriptor (None).
    folder = OpenFolder(above, os.open(above, _PASS | _FOLDER) if _BY_DESCRIPTOR else None)
    try:
        for name in names:
            inner = _open_below(folder, name, make)
            _close(folder)
            folder = inner
        yield folder
    finally:
        _close(folder)


def _close(folder: OpenFolder) -> None:
    """Close the folder's descriptor, which an open folder on Windows does not have."""
    if folder.descriptor is not None:
        os.close(folder.descriptor)


def _open_below(folder: OpenFolder, name: str, make: bool) -> OpenFolder:
    """Open a real folder inside an open one. make: create it if it is missing. Raises as `open_folder`."""
    status = folder.find(name)
    if status is None and make:
        with suppress(FileExistsError):  # another process has just created it
            os.mkdir(**folder.at(name))
        status = folder.find(name)
    if status is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder.path / name))
    if is_link(status) or not stat.S_ISDIR(status.st_mode):
        raise _not_ours(folder.path / name, status, "a folder")
    if folder.descriptor is None:
        return OpenFolder(folder.path / name, None)
    try:
        return OpenFolder(folder.path / name, os.open(**folder.at(name), flags=_PASS | _FOLDER | _NO_LINK))
    except OSError as reason:
        status = folder.find(name)  # a link may have taken its place
        if status is not None and not stat.S_ISDIR(status.st_mode):
            raise _not_ours(folder.path / name, status, "a folder") from reason
        raise


def is_link(status: os.stat_result) -> bool:
    """Return whether an `lstat` is that of a symbolic link or of a reparse point of Windows, such as a junction."""
    return stat.S_ISLNK(status.st_mode) or bool(getattr(status, "st_file_attributes", 0) & _REPARSE_POINT)


def real_path(path: str | os.PathLike) -> Path:
    """Return an absolute path without links. Circular links stay, where `Path.resolve` would raise."""
    return Path(os.path.realpath(path))


def without_dots(path: Path) -> Path:
    """Return an absolute `path` without `..`; unchanged if that leads elsewhere (`..` after a link) or is missing."""
    parts = path.parts
    if ".." not in parts:
        return Path(os.path.normpath(path))
    end = len(parts) - parts[::-1].index("..")  # after the last `..`
    dotted = Path(*parts[:end])
    try:
        is_same = os.path.samefile(dotted, os.path.normpath(dotted))
    except (OSError, ValueError):
        return path
    return Path(os.path.normpath(path)) if is_same else path


def is_real_folder(path: str | os.PathLike) -> bool:
    """Return whether a path is a folder and no link."""
    status = _lstat(path)
    return status is not None and stat.S_ISDIR(status.st_mode) and not is_link(status)


def is_real_file(path: str | os.PathLike) -> bool:
    """Return whether a path is a regular file and no link."""
    status = _lstat(path)
    return status is not None and stat.S_ISREG(status.st_mode) and not is_link(status)


def check_no_link(path: str | os.PathLike, then: str = "try again") -> None:
    """Raise NotOursError for a link. then: the user's next step once the link is gone."""
    status = _lstat(path)
    if status is not None and is_link(status):
        raise _not_ours(Path(path), status, "a file or a folder", then)


def _lstat(path: str | os.PathLike) -> os.stat_result | None:
    """Return the `lstat` of a path; None if it is missing, unreadable or no possible path."""
    try:
        return os.lstat(path)
    except (OSError, ValueError):
        return None


def touch(path: str | os.PathLike) -> None:
    """Set the modification time of a file or a folder, or of a link itself, to now. Raises OSError."""
    os.utime(path, follow_symlinks=os.utime not in os.supports_follow_symlinks)


def _not_ours(path: Path, status: os.stat_result, expected: str, then: str = "try again") -> NotOursError:
    """Return the error of a path that holds a link or an entry of another kind than `expected`.

    status: its `lstat`. then: the user's next step once it is moved away.
    """
    what = "a link" if is_link(status) else "a folder" if stat.S_ISDIR(status.st_mode) else "a file"
    if not is_link(status) and not stat.S_ISDIR(status.st_mode) and not stat.S_ISREG(status.st_mode):
        what = "a device or a pipe"
    return NotOursError(
        f"{shown(path, max_length=1000)} is {what}",
        expected=f"{expected} of Adaptive Terrain, which follows no links there",
        fix=f"move it away and {then}",
    )


def check_folder(path: str | os.PathLike, *names: str) -> None:
    """Raise NotOursError if a path, or an entry of `names` in it, exists and is no real folder, for example a link.

    Raises TerrainError if that cannot be determined.
    """
    try:
        with open_folder(path) as folder:  # checks the path itself
            for name in names:
                status = folder.find(name)
                if status is not None and (is_link(status) or not stat.S_ISDIR(status.st_mode)):
                    raise _not_ours(folder.path / name, status, "a folder")
    except (FileNotFoundError, NotADirectoryError):
        pass  # a folder above the path is missing or is a file, so nothing exists at the path
    except OSError as reason:
        raise TerrainError(
            f"The folder {shown(path)} cannot be used ({reason.strerror or reason})",
            expected="a writable folder",
            fix="change its permissions or choose another one",
        ) from reason


def remove_file(path: str | os.PathLike, may_be_link: bool = False) -> None:
    """Remove a regular file, if it exists.

    may_be_link: allow a link as the file's folder, if the user chose it. Raises NotOursError for a link or a folder,
    and OSError.
    """
    path = Path(path)
    with suppress(FileNotFoundError), open_folder(path.absolute().parent, may_be_link=may_be_link) as folder:
        status = folder.find(path.name)
        if status is None:
            return
        if is_link(status) or not stat.S_ISREG(status.st_mode):
            raise _not_ours(path, status, "a file")
        os.unlink(**folder.at(path.name))


def remove_tree(
    path: str | os.PathLike, may_remove: Callable[[str, bool], bool] | None = None, may_be_link: bool = False
) -> None:
    """Remove a folder with its contents, if it exists.

    Args:
        may_remove: returns whether this program created an entry directly in the folder, from its name and whether it
            is a folder. None: all entries are removed, also links themselves, as in a folder that this process created.
        may_be_link: allow a link as the folder above, if the user chose it.

    Raises OSError; and NotOursError, before anything is removed, if the folder is a link or if, with `may_remove`, an
    entry directly in it is a link or not of this program; after some were removed, for more than MAX_DEPTH folders.
    """
    path = Path(path)
    with suppress(FileNotFoundError), open_folder(path.absolute().parent, may_be_link=may_be_link) as above:
        with above.open_inner(path.name) as folder:
            names = folder.entries()
            if may_remove:
                for name in names:
                    _check_removable(folder, name, may_remove)
            for name in names:
                _remove_entry(folder, name)
        os.rmdir(**above.at(path.name))


def _check_removable(folder: OpenFolder, name: str, may_remove: Callable[[str, bool], bool]) -> None:
    """Raise NotOursError for an entry that is a link or that `may_remove` refuses."""
    status = folder.find(name)
    if status is None:
        return
    is_folder = stat.S_ISDIR(status.st_mode)
    if is_link(status) or not (is_folder or stat.S_ISREG(status.st_mode)) or not may_remove(name, is_folder):
        raise _foreign_error(f"{shown(folder.path, max_length=1000)} holds {shown(name)!r}")


def _foreign_error(what: str) -> NotOursError:
    """Return the error for a file or folder that this program did not make and so does not remove."""
    return NotOursError(what, expected="only files that Adaptive Terrain made", fix="move them away and try again")


def _remove_entry(folder: OpenFolder, name: str, depth: int = 0) -> None:
    """Remove an entry with its contents, or a link itself. Entries that another process removes meanwhile are no error.

    depth: folders above it in the tree that is removed. Raises OSError, and NotOursError beyond MAX_DEPTH.
    """
    if depth > MAX_DEPTH:
        raise _foreign_error(f"{shown(folder.path, max_length=1000)} is more than {MAX_DEPTH} folders deep")
    with suppress(FileNotFoundError):
        status = os.stat(**folder.at(name), follow_symlinks=False)
        if not stat.S_ISDIR(status.st_mode) or is_link(status):
            os.unlink(**folder.at(name))
            return
        with folder.open_inner(name) as inner:
            for entry in inner.entries():
                _remove_entry(inner, entry, depth + 1)
        os.rmdir(**folder.at(name))


def remove_entries(path: str | os.PathLike, may_remove: Callable[[str], bool]) -> None:
    """Remove the regular files in a folder with names that `may_remove` accepts; all other entries stay.

    A missing folder is no error. Raises NotOursError if the folder is a link, and OSError.
    """
    with suppress(FileNotFoundError), open_folder(path) as folder:
        for name in filter(may_remove, folder.entries()):
            status = folder.find(name)
            if status is not None and stat.S_ISREG(status.st_mode) and not is_link(status):
                with suppress(FileNotFoundError):
                    os.unlink(**folder.at(name))


def remove_empty(path: str | os.PathLike) -> None:
    """Remove an empty folder. Raises OSError for any other and for a missing one, and NotOursError for a link."""
    path = Path(path)
    with open_folder(path.absolute().parent, may_be_link=True) as above:
        status = above.find(path.name)
        if status is not None and is_link(status):
            raise _not_ours(path, status, "a folder")
        os.rmdir(**above.at(path.name))
