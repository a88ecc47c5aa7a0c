# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of an import that apply to some sources only, and their refusal for others, where they have no effect."""

from collections.abc import Collection
from dataclasses import fields
from pathlib import Path

from ..errors import TerrainError, shown
from ..field.lands import LANDS
from ..rasters.coded_heights import PLAIN
from ..rasters.raster import ImportSettings
from ..rasters.source_formats import BAND, CELL, CHANNEL, ENCODING, FORMATS, RAW, suffixes_with
from .header_files import lacks_header

UNUSED = "settings.unused"  # code of the error
FILE, ROWS, LAND = "file", "rows", "land"  # further options: of any file, of one file without a position, of a land
# By option: the settings, what they are for users, and which sources have them ("" for the suffixes of formats).
SETTINGS = {
    RAW: (("raw_size", "raw_dtype", "raw_little_endian"), "The layout (--raw-size, --raw-type, --big-endian)", ""),
    BAND: (("band",), "A band (--band)", ""),
    CHANNEL: (("channel",), "A channel (--channel)", ""),
    ENCODING: (("encoding",), "An encoding (--encoding)", ""),
    CELL: (("cell",), "A cell size (--cell)", ""),
    FILE: (("no_data", "holes"), "A treatment of no-data (--no-data, --holes)", "a file"),
    ROWS: (("first_row_south",), "An order of rows (--first-row-south)", "one file that does not state where north is"),
    LAND: (("size", "seed"), "A number of samples or a seed (--size, --seed)", f"one of {', '.join(LANDS)}"),
}


def options_of(path: Path) -> tuple[str, ...]:
    """Return the options of a file by its name, and by the header beside it; () for an unknown suffix.

    A .gz has those of the file in it.
    """
    if path.suffix.lower() == ".gz":
        return options_of(path.with_suffix(""))
    if lacks_header(path):
        return RAW, FILE, ROWS
    form = FORMATS.get(path.suffix.lower())
    return (*form.options, FILE, ROWS) if form is not None else ()


def check_applies(settings: ImportSettings, options: Collection[str], given: Collection[str] | None = None) -> None:
    """Raise TerrainError with the code UNUSED for a setting that the source does not have.

    options: of the source; () if they are not known, so that nothing is refused. given: names of the settings that were
    given; None for those without their default. The encoding PLAIN then counts as the default.
    """
    if given is None:
        given = {field.name for field in fields(settings) if getattr(settings, field.name) != field.default}
        given -= {"encoding"} if settings.encoding == PLAIN else set()
    for option, (names, what, having) in SETTINGS.items():
        if options and option not in options and {*names} & {*given}:
            expected = having or f"one of {', '.join(suffixes_with(option))}"
            expected += ", or samples without their header (.bil, .flt)" if option == RAW else ""
            raise TerrainError(
                f"{what} has no effect on {shown(settings.name)}", expected=expected, fix="leave it out", code=UNUSED
            )
