# SPDX-License-Identifier: GPL-3.0-or-later
"""The parser of the command line: verbs, their options and the functions that carry them out."""

import argparse
import importlib.util
from pathlib import Path

from ..text.console import BAR, OPENJD
from . import farm_verbs, import_options, tile_verbs, verbs
from .argument_types import (
    MAX_ERROR_M,
    add_settings,
    argument,
    count,
    count_from_one,
    pair,
    parse_effects,
    path,
    path_text,
    positive,
    share,
)

PROGRAM = "adaptive-terrain"
MAX_PIXELS = 65_536  # a side, as in Blender
MAX_ERROR_PX, MAX_DISPLACEMENT_M = 1e6, 1e6
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
SIZE = pair("x", int, MAX_PIXELS)
PIXELS = positive(MAX_ERROR_PX)
DISPLACEMENT = {
    "type": pair(",", float, MAX_DISPLACEMENT_M),
    "metavar": "AMPLITUDE,WAVELENGTH",
    "help": "metres of height and length of relief below the raster's cells",
}
JOB_STORES = {"type": path, "metavar": "DIR", "help": "a farm job's stores, for terrains with incomplete ones"}
CAMERA = {"metavar": "NAME", "help": "a camera of the scene, instead of its active one"}


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of all verbs. Each verb sets `run`, the function that carries it out."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="A terrain at exactly the detail that the camera can see."
    )
    parser.add_argument("--json", dest="json_errors", action="store_true", help="print an error as JSON")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    import_options.add_import(_add_verb, subparsers)
    import_options.add_info(_add_verb, subparsers)
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
    verb.add_argument("--job-stores", **JOB_STORES)


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
    only = "import stores, shape land and bake maps, find the tiles in view, or read some of these ahead"
    verb.add_argument("--only", choices=("stores", "land", "view", "tiles"), help=only)
    verb.add_argument("--share", type=share, metavar="K/N", help="of the tiles in view, with --only tiles (all)")
    verb.add_argument("--job-stores", **JOB_STORES)

    verb = _add_verb(
        subparsers, "render", "render frames of a scene, each refined or not rendered", farm_verbs.run_render
    )
    verb.add_argument("--scene", **scene)
    verb.add_argument("--frames", type=frames, required=True, metavar=FRAMES)
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")
    verb.add_argument("--job-stores", **JOB_STORES)

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
