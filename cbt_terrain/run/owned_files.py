# SPDX-License-Identifier: GPL-3.0-or-later
"""Delete this program's files, and open its folders below a project, without ever following a link.

A project may come from a stranger. A link in it could send a write or a removal into the user's other folders. So this
module does all deleting of the product, and opens the folders that the program derives from a user's path.

Which components of a path may be links: those that the user chose (`/home`, the project folder, the folder of an
export). Those that the program derives may not (`derived`): `STORE_land` and all below it, `STORE_maps`, `tiles`,
`masks`, `data-*` and `.partial-*`. A store that is written or removed may not be reached by a link as its last
component either: it is read and cached through one, never replaced.

How: each folder is opened relative to the descriptor of the one above it (`O_NOFOLLOW | O_DIRECTORY`, `dir_fd`), and
its entries are made, renamed and removed relative to that descriptor. A link that is put in place between a check and a
use is then refused or has no effect. Windows has no such descriptors. There each derived component is tested for a
reparse point (symbolic link or junction) right before the use.

What counts as ours: a regular file, or a real folder, under a name that the program gives and that no user picks by
chance. Such names are the record: they hold 64 to 128 bits of a hash or of a random token, or stand in a folder with
such a name, or in the index of a folder of maps. A separate list of files would prove no more: a stranger can
write one too. Files that lie in a stranger's folder, and are no links, are the stranger's. Anything else in a folder
makes `remove_tree` refuse the whole folder. A hard link only loses its name: no published file is written in place.
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

LAND = "_land"  # ends the name of the folder beside a store that holds its shaped land
MAX_DEPTH = 64  # folders inside each other; the program makes three
MAPS = "_maps"  # ends the name of the folder beside a store that holds its baked maps
_DERIVED = re.compile(r"tiles|masks|data-[0-9a-f]{32}|\.partial-[0-9a-f]{32}|[0-9a-f]{16}(_views)?")
_BY_DESCRIPTOR = {os.open, os.mkdir, os.unlink, os.rmdir, os.stat, os.rename} <= os.supports_dir_fd
_FOLDER, _NO_LINK = getattr(os, "O_DIRECTORY", 0), getattr(os, "O_NOFOLLOW", 0)
_PASS = getattr(os, "O_PATH", os.O_RDONLY)  # needs no right to list the folder
_REPARSE_POINT = getattr(stat, "FILE_ATTRIBUTE_REPARSE_POINT", 0x400)


class NotOursError(TerrainError):
    """A link or a user's file stands where this program keeps its own files."""


class OpenFolder(NamedTuple):
    """A folder that is open. `descriptor`: None on Windows, where `at` names entries by their paths."""

    path: Path
    descriptor: int | None

    def at(self, name: str) -> dict:
        """Return the arguments `path` and `dir_fd` of `os` functions for an entry of the folder."""
        if self.descriptor is None:
            return {"path": self.path / name, "dir_fd": None}
        return {"path": name, "dir_fd": self.descriptor}

    def find(self, name: str) -> os.stat_result | None:
        """Return the `lstat` of an entry, None if it is missing. Raises OSError."""
        try:
            return os.stat(**self.at(name), follow_symlinks=False)
        except FileNotFoundError:
            return None

    def entries(self) -> list[str]:
        """List the names in the folder. Raises OSError."""
        if self.descriptor is None:
            return sorted(os.listdir(self.path))
        listing = os.open(".", os.O_RDONLY | _FOLDER, dir_fd=self.descriptor)
        try:
            return sorted(os.listdir(listing))
        finally:
            os.close(listing)

    @contextmanager
    def open_inner(self, name: str, make: bool = False) -> Iterator["OpenFolder"]:
        """Open a real folder in this one. Raises as `open_folder`."""
        inner = _open_below(self, name, make)
        try:
            yield inner
        finally:
            _close(inner)

    def replace(self, name: str, source: "OpenFolder", source_name: str) -> None:
        """Move a file of another folder here, over the file of that name. Raises OSError, and NotOursError for a link
        in a derived folder; in a folder that the user chose the file takes the link's place."""
        found = self.find(name)
        if found is not None and derived(self.path) and (is_link(found) or not stat.S_ISREG(found.st_mode)):
            raise _not_ours(self.path / name, found, "a file")
        moved, placed = source.at(source_name), self.at(name)
        os.replace(moved["path"], placed["path"], src_dir_fd=moved["dir_fd"], dst_dir_fd=placed["dir_fd"])


def derived(path: Path) -> int:
    """Count the last components of an absolute path that the program derives from what the user chose."""
    parts, count = path.parts, 0
    while count < len(parts) - 1 and _DERIVED.fullmatch(parts[-1 - count]):
        count += 1
    if not count and len(parts) > 2 and parts[-2].endswith(MAPS):
        count = 1  # the maps of one terrain
    return count + (count < len(parts) - 1 and parts[-1 - count].endswith((LAND, MAPS)))


@contextmanager
def open_folder(path: str | os.PathLike, make: bool = False, may_be_link: bool = False) -> Iterator[OpenFolder]:
    """Open a folder for writing or deleting; neither it nor a derived component above it may be a link.

    make: make the folder, and those above it, where they are missing. may_be_link: the folder itself may be a link if
    the user chose it. Raises NotOursError where a component is a link or no folder, FileNotFoundError where it is
    missing, and other OSErrors.
    """
    path = Path(path).absolute()
    count = min(max(derived(path), not may_be_link), len(path.parts) - 1)
    names = path.parts[len(path.parts) - count :]
    above = Path(*path.parts[: len(path.parts) - count])
    if make:
        above.mkdir(parents=True, exist_ok=True)
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
    if folder.descriptor is not None:
        os.close(folder.descriptor)


def _open_below(folder: OpenFolder, name: str, make: bool) -> OpenFolder:
    """Open a real folder in an open one. Raises as `open_folder`."""
    found = folder.find(name)
    if found is None and make:
        with suppress(FileExistsError):  # another process has just made it
            os.mkdir(**folder.at(name))
        found = folder.find(name)
    if found is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder.path / name))
    if is_link(found) or not stat.S_ISDIR(found.st_mode):
        raise _not_ours(folder.path / name, found, "a folder")
    if folder.descriptor is None:
        return OpenFolder(folder.path / name, None)
    try:
        return OpenFolder(folder.path / name, os.open(**folder.at(name), flags=_PASS | _FOLDER | _NO_LINK))
    except OSError as reason:
        found = folder.find(name)  # a link may have taken its place
        if found is not None and not stat.S_ISDIR(found.st_mode):
            raise _not_ours(folder.path / name, found, "a folder") from reason
        raise


def is_link(found: os.stat_result) -> bool:
    """Return whether an `lstat` is that of a symbolic link or of another reparse point of Windows, as a junction."""
    return stat.S_ISLNK(found.st_mode) or bool(getattr(found, "st_file_attributes", 0) & _REPARSE_POINT)


def real_path(path: str | os.PathLike) -> Path:
    """Return an absolute path without links. Links that lead to themselves stay, where `Path.resolve` would raise."""
    return Path(os.path.realpath(path))


def is_real_folder(path: str | os.PathLike) -> bool:
    """Return whether a path is a folder and no link."""
    try:
        found = os.lstat(path)
    except (OSError, ValueError):
        return False
    return stat.S_ISDIR(found.st_mode) and not is_link(found)


def is_real_file(path: str | os.PathLike) -> bool:
    """Return whether a path is a regular file and no link."""
    try:
        found = os.lstat(path)
    except (OSError, ValueError):
        return False
    return stat.S_ISREG(found.st_mode) and not is_link(found)


def check_no_link(path: str | os.PathLike, then: str = "try again") -> None:
    """Raise NotOursError for a link. then: the user's next step once the link is gone."""
    try:
        found = os.lstat(path)
    except (OSError, ValueError):
        return
    if is_link(found):
        raise _not_ours(Path(path), found, "a file or a folder", then)


def touch(path: str | os.PathLike) -> None:
    """Note that a file or a folder was used just now; of a link, the link alone. Raises OSError."""
    os.utime(path, follow_symlinks=os.utime not in os.supports_follow_symlinks)


def _not_ours(path: Path, found: os.stat_result, expected: str, then: str = "try again") -> NotOursError:
    what = "a link" if is_link(found) else "a folder" if stat.S_ISDIR(found.st_mode) else "a file"
    if not is_link(found) and not stat.S_ISDIR(found.st_mode) and not stat.S_ISREG(found.st_mode):
        what = "a device or a pipe"
    return NotOursError(
        f"{shown(path, 1000)} is {what}; expected {expected} of Adaptive Terrain, which follows no links there: "
        f"move it away and {then}."
    )


def check_folder(path: str | os.PathLike, *names: str) -> None:
    """Raise NotOursError unless a path, and the folders `names` in it, are folders that the program may use, or are
    missing. Raises TerrainError where that cannot be found out."""
    try:
        with open_folder(path) as folder:
            for name in names:
                found = folder.find(name)
                if found is not None and (is_link(found) or not stat.S_ISDIR(found.st_mode)):
                    raise _not_ours(folder.path / name, found, "a folder")
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as reason:
        raise TerrainError(
            f"The folder {shown(path)} cannot be used ({reason.strerror or reason}); expected a folder that can be "
            "written: change its rights or choose another place."
        ) from reason


def remove_file(path: str | os.PathLike, may_be_link: bool = False) -> None:
    """Remove a regular file; a missing one is no error.

    may_be_link: of the file's folder, as of `open_folder`. Raises NotOursError for a link or a folder in its place, and
    OSError.
    """
    path = Path(path)
    try:
        with open_folder(path.absolute().parent, may_be_link=may_be_link) as folder:
            found = folder.find(path.name)
            if found is None:
                return
            if is_link(found) or not stat.S_ISREG(found.st_mode):
                raise _not_ours(path, found, "a file")
            with suppress(FileNotFoundError):
                os.unlink(**folder.at(path.name))
    except FileNotFoundError:
        pass


def remove_tree(
    path: str | os.PathLike, may_remove: Callable[[str, bool], bool] | None = None, may_be_link: bool = False
) -> None:
    """Remove a folder with all that is in it; a missing one is no error.

    may_remove: whether this program made an entry, by its name and whether it is a folder. None: all of it is, as in a
    folder that this process made. may_be_link: of the folder above, as of `open_folder`. Raises NotOursError
    before anything is removed, where the folder is a link, or an entry is a link or not the program's. Raises OSError.
    """
    path = Path(path)
    try:
        with open_folder(path.absolute().parent, may_be_link=may_be_link) as above:
            with above.open_inner(path.name) as folder:
                names = folder.entries()
                for name in names if may_remove else ():
                    _check_removable(folder, name, may_remove)
                for name in names:
                    _remove_entry(folder, name)
            with suppress(FileNotFoundError):
                os.rmdir(**above.at(path.name))
    except FileNotFoundError:
        pass


def _check_removable(folder: OpenFolder, name: str, may_remove: Callable[[str, bool], bool]) -> None:
    found = folder.find(name)
    if found is None:
        return
    is_folder = stat.S_ISDIR(found.st_mode)
    if is_link(found) or not (is_folder or stat.S_ISREG(found.st_mode)) or not may_remove(name, is_folder):
        raise NotOursError(
            f"{shown(folder.path, 1000)} holds {shown(name)!r}; expected only files that Adaptive Terrain made: "
            "move it away and try again."
        )


def _remove_entry(folder: OpenFolder, name: str, depth: int = 0) -> None:
    """Remove an entry; of a link, the link alone. What another process removes meanwhile is no error."""
    if depth > MAX_DEPTH:
        raise NotOursError(
            f"{shown(folder.path, 1000)} is more than {MAX_DEPTH} folders deep; expected only files that Adaptive "
            "Terrain made: move it away and try again."
        )
    with suppress(FileNotFoundError):
        found = os.stat(**folder.at(name), follow_symlinks=False)
        if not stat.S_ISDIR(found.st_mode) or is_link(found):
            os.unlink(**folder.at(name))
            return
        with folder.open_inner(name) as inner:
            for entry in inner.entries():
                _remove_entry(inner, entry, depth + 1)
        os.rmdir(**folder.at(name))


def remove_entries(path: str | os.PathLike, may_remove: Callable[[str], bool]) -> None:
    """Remove the regular files in a folder with names that `may_remove` accepts; all else in it stays.

    A missing folder is no error. Raises NotOursError where the folder is a link, and OSError.
    """
    try:
        with open_folder(path) as folder:
            for name in filter(may_remove, folder.entries()):
                found = folder.find(name)
                if found is not None and stat.S_ISREG(found.st_mode) and not is_link(found):
                    with suppress(FileNotFoundError):
                        os.unlink(**folder.at(name))
    except FileNotFoundError:
        pass


def remove_empty(path: str | os.PathLike) -> None:
    """Remove a folder if nothing is in it; else raise OSError. A link is no folder and stays."""
    path = Path(path)
    with open_folder(path.absolute().parent, may_be_link=True) as above:
        found = above.find(path.name)
        if found is not None and is_link(found):
            raise _not_ours(path, found, "a folder")
        os.rmdir(**above.at(path.name))
