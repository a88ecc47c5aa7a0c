# SPDX-License-Identifier: GPL-3.0-or-later
"""Files beside a raster that belong to it: world files, .prj, GDAL's .aux.xml, and rational polynomials.

This module checks an .aux.xml before GDAL parses it. GDAL may read it only if it names no other file.
"""

import bisect
import contextlib
import functools
import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from xml.parsers import expat

from ..errors import TerrainError, shown
from ..run.named_file import read_start
from .rasterio_types import CRS, DatasetReader

AUX, POLYNOMIALS = ".aux.xml", "_rpc.txt"
SUFFIXES = (
    *(".prj", ".tfw", ".tifw", ".tiffw", ".pgw", ".pngw", ".wld", ".tab", AUX),
    *(".hdr", ".stx", ".clr", ".ovr", ".msk", ".sgrd", ".ige", ".rrd", ".j2w", ".wpw", ".blw"),
    *(".bilw", ".bipw", ".bqw", ".bsqw", ".fltw", ".demw", ".jp2w", ".webpw"),  # world files by GDAL's rule
    *(".idx", ".msk.ovr", f".msk{AUX}"),  # messages of a GRIB; overviews and flags of a mask
    *(POLYNOMIALS, ".rpb"),
)
MAX_BYTES, MAX_DEPTH = 16 << 20, 64
LAST_LETTER = chr(sys.maxunicode)  # in the order of texts, after all letters of names
# A code or WKT. GDAL's other notations for a coordinate system may name a file.
_SYSTEM = re.compile(r"(?:[A-Z_]+:\w{1,16}|[A-Z_]+\s*\[.*)?", re.DOTALL)


def sidecars(path: Path) -> list[Path]:
    """Return the files beside a raster that may belong to it, whatever the case of their suffix.

    Those of dem.tif.gz have the names of those of dem.tif.
    """
    path = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    stem, name = path.stem.lower(), path.name.lower()
    wanted = {start + suffix for start in (stem, name) for suffix in SUFFIXES} - {name}
    try:
        files = [path.with_name(other) for other in sorted(_names_beside(path)) if other.lower() in wanted]
    except OSError:  # a folder that may be entered but not listed
        files = [path.with_name(other) for other in sorted(wanted) if os.path.exists(path.with_name(other))]
    return [file for file in files if file.is_file()]


def is_alone(path: Path) -> bool:
    """Return whether no other file of the folder has a raster's name with another suffix, so that none belongs to it.

    False for a folder that cannot be listed.
    """
    try:
        return not _names_beside(path)
    except OSError:
        return False


def _names_beside(path: Path) -> list[str]:
    """Return the names in a file's folder that continue its name up to the suffix with a dot or POLYNOMIALS.

    The case of letters does not matter: dem.tfw, DEM.tif.ovr and dem_RPC.TXT for dem.tif. Raises OSError for a folder
    that cannot be listed.
    """
    names = [name for end in (".", POLYNOMIALS) for name in _names_from(path, path.stem.lower() + end)]
    return [name for name in names if name != path.name]


def _names_from(path: Path, start: str) -> list[str]:
    """Return the names in a file's folder that begin with `start`, in small letters, whatever their case.

    Raises OSError for a folder that cannot be listed.
    """
    names = _names_in(str(path.parent), os.stat(path.parent).st_mtime_ns)
    first, end = (bisect.bisect_left(names, (text, "")) for text in (start, start + LAST_LETTER))
    return [name for _, name in names[first:end]]


@functools.lru_cache(maxsize=4)
def _names_in(folder: str, _changed_ns: int) -> list[tuple[str, str]]:
    """Return the names in a folder, each in small letters and as it is, sorted.

    The result is cached, because a mosaic of n tiles would list its folder n times. _changed_ns: time of the folder's
    last change, only for the cache.
    """
    return sorted((name.lower(), name) for name in os.listdir(folder))


def aux_file(path: Path) -> Path | None:
    """Return the .aux.xml of a raster, None if there is none; exactly its name is preferred to other letter cases."""
    named = path.name + AUX
    files = [file for file in sidecars(path) if file.name.lower() == named.lower()]
    return min(files, key=lambda file: file.name != named, default=None)


def read_aux(file: Path) -> str:
    """Return the coordinate system that an .aux.xml names, "" if none. Raises TerrainError if GDAL must not read it."""
    depth, texts, in_system = 0, [], False

    def refuse(problem: str) -> None:
        """Raise TerrainError: the file is not read. problem: the reason, a clause whose subject is the file."""
        raise TerrainError(f"{shown(file)} is not read, because it {problem}", fix="write it again with GDAL")

    def start(name: str, attributes: dict[str, str]) -> None:
        """Refuse an element that is nested too deep, names another file or has a damaged projection."""
        nonlocal depth, in_system
        depth, in_system = depth + 1, depth == 1 and name == "SRS"  # directly in the root element
        if depth > MAX_DEPTH:
            refuse(f"has elements more than {MAX_DEPTH} deep")
        if "OVERVIEW_FILE" in attributes.values():
            refuse("names another file")
        if not _SYSTEM.fullmatch(attributes.get("Projection", "").strip()):
            refuse("names no coordinate system in the place of one")

    def end(_name: str) -> None:
        """Leave an element."""
        nonlocal depth, in_system
        depth, in_system = depth - 1, False

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda text: texts.append(text) if in_system else None
    parser.StartDoctypeDeclHandler = lambda *_: refuse("has a document type, which may define entities")
    try:
        parser.Parse(_content(file), True)
    except (expat.ExpatError, ValueError, LookupError) as reason:
        refuse(f"is no well-formed XML ({reason})")
    system = "".join(texts).strip()
    if not _SYSTEM.fullmatch(system):
        refuse("names no coordinate system in the place of one")
    return system


def allow_aux_file(path: Path) -> list[str]:
    """Let GDAL read the .aux.xml beside a raster if it is harmless; return a warning if it is not.

    GDAL then also reads those of its masks and overviews, such as dem.tif.msk.aux.xml, so all of them are checked.
    """
    from rasterio.env import setenv

    files, main = aux_files(path), aux_file(path)
    try:
        for file in files:
            read_aux(file)
    except TerrainError as reason:
        return [f"{reason} Its position, no-data, scale, offset and unit are not used."]
    if main is not None and main.name != path.name + AUX:  # GDAL may find only the file that was checked
        return [
            f"{shown(main)} is named otherwise than {shown(path.name)} in upper or lower case, so only its coordinate "
            f"system is read, not its position, no-data, scale, offset and unit: rename it to {shown(path.name)}{AUX}."
        ]
    if files:
        setenv(GDAL_PAM_ENABLED="YES")
    return []


def aux_files(path: Path) -> list[Path]:
    """Return the .aux.xml files of a raster, its masks and its overviews, the raster's own first.

    Of several of the raster itself, in upper and lower case, only the one of `aux_file` counts. Those of masks and
    overviews are not found in a folder that cannot be listed.
    """
    main, start, inner = aux_file(path), path.name.lower() + ".", []
    with contextlib.suppress(OSError):
        names = [name for name in _names_from(path, start) if name.lower().endswith(AUX)]
        inner = [path.with_name(name) for name in names if name.lower() != start + AUX[1:]]
    return [main, *inner] if main is not None else inner


def mask_files(path: Path) -> list[Path]:
    """Return the masks beside a raster, such as dem.tif.msk, whatever the case of their suffix."""
    return [file for file in sidecars(path) if file.name.lower() == f"{path.name.lower()}.msk"]


def mask_notes(paths: Iterable[Path]) -> list[str]:
    """Return a warning about masks beside a VRT and its sources, which no import reads; [] without any."""
    masks = [mask for path in paths for mask in mask_files(path)]
    if not masks:
        return []
    which = f"The mask {shown(masks[0].name)} is" if len(masks) == 1 else f"{len(masks):,} masks are"
    such = "" if len(masks) == 1 else f", such as {shown(masks[0].name)}"
    return [
        f"{which} beside the VRT or its sources{such}, and such files are not read: import the sources themselves, or "
        "write masks into them (gdal_translate --config GDAL_TIFF_INTERNAL_MASK YES)."
    ]


def unread_mask_notes(path: Path, dataset: DatasetReader) -> list[str]:
    """Return a warning about a mask beside a raster that GDAL does not read as one; [] without any."""
    from rasterio.enums import MaskFlags

    masks = mask_files(path)
    if not masks or not all({MaskFlags.all_valid, MaskFlags.nodata} & {*flags} for flags in dataset.mask_flag_enums):
        return []
    return [
        f"{shown(masks[0].name)} hides no samples, because it is no mask that GDAL reads: get it again, or give it the "
        "metadata item INTERNAL_MASK_FLAGS_1=2 (gdal_edit.py -mo)."
    ]


def named_crs(path: Path, notes: list[str]) -> CRS | None:
    """Return the coordinate system in the files beside a raster that names none itself; None if there is none.

    GDAL reads a .prj only beside ASCII grids, and the system in an .aux.xml only beside other rasters.

    Args:
        path: the raster's file.
        notes: gets a warning about a .prj that cannot be read.
    """
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    aux = aux_file(path)
    with contextlib.suppress(TerrainError, CRSError):
        if aux is not None and (system := read_aux(aux)):
            return CRS.from_user_input(system)
    for file in sidecars(path):
        if file.suffix.lower() == ".prj":
            try:
                return CRS.from_wkt(_content(file).decode())
            except (TerrainError, CRSError, UnicodeDecodeError):
                notes.append(f"{shown(file)} is not read, because it holds no coordinate system: write WKT into it.")
    return None


def _content(file: Path) -> bytes:
    """Return the bytes of a sidecar. Raises TerrainError if it is too large or cannot be read."""
    try:
        content = read_start(file, MAX_BYTES + 1)
    except OSError as reason:
        what = f"{shown(file)} cannot be read ({reason.strerror or reason})"
        raise TerrainError(what, fix="change its permissions") from reason
    if len(content) > MAX_BYTES:
        what = f"{shown(file)} is not read, because it has more than {MAX_BYTES >> 20} MB"
        raise TerrainError(what, fix="write it again")
    return content
