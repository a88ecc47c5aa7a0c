# SPDX-License-Identifier: GPL-3.0-or-later
"""Height maps in a .zip or .gz, unpacked by Python into a folder of the store while they are imported.

GDAL's own reader of archives is not used, since a name in one could lead around the list of drivers. Names and sizes
are checked before anything is unpacked. Files that belong to a height map (.prj) are unpacked or copied with it.
A .zip of several tiles is a mosaic: each tile has the path of the archive with the tile's name in it, as a.zip/b.tif.
"""

import calendar
import functools
import gzip
import io
import os
import re
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple

from ..errors import MAX_NAME_BYTES, TerrainError, shown
from ..field import store_folder
from ..rasters.coded_heights import tile_of
from ..rasters.raster import ImportSettings
from ..rasters.sidecars import SUFFIXES, sidecars
from ..rasters.source_formats import FORMATS, SourceFormat
from ..rasters.tile_names import is_tile
from ..run import owned_files, partial_files
from ..run.named_file import open_regular
from ..run.owned_files import NotOursError

MAX_MEMBERS, PIECE = 10_000, 1 << 20  # files in a .zip; bytes that are copied at once
MAX_BYTES = 1 << 33  # of an unpacked file: more than the largest raster
MAX_SIDECAR_BYTES = 16 << 20
WITH_SAMPLES = {".msk": MAX_BYTES, ".ige": MAX_BYTES}  # sidecars that may have more, by suffix
MAX_UNPACKED_BYTES = 1 << 31  # of the unpacked files of a mosaic: more than a row of tiles across the largest raster
IGNORED = ("__MACOSX/",)
NO_MEMBERS = b"PK\5\6" + bytes(18)  # a whole .zip without members
NO_HEIGHT_MAP = "archive.no_height_map"  # code of the error about an archive of other files
FAULTS = (OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error)


class Member(NamedTuple):
    """A height map in an archive.

    Attributes:
        name: the file's name, without folders.
        info: its member of a .zip; None in a .gz.
        sidecars: members of a .zip that belong to it.
    """

    name: str
    info: zipfile.ZipInfo | None = None
    sidecars: tuple[zipfile.ZipInfo, ...] = ()


def is_archive(path: Path) -> bool:
    """Return whether a file is an archive by its suffix."""
    form = FORMATS.get(path.suffix.lower())
    return form is not None and form.is_archive


def archive_of(path: Path) -> Path:
    """Return the .zip that the path of a tile leads into; `path` itself if it leads into none."""
    if f".zip{os.sep}" not in str(path).lower():
        return path
    inside = (outer for outer in path.parents if outer.suffix.lower() == ".zip" and os.path.isfile(outer))
    return next(inside, path)


def is_inside(path: Path) -> bool:
    """Return whether a path leads into a .zip, to one of its tiles."""
    return archive_of(path) != path


def is_packed(path: Path) -> bool:
    """Return whether a height map has to be unpacked: its path is that of an archive, or leads into one."""
    return is_archive(path) or is_inside(path)


def height_maps(path: Path) -> list[Path]:
    """Return the paths of the tiles in an archive, sorted by name; its own path if it holds one height map.

    Raises TerrainError.
    """
    members = _members(path)
    return [path] if len(members) == 1 else [path / name for name in sorted(members)]


def files_of_tile(path: Path) -> list[tuple[str, int, int]]:
    """Return path, size and time (ns) of a tile in a .zip and of its sidecars there. Raises TerrainError.

    The time is the member's date with digits of its checksum for parts of a second: archives often have one date.
    """
    archive, member = archive_of(path), _member(path)
    return [
        (str(archive / PurePosixPath(info.filename)), info.file_size, _changed_ns(info))
        for info in (member.info, *member.sidecars)
        if info is not None
    ]


def _changed_ns(info: zipfile.ZipInfo) -> int:
    """Return the date of a member of a .zip in ns, with digits of its checksum below a second.

    The date has no time zone. It counts as UTC, so that it is the same on every computer of a farm.
    """
    try:
        seconds = calendar.timegm((*info.date_time, 0, 0, 0))
    except (ValueError, OverflowError):  # the archive has an impossible date
        seconds = 0
    return seconds * 10**9 + info.CRC % 10**9


def inner_path(path: Path) -> Path:
    """Return a path with the name of the height map in an archive. Raises TerrainError."""
    return path.with_name(_member(path).name)


def read_head(path: Path, count: int) -> bytes:
    """Return the first `count` bytes of the height map in an archive, or all of a shorter one. Raises TerrainError."""
    member = _member(path)
    try:
        with open_regular(archive_of(path), links=True) as file, _opened(file, member.info) as source:
            return source.read(count)
    except FAULTS as reason:
        raise _damaged(path, reason) from reason


def open_archive(path: Path, _settings: ImportSettings) -> None:
    """Raise TerrainError: the archive was not unpacked, as one inside an archive is not."""
    raise TerrainError(f"{shown(path)} is an archive", expected="a height map here", fix="unpack it first")


class UnpackedFiles:
    """Height maps of archives, unpacked into a private folder when they are first needed.

    Beyond `MAX_UNPACKED_BYTES` the files that were used least recently are removed, and unpacked again on demand.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """Unpack into `folder`; without one, archives are not unpacked."""
        self._folder = folder
        self._archives: list[Path] = []  # by the number of the inner folder, what its path stands for in messages
        self._kept: dict[Path, tuple[Path, int]] = {}  # archive: its height map and the bytes, the latest last

    def path_of(self, path: Path) -> Path:
        """Return the unpacked copy of a height map; `path` itself if it is in no archive, or without a folder.

        Raises TerrainError.
        """
        if self._folder is None or not is_packed(path):
            return path
        if path not in self._kept:  # by path: the copy and the bytes of its folder
            inner = self._folder / str(len(self._archives))
            self._archives.append(path.parent if is_inside(path) else path)
            with owned_files.open_folder(inner, make=True):
                file = _unpack(path, inner)
            self._kept[path] = file, sum(int(entry.stat().st_size) for entry in inner.iterdir())
            self._remove_oldest()
        self._kept[path] = self._kept.pop(path)  # now the latest
        return self._kept[path][0]

    def with_names(self, text: str) -> str:
        """Return a text in which the folders of unpacked files are replaced by the paths of their archives."""
        if self._folder is None:
            return text
        folder_pattern = re.compile(re.escape(f"{self._folder}{os.sep}") + r"(\d+)")
        return folder_pattern.sub(lambda match: str(self._archives[int(match[1])]), text)

    def _remove_oldest(self) -> None:
        """Remove files until at most MAX_UNPACKED_BYTES remain, but not the latest one.

        A file that is open stays readable; where the system cannot remove it, it stays until the end.
        """
        while len(self._kept) > 1 and sum(int(size) for _, size in self._kept.values()) > MAX_UNPACKED_BYTES:
            file, _ = self._kept.pop(next(iter(self._kept)))
            with suppress(OSError, NotOursError):
                owned_files.remove_tree(file.parent, may_be_link=True)


@contextmanager
def unpacking(folder: Path) -> Iterator[UnpackedFiles]:
    """Yield an UnpackedFiles that unpacks archives into the new folder `folder` on demand; remove it after the block.

    `folder` is named like a folder of arrays (`store_folder.scratch_name`), because `store_folder` removes no others.
    Folders above it that were made for it are removed if they are empty. In a TerrainError of the block, paths of
    unpacked files are replaced by those of their archives. Raises OSError if the folder cannot be made.
    """
    new_folders = store_folder.missing_folders(folder.parent)
    lock = partial_files.make_folder(folder, parents=True)  # while it is held, no other process removes the folder
    try:
        with partial_files.private_folder(folder) as inner:  # a new folder in it, for this user alone
            files = UnpackedFiles(inner)
            try:
                yield files
            except TerrainError as error:
                raise TerrainError(*map(files.with_names, error.args)) from error
    finally:
        partial_files.end_work(folder, lock)  # release it
        with suppress(OSError, NotOursError):
            store_folder.remove_arrays(folder)
        with suppress(OSError, NotOursError):
            for parent in new_folders:
                owned_files.remove_empty(parent)


@contextmanager
def unpacked(path: Path, folder: Path) -> Iterator[Path]:
    """Yield the height map of an archive, unpacked into the new folder `folder` for the block; else `path` itself."""
    if not is_archive(path):
        yield path
        return
    with unpacking(folder) as files:
        yield files.path_of(path)


def _unpack(path: Path, folder: Path) -> Path:
    """Write the height map of an archive, and its sidecars, into a folder; return its path. Raises TerrainError."""
    member, outer = _member(path), archive_of(path)
    target = folder / member.name
    try:
        with open_regular(outer, links=True) as file:
            with _opened(file, member.info) as source:
                _copy(outer, source, target, MAX_BYTES if member.info is None else member.info.file_size)
            for info in member.sidecars:
                with _opened(file, info) as source:
                    _copy(outer, source, folder / PurePosixPath(info.filename).name, info.file_size)
        for beside in sidecars(path) if member.info is None else ():
            with open_regular(beside, links=True) as other:
                if beside.stat().st_size <= WITH_SAMPLES.get(beside.suffix.lower(), MAX_SIDECAR_BYTES):
                    _copy(path, other, folder / beside.name, MAX_BYTES)
    except FAULTS as reason:
        raise _damaged(outer, reason) from reason
    return target


@contextmanager
def _opened(file: IO[bytes], info: zipfile.ZipInfo | None) -> Iterator[IO[bytes] | gzip.GzipFile]:
    """Yield a member of an open .zip, or the content of an open .gz (`info` is None), for reading.

    Reading the directory of a .zip takes 10 ms for 2,000 members, and `_members_of` has kept it. So an empty .zip
    (NO_MEMBERS) is opened, and gets the file in place of its own.
    """
    if info is None:
        with gzip.open(file) as content:
            yield content
    else:
        archive = zipfile.ZipFile(io.BytesIO(NO_MEMBERS))
        archive.fp = file
        with archive.open(info) as member:
            yield member


def _copy(path: Path, source: IO[bytes] | gzip.GzipFile, target: Path, max_bytes: int) -> None:
    """Copy `source` into a new file. Raises TerrainError about `path` beyond `max_bytes` or the disk's free bytes."""
    free, size = shutil.disk_usage(target.parent).free, 0
    with target.open("xb") as file:
        while piece := source.read(PIECE):
            size += len(piece)
            if size > min(max_bytes, free):
                raise _too_large(path, target.name, min(max_bytes, free))
            file.write(piece)


def _damaged(path: Path, reason: Exception) -> TerrainError:
    """Return the error about an archive that is missing or cannot be unpacked."""
    if isinstance(reason, FileNotFoundError):
        return TerrainError(f"{shown(path)} does not exist", expected="the file of a height map")
    what = f"{shown(path)} cannot be unpacked ({shown(reason).rstrip('.') or type(reason).__name__})"
    return TerrainError(what, expected="a whole archive, and room for its content", fix="get it again")


def _too_large(path: Path, name: str, limit: int) -> TerrainError:
    """Return the error for a member of an archive that is larger than `limit` bytes."""
    return TerrainError(
        f"{shown(path)} unpacks {shown(name)!r} to more than {limit / 1e6:,.0f} MB",
        expected="a height map that fits on the disk of the store",
        fix="unpack it elsewhere, and check what it holds",
    )


def _member(path: Path) -> Member:
    """Return the one height map in an archive, or the tile that a path leads to. Raises TerrainError."""
    archive = archive_of(path)
    members = _members(archive)
    if archive == path:
        if len(members) > 1:
            raise _no_terrain(path, [*map(PurePosixPath, members)])
        return next(iter(members.values()))
    name = path.relative_to(archive).as_posix()
    if name not in members:
        raise TerrainError(f"{shown(archive)} has lost {shown(name)!r}", fix="import it again when it is complete")
    return members[name]


def _members(path: Path) -> dict[str, Member]:
    """Return the height maps in an archive by their names in it, from names and sizes alone. Raises TerrainError."""
    if path.suffix.lower() == ".gz":
        inner = PurePosixPath(path.stem)
        if _importable(inner) is None:
            raise _no_terrain(path, maps=[], packed=[inner] if inner.suffix.lower() == ".tar" else [])
        return {path.stem: Member(path.stem)}
    try:
        status = os.stat(path)
    except OSError as reason:
        raise _damaged(path, reason) from reason
    return _members_of(path, status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _members_of(path: Path, _size: int, _changed_ns: int) -> dict[str, Member]:
    """Return the height maps in a .zip, cached: for each of n tiles its directory would be read again.

    _size, _changed_ns: of the file, only for the cache. Raises TerrainError.
    """
    try:
        with open_regular(path, links=True) as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
    except FAULTS as reason:
        raise _damaged(path, reason) from reason
    if len(members) > MAX_MEMBERS:
        raise TerrainError(f"{shown(path)} holds {len(members):,} files", expected=f"{MAX_MEMBERS:,} at most")
    return _choose(path, [info for info in members if not info.is_dir() and not info.filename.startswith(IGNORED)])


def _choose(path: Path, members: list[zipfile.ZipInfo]) -> dict[str, Member]:
    """Return the only height map of a .zip, or its tiles (tile_names.py) if it has several, by their names in it.

    Raises TerrainError for unsafe members, one of more than MAX_BYTES, no height map, and several that are no tiles.
    """
    beside: dict[PurePosixPath, dict[str, dict]] = {}  # folder, then name in small letters, then name: its member
    for info in members:
        _check_member(path, info)
        name = PurePosixPath(info.filename)
        beside.setdefault(name.parent, {}).setdefault(name.name.lower(), {})[name.name] = info
    maps = {name: info for info in members if _importable(name := PurePosixPath(info.filename))}
    if len(maps) > 1:
        maps = {name: info for name, info in maps.items() if is_tile(name.name, beside[name.parent])}
    if not maps:  # the error also names archives and mosaics (`packed`)
        names = [PurePosixPath(info.filename) for info in members]
        packed = [name for name in names if name.suffix.lower() in FORMATS and not name.name.startswith(".")]
        raise _no_terrain(path, [*filter(_importable, names)], packed)
    largest = max(maps.values(), key=lambda info: info.file_size)
    if largest.file_size > MAX_BYTES:
        raise _too_large(path, PurePosixPath(largest.filename).name, MAX_BYTES)
    return {str(name): Member(name.name, info, _sidecars(name, beside[name.parent])) for name, info in maps.items()}


def _sidecars(name: PurePosixPath, beside: dict[str, dict]) -> tuple[zipfile.ZipInfo, ...]:
    """Return the members that belong to a height map, without those that are too large for their suffix.

    beside: names in its folder in small letters, each with a dictionary from exact names to members.
    """
    starts = {name.name.lower(), name.stem.lower()}
    limits = {suffix: WITH_SAMPLES.get(suffix, MAX_SIDECAR_BYTES) for suffix in SUFFIXES}
    found = [(limits[suffix], beside.get(start + suffix, {})) for start in starts for suffix in SUFFIXES]
    return tuple(info for limit, members in found for info in members.values() if info.file_size <= limit)


def _check_member(path: Path, info: zipfile.ZipInfo) -> None:
    """Raise TerrainError for a link, an encrypted file, a too long name, or one that leads out of its folder."""
    name, problem = PurePosixPath(info.filename), ""
    if name.is_absolute() or ".." in name.parts or "\\" in info.filename or ":" in info.filename:
        problem = "whose name leads out of its folder"
    elif stat.S_ISLNK(info.external_attr >> 16):
        problem = "which is a link"
    elif info.flag_bits & 1:
        problem = "which is encrypted"
    elif _importable(name) and len(os.fsencode(name.name)) > MAX_NAME_BYTES:
        problem = f"whose name has more than {MAX_NAME_BYTES} bytes"
    if problem:
        raise TerrainError(f"{shown(path)} holds {shown(info.filename)!r}, {problem}", fix="unpack it yourself first")


def _importable(name: PurePosixPath | Path) -> SourceFormat | None:
    """Return the format of a height map by its name; None for others, mosaics, archives and hidden files."""
    form = FORMATS.get(name.suffix.lower())
    return None if form is None or form.is_archive or form.driver == "VRT" or name.name.startswith(".") else form


def _no_terrain(path: Path, maps: Sequence[PurePosixPath], packed: Sequence[PurePosixPath] = ()) -> TerrainError:
    """Return the error about an archive without a height map, or with several that are not tiles.

    maps: its height maps. packed: its archives and mosaics, which may lead to heights; NO_HEIGHT_MAP without both.
    """
    names, code = shown(", ".join(map(str, maps or packed)), 120), ""
    if maps:
        found = f"{len(maps)} height maps ({names})"
        is_web = all(tile_of(Path(name)) for name in maps)
        fix = "unpack it, and import the folder of web map tiles" if is_web else "unpack it, and import one of them"
    elif packed:
        found, fix = f"no height map, but {names}", "unpack it, and import that"
    else:
        found, fix, code = "no height map", "name a file of heights, such as .tif, .hgt or .asc", NO_HEIGHT_MAP
    expected = "one height map in an archive, or tiles with a position"
    return TerrainError(f"{shown(path)} holds {found}", expected=expected, fix=fix, code=code)
