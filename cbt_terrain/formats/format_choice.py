# SPDX-License-Identifier: GPL-3.0-or-later
"""The format of a file: by its suffix and, where several formats share one, by its first bytes."""

from pathlib import Path

from ..errors import TerrainError
from ..rasters.source_formats import FORMATS, SourceFormat
from ..run.named_file import read_start
from . import archives

HEAD_BYTES = 1024  # the first record of a USGS DEM, which is text


def format_of(path: Path) -> SourceFormat | None:
    """Return the format of a file, None for an unknown suffix. For a file that cannot be read the suffix decides."""
    form = FORMATS.get(path.suffix.lower())
    if form is None or not form.others:
        return form
    try:
        return _choose(form, read_start(path, HEAD_BYTES))
    except OSError:  # opening it reports that
        return form


def inner_formats(path: Path) -> list[SourceFormat]:
    """Return the format of a file, or those of the height maps in an archive; [] for an unknown suffix.

    An archive of other files has none, too. Raises TerrainError for an unusable archive.
    """
    if archives.is_archive(path):
        try:
            return [_packed_format(inner) for inner in archives.height_maps(path)]
        except TerrainError as error:
            if error.code != archives.NO_HEIGHT_MAP:
                raise
            return []
    form = format_of(path)
    return [] if form is None else [form]


def _packed_format(path: Path) -> SourceFormat:
    """Return the format of a height map in an archive."""
    form = FORMATS[archives.inner_path(path).suffix.lower()]
    return _choose(form, archives.read_head(path, HEAD_BYTES)) if form.others else form


def _choose(form: SourceFormat, head: bytes) -> SourceFormat:
    """Return the format, or the first of its others that the first bytes of a file fit: `starts`, or plain text."""
    is_text = head.isascii() and head.decode("ascii").replace("\r", "").replace("\n", "").isprintable()
    return next((other for other in form.others if (head.startswith(other.starts) if other.starts else is_text)), form)
