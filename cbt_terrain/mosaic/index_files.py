# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths in a tile index (GTI): a GeoPackage or SQLite database, a shapefile, or XML that names one of these.

GDAL would open whatever an index names, so it never gets one. Only the column of paths is read, and each must lead to a
regular file of a known kind with a small parser: which files an index names is not known when the process gives up its
rights. As with GDAL, relative paths begin at the folder of the index that is opened.
"""

import sqlite3
import struct
from pathlib import Path
from xml.etree import ElementTree

from ..errors import TerrainError, shown
from ..importing.source_list import MAX_FILES
from ..rasters.source_formats import FORMATS
from ..run.named_file import cause, open_regular, read_regular, read_start
from ..run.owned_files import without_dots

MAX_XML_BYTES = 1 << 20
SQLITE, XML = b"SQLite format 3\0", b"<"
COLUMNS = ("location", "path", "file", "filename")  # names of the column of paths, the usual one first
MAX_FIELDS, FIELD_BYTES = 2048, 32


def paths_in(path: Path) -> list[Path]:
    """Return the files that a tile index names, in its order and once each, without `..`. Raises TerrainError."""
    try:
        names, column = _names_in(path, "")
    except (OSError, ValueError, sqlite3.Error, struct.error, ElementTree.ParseError) as reason:
        what = f"{shown(path)} cannot be read as a tile index ({cause(reason)})"
        raise TerrainError(what, expected="a GeoPackage, a shapefile or XML of GDAL's gti format") from reason
    sources = dict.fromkeys(without_dots(path.parent / name) for name in names if name)
    for source in sources:
        _check(path, source)
    if not sources:
        what = f"{shown(path)} names no file"
        raise TerrainError(what, expected=f"paths in the column {column or COLUMNS[0]!r}")
    return list(sources)


def _names_in(path: Path, column: str) -> tuple[list[str], str]:
    """Return the paths in an index as texts, and the name under which their column was searched.

    column: this name, "" for the usual ones (COLUMNS). An index in XML names another index and its column, which is
    read instead. Raises OSError, ValueError, and the errors of the modules that parse the index.
    """
    start = read_start(path, len(SQLITE))
    if start == SQLITE:
        return _names_in_database(path, column), column
    if start.lstrip().startswith(XML):
        root = ElementTree.fromstring(_plain_xml(path))
        inner = path.parent / (root.findtext("IndexDataset") or "").strip()
        if inner == path or not inner.is_file() or inner.suffix.lower() == ".gti":
            raise ValueError(f"its IndexDataset {shown(inner)} is no index beside it")
        return _names_in(inner, (root.findtext("LocationField") or "").strip())
    table = path.with_suffix(".dbf") if path.suffix.lower() == ".shp" else path
    if not table.exists():
        raise ValueError(f"its table {shown(table.name)} is not beside it")
    return _names_in_table(table, column), column


def _plain_xml(path: Path) -> bytes:
    """Return the XML of a file. Raises ValueError for a document type, which may define entities."""
    content = read_regular(path, MAX_XML_BYTES)
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise ValueError("it has a document type")
    return content


def _names_in_database(path: Path, column: str) -> list[str]:
    """Return the paths in the first table of a database that has a column of them.

    Values that are no texts are left out. Raises ValueError if no table has one or there are too many paths, and
    sqlite3.Error.
    """
    uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    connection = sqlite3.connect(uri, uri=True)
    try:
        tables = [
            row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
        ]
        for table in map(_quoted, tables):
            names = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
            position = _find_column(names, column)
            if position is not None:
                query = f"SELECT {_quoted(names[position])} FROM {table} ORDER BY rowid LIMIT {MAX_FILES + 1}"
                return _check_count([row[0] for row in connection.execute(query) if isinstance(row[0], str)])
    finally:
        connection.close()
    raise ValueError(f"no table has a column {column or COLUMNS[0]!r}")


def _quoted(name: str) -> str:
    """Return a name of a table or column as SQL."""
    return '"' + name.replace('"', '""') + '"'


def _find_column(names: list[str], column: str) -> int | None:
    """Return the position of the column of paths among `names`, None if there is none.

    column: its name in any case, "" for one of the usual names.
    """
    lower = [name.lower() for name in names]
    wanted = [column.lower()] if column else COLUMNS
    return next((lower.index(name) for name in wanted if name in lower), None)


def _names_in_table(path: Path, column: str) -> list[str]:
    """Return the paths in a dBASE table, the attributes of a shapefile; deleted rows are left out.

    Raises ValueError without such a column and for too many paths, and OSError.
    """
    with open_regular(path, links=True) as file:
        head = file.read(FIELD_BYTES)
        if len(head) < FIELD_BYTES:
            raise ValueError("it is empty" if not head else "it ends within its header")
        count, head_bytes, row_bytes = struct.unpack("<4xIHH20x", head)  # count: number of rows
        # The header's rest has FIELD_BYTES for each field: bytes 0 to 10 are its name, byte 16 its bytes in a row.
        fields = file.read(max(0, head_bytes - FIELD_BYTES))
        names, sizes = [], []
        for offset in range(0, min(len(fields), MAX_FIELDS * FIELD_BYTES) - FIELD_BYTES + 1, FIELD_BYTES):
            if fields[offset] == 0x0D:  # ends the list of fields
                break
            names.append(fields[offset : offset + 11].split(b"\0")[0].decode("latin-1"))
            sizes.append(fields[offset + 16])
        index = _find_column(names, column)
        if index is None or row_bytes != 1 + sum(map(int, sizes)):  # a row begins with its mark of deletion, " " or "*"
            raise ValueError(f"it has no column {column or COLUMNS[0]!r}")
        first = 1 + sum(map(int, sizes[:index]))
        # One row more than is allowed tells `_check_count` that there are too many.
        rows = [file.read(row_bytes) for _ in range(min(count, MAX_FILES + 1))]
    texts = [row[first : first + sizes[index]] for row in rows if len(row) == row_bytes and row[:1] != b"*"]
    return _check_count([text.decode("utf-8", "replace").strip(" \0") for text in texts])


def _check_count(names: list[str]) -> list[str]:
    """Return the names. Raises ValueError if there are more than MAX_FILES."""
    if len(names) > MAX_FILES:
        raise ValueError(f"it names more than {MAX_FILES:,} files")
    return names


def _check(index: Path, source: Path) -> None:
    """Raise TerrainError unless a path of an index leads to a regular file of a known kind."""
    what = f"{shown(index)} names the source {shown(source)!r}"
    try:
        is_regular = "\0" not in str(source) and not str(source).startswith(("/vsi", "\\\\", "//")) and source.is_file()
    except (OSError, ValueError):
        is_regular = False
    if not is_regular:
        raise TerrainError(f"{what}, which is no regular file here", expected="the file of a height map")
    form = FORMATS.get(source.suffix.lower())
    if form is None or not form.may_be_indexed:
        known = ", ".join(suffix for suffix, form in FORMATS.items() if form.may_be_indexed)
        raise TerrainError(what, expected=f"one of {known}", fix="name such files, or their folder, as sources")
