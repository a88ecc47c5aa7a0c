# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the verbs `import` and `info`, which describe height maps."""

import argparse

from . import import_verbs
from .argument_types import MAX_ERROR_M, MAX_INT, argparse_type, count_from_one, pair, path, path_text, positive

PROJECT = {"metavar": "utm|EPSG:n", "help": "reproject the raster into this coordinate system"}


def add_import(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `import`."""
    from ...cbt_terrain.field.island import DEFAULT_SEED, DEFAULT_SIZE
    from ...cbt_terrain.field.lands import LANDS
    from ...cbt_terrain.importing.thinning import QUICK_SAMPLES
    from ...cbt_terrain.rasters.source_formats import FORMATS

    kinds = ", ".join(dict.fromkeys(form.title for form in FORMATS.values()))
    source = f"height map ({kinds}), or a built-in land: {', '.join(LANDS)}"
    source += "; several files, folders and tile indexes (.gti) become one terrain"
    verb.add_argument("sources", type=path_text, nargs="+", metavar="SOURCE", help=source)
    verb.add_argument("--store", type=path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument(
        "--extent",
        type=pair("x", float, max_value=float("inf")),
        metavar="XxY",
        help="metres east and north, instead of the file's",
    )
    image = "images without a unit: a relief of a quarter of the width"
    verb.add_argument("--height-scale", type=float, metavar="F", help=f"metres per unit of the file (1; {image})")
    for end in ("lowest", "highest"):
        about = f"height of the {end} sample, instead of a scale"
        verb.add_argument(f"--{end}", type=float, metavar="METRES", help=about)
    verb.add_argument("--height-offset", type=float, metavar="METRES", help="added to every height (0)")
    _add_contents(verb)
    verb.add_argument("--first-row-south", action="store_true", help="for files that do not say where north is")
    verb.add_argument("--project", **PROJECT)
    _add_mosaic(verb)
    quick = "of a large raster, load only every n-th sample; the same command without it loads all"
    verb.add_argument("--quick", action="store_const", const=QUICK_SAMPLES, help=quick)
    _add_raw_options(verb)
    _add_parts(verb)
    verb.add_argument("--size", type=int, metavar="N", help=f"built-in land: samples a side ({DEFAULT_SIZE})")
    verb.add_argument("--seed", type=int, metavar="N", help=f"built-in land: its shape ({DEFAULT_SEED})")


def _add_contents(verb: argparse.ArgumentParser) -> None:
    """Add the options that say which values of a file are heights, and which are missing."""
    from ...cbt_terrain.rasters.raster import ENCODINGS

    verb.add_argument("--no-data", type=float, metavar="VALUE", help="value that means no data, instead of the file's")
    verb.add_argument("--holes", action="store_true", help="cut out samples without data instead of filling them")
    verb.add_argument("--band", type=int, metavar="N", help="band of a file with several, from 1 (1)")
    verb.add_argument("--channel", metavar="NAME", help="channel of an EXR file (the first that fits)")
    verb.add_argument(
        "--encoding",
        choices=ENCODINGS[1:],  # without "", which recognises coded heights
        help="of heights in an image's colours; plain for none (recognised in web map tiles z/x/y.png)",
    )
    verb.add_argument("--cell", type=float, metavar="METRES", help="side of the cells of gridded points (from density)")


def _add_parts(verb: argparse.ArgumentParser) -> None:
    """Add the options of an import that several computers share."""
    from ...cbt_terrain.importing.tile_import import PARTS
    from ..export.formats import parse_frames

    part = verb.add_mutually_exclusive_group()
    part.add_argument("--only", choices=PARTS, help="one part of an import; without, all that is not done yet")
    part.add_argument("--job", type=path, metavar="DIR", help="write a job that a render farm runs, and import nothing")
    tiles = {"type": argparse_type(parse_frames), "metavar": "A-B", "default": ()}
    verb.add_argument("--tiles", **tiles, help="numbers of the tiles to read or measure, from 0")
    verb.add_argument(
        "--chunk", type=count_from_one, metavar="N", help=f"tiles of one task ({import_verbs.TASK_TILES})"
    )


def add_info(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `info`."""
    about = "a store, a height map or an .npz; several height maps or a folder of them are described as one terrain"
    verb.add_argument("paths", type=path_text, nargs="*", metavar="PATH", help=about)
    verb.add_argument("--versions", action="store_true", help="of all that is used, and what reading a file gives up")
    verb.add_argument("--verify", action="store_true", help="of a store, check every block of every array")
    verb.add_argument("--json", dest="as_json", action="store_true", help="print one line of JSON")
    _add_contents(verb)
    verb.add_argument("--project", **PROJECT)
    _add_mosaic(verb)
    _add_raw_options(verb)


def _add_mosaic(verb: argparse.ArgumentParser) -> None:
    """Add the options of several files."""
    from ...cbt_terrain.rasters.raster import PRIORITIES

    priority = "which of several files is used where they overlap: the last, the finest or the newest (order)"
    verb.add_argument("--priority", choices=PRIORITIES, help=priority)
    blend = "leave the step where a finer file ends on a coarser one, instead of blending their heights"
    verb.add_argument("--no-blend", dest="blend", action="store_false", help=blend)
    step = positive(MAX_ERROR_M)
    verb.add_argument(
        "--step", type=step, metavar="METRES", help="between samples of several files (the finest file's)"
    )


def _add_raw_options(verb: argparse.ArgumentParser) -> None:
    """Add the options that describe the layout of a RAW file, which has no header."""
    from ...cbt_terrain.rasters.raster import RAW_TYPES

    verb.add_argument(
        "--raw-size", type=pair("x", int, MAX_INT), metavar="WxH", help="samples of a RAW file (a square)"
    )
    verb.add_argument("--raw-type", dest="raw_dtype", choices=RAW_TYPES, help="samples of a RAW file (uint16)")
    big_endian = "byte order of a RAW file; little endian otherwise"
    verb.add_argument("--big-endian", dest="raw_little_endian", action="store_false", help=big_endian)
