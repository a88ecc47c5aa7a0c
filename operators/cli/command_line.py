# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `adaptive-terrain VERB`, and the same as `blender --command adaptive_terrain VERB`.

Exit codes: 0 done, 1 failed (one line on stderr says why), 2 wrong usage, 130 stopped by Ctrl-C, 143 by SIGTERM. bpy is
imported only by verbs that need it; the engine, whose import takes a moment, only where an interruption is reported in
one line.
"""

import argparse
import gc
import importlib.util
import json
import re
import signal
import sys
from pathlib import Path
from typing import NoReturn

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run import stopping
from ..text.console import BAR, LONGEST_LINE, OPENJD, open_streams, print_line, unwritten
from . import farm_verbs, tile_verbs, verbs
from .argument_types import (
    MAX_INT,
    add_settings,
    argument,
    count,
    count_from_one,
    pair,
    parse_effects,
    path,
    path_text,
    positive,
)

PROGRAM = "adaptive-terrain"
MAX_PIXELS = 65_536  # a side, as in Blender
MAX_ERROR_PX, MAX_ERROR_M, MAX_DISPLACEMENT_M = 1e6, 1e9, 1e6
MAX_BUDGET_MB, MAX_MEMORY_GIB = 1e9, 1e6
FRAMES = "A,B-C,D-E:STEP"
CHUNK = 4  # a mesh takes less than Blender's start, so a task makes several
SHAPE_EXAMPLE = """example: rivers age the land for 300,000 years where it is below 900 m, and the result for QGIS

  {"version": 1, "entries": [{"effect": "rivers", "parameters": {"years": 3e5},
    "mask": {"rules": [{"of": "height", "high": 900, "edge": 50}]}}]}

  adaptive-terrain shape --store island.store --stack rivers.json --out old.store --export old.tif"""
BUDGET_HELP = "triangles at most, but not fewer than two for each root square"
BETWEEN = "of the surface between samples"
# Options of several verbs.
SIZE, PIXELS = pair("x", int, MAX_PIXELS), positive(MAX_ERROR_PX)
PROJECT = {"default": "", "metavar": "utm|EPSG:n", "help": "reproject the raster into this coordinate system"}
DISPLACEMENT = {
    "type": pair(",", float, MAX_DISPLACEMENT_M),
    "metavar": "AMPLITUDE,WAVELENGTH",
    "help": "metres of height and length of relief below the raster's cells",
}
CAMERA = {"metavar": "NAME", "help": "a camera of the scene, instead of its active one"}


def main(argv: list[str] | None = None) -> int:
    """Run one command; `argv` without the program's name (None: the process's own). Returns the exit code."""
    with stopping.listening():
        try:
            return _run(argv)
        except KeyboardInterrupt:
            print(f"{PROGRAM}: stopped", file=sys.stderr)
            return 128 + (stopping.answer() or signal.SIGINT)
        finally:
            stopping.answer()  # an interruption after the work comes too late


def program() -> NoReturn:
    """Run `main` as a program: before and after the work Ctrl-C ends it without a traceback."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_streams()
    sys.exit(main())


def _run(argv: list[str] | None) -> int:
    """Parse the arguments and run their verb; print errors as one line on stderr. Returns the exit code."""
    try:
        arguments = _build_parser_without_gc().parse_args(
            _with_negatives_joined(sys.argv[1:] if argv is None else argv)
        )
        arguments.run(arguments)
        print(end="", flush=True)
    except SystemExit as exit_:  # argparse has printed its message
        return exit_.code or 0
    except verbs.UsageError as error:
        print_line(f"{PROGRAM} {arguments.verb}: error: {shown(error, LONGEST_LINE)}", file=sys.stderr)
        return 2
    except (TerrainError, OSError) as error:
        message = unwritten(error) or shown(_error_text(error), LONGEST_LINE)
        fields = error.to_json() if isinstance(error, TerrainError) else {"what": str(message)}
        print_line(json.dumps(fields) if arguments.json_errors else f"{PROGRAM}: error: {message}", file=sys.stderr)
        if arguments.progress == OPENJD:
            print_line(message, "openjd_fail")
        return 1
    return 0


def _error_text(error: TerrainError | OSError) -> object:
    """Return an error that prints as one sentence: a system's error is given its file and reason."""
    if isinstance(error, TerrainError) or error.filename is None:
        return error
    return f"{error.filename} cannot be read or written ({error.strerror}); check the disk, or choose another place."


def _build_parser_without_gc() -> argparse.ArgumentParser:
    """Build the parser without garbage collection, which would search all imported modules for 0.1 s."""
    gc.disable()
    try:
        return build_parser()
    finally:
        gc.enable()


def _with_negatives_joined(argv: list[str]) -> list[str]:
    """Join values below 0, such as -1e9 or the frames -5--1, to their option: argparse takes them for an option."""
    joined = []
    for word in argv:
        if joined and re.match("--[^=]+$", joined[-1]) and re.match(r"-(\.?\d|inf|nan)", word, re.IGNORECASE):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of all verbs. Each verb sets `run`, the function that carries it out."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="A terrain at exactly the detail that the camera can see."
    )
    parser.add_argument("--json", dest="json_errors", action="store_true", help="print an error as JSON")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    _add_import(subparsers)
    _add_info(subparsers)
    _add_bake(subparsers)
    _add_export(subparsers)
    tile_verbs.add_tiles(_add_verb, subparsers)
    tile_verbs.add_tileset(_add_verb, subparsers)
    tile_verbs.add_map(_add_verb, subparsers)
    _add_maps(subparsers)
    _add_accuracy(subparsers)
    _add_effects(subparsers)
    _add_shape(subparsers)
    _add_farm(subparsers)
    _add_query(subparsers)
    _add_demo(subparsers)
    if importlib.util.find_spec("...benchmarks", __package__):  # they are no part of the extension
        _add_bench(subparsers)
    return parser


def _add_import(subparsers) -> None:
    """Add the verb `import` and its arguments."""
    from ...cbt_terrain.field.island import DEFAULT_SEED, DEFAULT_SIZE
    from ...cbt_terrain.field.lands import LANDS
    from ...cbt_terrain.importing.thinning import QUICK_SAMPLES
    from ...cbt_terrain.rasters.raster import ENCODINGS
    from ...cbt_terrain.rasters.source_formats import FORMATS

    verb = _add_verb(subparsers, "import", "turn a height map into a store", verbs.run_import)
    kinds = ", ".join(dict.fromkeys(form.title for form in FORMATS.values()))
    source = f"height map ({kinds}), or a built-in land: {', '.join(LANDS)}"
    source += "; several files, folders and tile indexes (.gti) become one terrain"
    verb.add_argument("sources", type=path_text, nargs="+", metavar="SOURCE", help=source)
    verb.add_argument("--store", type=path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument(
        "--extent",
        type=pair("x", float, float("inf")),
        metavar="XxY",
        help="metres east and north, instead of the file's",
    )
    image = "images without a unit: a relief of a quarter of the width"
    verb.add_argument("--height-scale", type=float, metavar="F", help=f"metres per unit of the file (1; {image})")
    for end in ("lowest", "highest"):
        about = f"height of the {end} sample, instead of a scale"
        verb.add_argument(f"--{end}", type=float, metavar="METRES", help=about)
    verb.add_argument("--height-offset", type=float, metavar="METRES", help="added to every height (0)")
    verb.add_argument("--no-data", type=float, metavar="VALUE", help="value that means no data, instead of the file's")
    verb.add_argument("--holes", action="store_true", help="cut out samples without data instead of filling them")
    verb.add_argument("--band", type=int, metavar="N", help="band of a file with several, from 1 (1)")
    verb.add_argument("--channel", metavar="NAME", help="channel of an EXR file (the first that fits)")
    verb.add_argument(
        "--encoding",
        choices=ENCODINGS[1:],
        help="of heights in an image's colours; plain for none (recognised in web map tiles z/x/y.png)",
    )
    verb.add_argument("--cell", type=float, metavar="METRES", help="side of the cells of gridded points (from density)")
    verb.add_argument("--first-row-south", action="store_true", help="for files that do not say where north is")
    verb.add_argument("--project", **PROJECT)
    _add_mosaic(verb)
    quick = "of a large raster, load only every n-th sample; the same command without it loads all"
    verb.add_argument("--quick", action="store_const", const=QUICK_SAMPLES, help=quick)
    _add_raw_options(verb)
    _add_parts(verb)
    verb.add_argument("--size", type=int, metavar="N", help=f"built-in land: samples a side ({DEFAULT_SIZE})")
    verb.add_argument("--seed", type=int, metavar="N", help=f"built-in land: its shape ({DEFAULT_SEED})")


def _add_parts(verb: argparse.ArgumentParser) -> None:
    """Add the options of an import that several computers share."""
    from ...cbt_terrain.importing.tile_import import PARTS
    from ..export.formats import parse_frames

    part = verb.add_mutually_exclusive_group()
    part.add_argument("--only", choices=PARTS, help="one part of a large import; without, all that is not done yet")
    part.add_argument("--job", type=path, metavar="DIR", help="write a job that a render farm runs, and import nothing")
    tiles = {"type": argument(parse_frames), "metavar": "A-B", "default": ()}
    verb.add_argument("--tiles", **tiles, help="numbers of the tiles to read or measure, from 0")
    verb.add_argument("--chunk", type=count_from_one, metavar="N", help=f"tiles of one task of the job ({CHUNK})")


def _add_info(subparsers) -> None:
    """Add the verb `info` and its arguments."""
    verb = _add_verb(subparsers, "info", "describe a store, a height map or an exported .npz", verbs.run_info)
    about = "a store, a height map or an .npz; several height maps or a folder of them are described as one terrain"
    verb.add_argument("paths", type=path_text, nargs="*", metavar="PATH", help=about)
    verb.add_argument("--versions", action="store_true", help="of all that is used, and what reading a file gives up")
    verb.add_argument("--verify", action="store_true", help="of a store, check every block of every array")
    verb.add_argument("--json", dest="as_json", action="store_true", help="print one line of JSON")
    verb.add_argument("--project", **PROJECT)
    _add_mosaic(verb)
    _add_raw_options(verb)


def _add_bake(subparsers) -> None:
    """Add the verb `bake` and its arguments."""
    from ...cbt_terrain.field.heightfield import INTERPOLATIONS
    from ..export.formats import FORMATS

    verb = _add_verb(subparsers, "bake", "write one static mesh with a given largest vertical error", verbs.run_bake)
    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    metres = positive(MAX_ERROR_M)
    verb.add_argument("--max-error", type=metres, required=True, metavar="METRES", help="largest vertical error")
    verb.add_argument("--out", type=path, required=True, metavar="FILE", help=f"format by suffix: {', '.join(FORMATS)}")
    verb.add_argument("--budget", type=count, metavar="N", help=BUDGET_HELP + "; the error reached is reported")
    verb.add_argument("--interpolation", default=INTERPOLATIONS[0], choices=INTERPOLATIONS, help=BETWEEN)
    verb.add_argument("--displacement", "--detail", **DISPLACEMENT)
    verb.add_argument("--fit", action="store_true", help="move vertices off the surface: fewer triangles, same error")


def _add_export(subparsers) -> None:
    """Add the verb `export` and its arguments."""
    from ...cbt_terrain.field.heightfield import INTERPOLATIONS
    from ..export.formats import FORMATS, parse_formats

    verb = _add_verb(subparsers, "export", "write the terrain's mesh for each frame", verbs.run_export)
    _add_view_options(verb, "a store, seen along --path; npz needs no Blender", frames_required=True)
    verb.add_argument("--format", type=argument(parse_formats), required=True, metavar="F,F", help=", ".join(FORMATS))
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    add_settings(verb)
    verb.add_argument("--interpolation", choices=INTERPOLATIONS, help=BETWEEN)
    verb.add_argument("--displacement", "--detail", **DISPLACEMENT)
    verb.add_argument(
        "--effects",
        type=argument(parse_effects),
        metavar="auto|none|F,F",
        help="attributes to write: those that the scene reads (auto; of a store none), none, or these",
    )
    about = "positions about a point near --path, not about the raster's middle: precise far from that"
    verb.add_argument("--anchor", action="store_true", help=about)
    verb.add_argument("--scatter", action="store_true", help="also the points of the scene's scatters, each as CSV")
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")


def _add_maps(subparsers) -> None:
    """Add the verb `maps` and its arguments."""
    from ...cbt_terrain.attributes.coding import FORMS as MAP_FORMS

    verb = _add_verb(
        subparsers, "maps", "bake effects into images, as fine as what looks at them needs", verbs.run_maps
    )
    _add_view_options(verb, "a store, seen along --path, or as a whole")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the images and maps.json")
    verb.add_argument(
        "--maps", metavar="NAME,NAME", help=f"names (those of the scene's settings, or {verbs.DEFAULT_MAP})"
    )
    verb.add_argument("--budget", type=positive(MAX_BUDGET_MB), metavar="MB", help="of all images together, in Blender")
    verb.add_argument("--format", choices=MAP_FORMS, help="png (8 and 16 bits) or exr (floats)")


def _add_accuracy(subparsers) -> None:
    """Add the verb `accuracy` and its arguments."""
    verb = _add_verb(
        subparsers, "accuracy", "measure errors, and what they cost in time and triangles", verbs.run_accuracy
    )
    _add_view_options(verb, "a store, seen along --path, or as a whole")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the page, plots, CSV and JSON")


def _add_effects(subparsers) -> None:
    """Add the verb `effects` and its arguments."""
    verb = _add_verb(
        subparsers, "effects", "list the effects; what they take on a store, which a scene reads", verbs.run_effects
    )
    source = verb.add_mutually_exclusive_group()
    source.add_argument("--scene", type=path, metavar="X.blend", help="readers of each, and why others are skipped")
    source.add_argument("--store", type=path, metavar="DIR", help="time and memory of each, measured on a mesh of it")
    verb.add_argument("--camera", **CAMERA)


def _add_shape(subparsers) -> None:
    """Add the verb `shape` and its arguments."""
    from ..export.formats import parse_frames

    verb = _add_verb(
        subparsers, "shape", "apply a stack of effects on heights to a store, into another", verbs.run_shape
    )
    verb.epilog = SHAPE_EXAMPLE
    verb.formatter_class = argparse.RawDescriptionHelpFormatter
    verb.add_argument("--store", type=path, required=True, metavar="DIR", help="the store to be shaped")
    verb.add_argument("--stack", type=path, required=True, metavar="FILE.json", help="the effects, in their order")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder of the store to write")
    verb.add_argument("--path", type=path, metavar="FILE.json", help="only tiles that this camera sees")
    verb.add_argument("--frames", type=argument(parse_frames), metavar=FRAMES, help="of the path (all)")
    verb.add_argument("--resolution", type=SIZE, metavar="WxH", help="pixels of the camera (1920x1080)")
    verb.add_argument(
        "--pixel-error", type=PIXELS, metavar="PX", help="smallest change for which a finer level is made (1)"
    )
    verb.add_argument("--whole", action="store_true", help="all tiles, also beyond 4097 x 4097 samples")
    verb.add_argument(
        "--finish-early", type=positive(1e9), metavar="SECONDS", help="then be content with the levels that are done"
    )
    verb.add_argument(
        "--export", type=path, metavar="FILE", help="heights as .tif or .exr too, and layers as FILE_layer.tif"
    )


def _add_query(subparsers) -> None:
    """Add the verb `query` and its arguments."""
    verb = _add_verb(subparsers, "query", "heights, slopes and normals of a store at points, as CSV", verbs.run_query)
    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    columns = "with columns x and y: in the store's coordinate system, or metres from the terrain's middle"
    verb.add_argument("--points", type=path, required=True, metavar="FILE.csv", help=columns)
    verb.add_argument("--out", type=path, metavar="FILE.csv", help="its columns and the results (stdout)")
    verb.add_argument(
        "--profile", action="store_true", help="along the line through the points, wherever it crosses the raster's"
    )


def _add_demo(subparsers) -> None:
    """Add the verb `demo` and its arguments."""
    verb = _add_verb(subparsers, "demo", "the built-in island: 24 frames, pictures and a page", verbs.run_demo)
    verb.add_argument("--out", type=path, default=Path("demo"), metavar="DIR", help="folder to write (demo)")


def _add_farm(subparsers) -> None:
    """Add the verbs with which a render farm is used, `submit` and others, and their arguments."""
    from ..export.formats import parse_formats, parse_frames

    formats, frames = argument(parse_formats), argument(parse_frames)
    scene = {"type": path, "metavar": "X.blend", "required": True}
    verb = _add_verb(subparsers, "submit", "write a job that a render farm runs", farm_verbs.run_submit)
    verb.add_argument("--scene", **scene, help="the .blend file, as it is on disk")
    verb.add_argument("--frames", type=frames, metavar=FRAMES, help="the scene's, without")
    verb.add_argument(
        "--out", type=path, required=True, metavar="DIR", help="folder for the job; frames go to DIR/frames"
    )
    verb.add_argument("--chunk", type=count_from_one, default=CHUNK, metavar="N", help=f"frames of one task ({CHUNK})")
    what = verb.add_mutually_exclusive_group()
    what.add_argument("--render", action="store_true", help="pictures, instead of meshes")
    what.add_argument("--format", type=formats, default=("npz",), metavar="F,F", help="of the meshes (npz)")
    verb.add_argument(
        "--extension",
        type=path_text,
        metavar="ZIP",
        help="install this zip for the job alone; installed: pack the one that runs",
    )
    memory = positive(MAX_MEMORY_GIB)
    verb.add_argument("--min-memory", type=memory, default=0.0, metavar="GIB", help="memory that a worker needs (any)")
    outside = "also bring files from outside the scene's folder that are no images, height maps or stores"
    verb.add_argument("--allow-outside", action="store_true", help=outside)

    verb = _add_verb(
        subparsers, "prepare", "make what all frames of a scene need, ahead of them", farm_verbs.run_prepare
    )
    verb.add_argument("--scene", **scene)
    verb.add_argument("--frames", type=frames, metavar=FRAMES, help="that are to come (the scene's)")
    verb.add_argument("--only", choices=("stores", "land"), help="import stores, or shape land and bake maps")

    verb = _add_verb(
        subparsers, "render", "render frames of a scene, each refined or not rendered", farm_verbs.run_render
    )
    verb.add_argument("--scene", **scene)
    verb.add_argument("--frames", type=frames, required=True, metavar=FRAMES)
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")

    verb = _add_verb(subparsers, "verify", "check that frames are there, whole and of one scene", farm_verbs.run_verify)
    verb.add_argument("folder", type=path, help="where export or render has written them")
    verb.add_argument("--frames", type=frames, required=True, metavar=FRAMES)


def _add_bench(subparsers) -> None:
    """Add the verb `bench` and its arguments."""
    verb = _add_verb(
        subparsers, "bench", "what everything costs on this machine, beside two baselines", verbs.run_bench
    )
    verb.add_argument("--quick", action="store_true", help="fewer rows; fails if one is much slower than its goal")
    verb.add_argument("--with-cycles", action="store_true", help="also whole renders in Cycles (minutes more)")
    verb.add_argument("--blender", nargs="+", metavar="COMMAND", help="also frames inside the program that this starts")
    verb.add_argument("--json", type=path, metavar="FILE", help="write the rows as JSON")
    verb.add_argument("--docs", type=path, metavar="DIR", help="write performance.md and its chart into this folder")


def _add_verb(subparsers, name: str, summary: str, run) -> argparse.ArgumentParser:
    """Add a verb with its help and the option --progress; return its parser.

    `run`: function that carries the verb out, called with the parsed arguments.
    """
    verb = subparsers.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
    how = {"nargs": "?", "choices": (BAR, OPENJD), "const": BAR}
    verb.add_argument(
        "--progress",
        **how,
        help="show the bar even where no terminal is, or tell a farm that runs Open Job Description",
    )
    verb.set_defaults(run=run)
    return verb


def _add_view_options(verb: argparse.ArgumentParser, store: str, frames_required: bool = False) -> None:
    """Add the options for a scene or a store and for the views of it.

    `store`: help of --store. `frames_required`: whether --frames must be given.
    """
    from ..export.formats import parse_frames

    source = verb.add_mutually_exclusive_group(required=True)
    source.add_argument("--scene", type=path, metavar="X.blend", help="the terrains and the camera of a .blend file")
    source.add_argument("--store", type=path, metavar="DIR", help=store)
    frames = {"type": argument(parse_frames), "metavar": FRAMES, "help": "of the path or the scene"}
    verb.add_argument("--frames", required=frames_required, **frames)
    verb.add_argument("--camera", **CAMERA)
    camera_path = "camera path for --store (docs/reference/camera-path.md)"
    verb.add_argument("--path", type=path, metavar="FILE.json", help=camera_path)
    verb.add_argument("--resolution", type=SIZE, metavar="WxH", help="pixels (the scene's, or 1920x1080)")


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


if __name__ == "__main__":
    program()
