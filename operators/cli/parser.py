# SPDX-License-Identifier: GPL-3.0-or-later
"""The parser of the command line: verbs, their options and the functions that carry them out."""

import argparse
import functools
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn

from ..text.console import BAR, OPENJD, print_json
from . import farm_options, farm_verbs, import_options, import_verbs, tile_verbs, verbs
from .argument_types import (
    MAX_ERROR_M,
    add_settings,
    argparse_type,
    count,
    pair,
    parse_effects,
    path,
    positive,
)
from .farm_options import FRAMES, JOB_STORES

PROGRAM = "adaptive-terrain"
MAX_PIXELS = 65_536  # a side, as in Blender
MAX_ERROR_PX, MAX_DISPLACEMENT_M = 1e6, 1e6
MAX_BUDGET_MB = 1e9
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
CAMERA = {"metavar": "NAME", "help": "a camera of the scene, instead of its active one"}


class Verb(NamedTuple):
    """A verb of the command line.

    `summary`: its help. `run`: function that carries it out, called with the parsed arguments. `add_options`: function
    that adds its options to its parser, and imports what they need.
    """

    summary: str
    run: Callable[[argparse.Namespace], None]
    add_options: Callable[[argparse.ArgumentParser], None]


def _verbs() -> dict[str, Verb]:
    """Return all verbs by name: of each its help, the function that runs it and the one that adds its options."""
    found = {
        "import": Verb("turn a height map into a store", import_verbs.run_import, import_options.add_import),
        "info": Verb(
            "describe a store, a height map or an exported .npz", import_verbs.run_info, import_options.add_info
        ),
        "bake": Verb("write one static mesh with a given largest vertical error", verbs.run_bake, _add_bake),
        "export": Verb("write the terrain's mesh for each frame", verbs.run_export, _add_export),
        "tiles": Verb("write height tiles and masks for game engines", tile_verbs.run_tiles, tile_verbs.add_tiles),
        "tileset": Verb(
            "write 3D Tiles with levels of detail and stated errors", tile_verbs.run_tileset, tile_verbs.add_tileset
        ),
        "map": Verb(
            "render a terrain from straight above, with its position on Earth", tile_verbs.run_map, tile_verbs.add_map
        ),
        "maps": Verb("bake effects into images, as fine as what looks at them needs", verbs.run_maps, _add_maps),
        "accuracy": Verb("measure errors, and what they cost in time and triangles", verbs.run_accuracy, _add_accuracy),
        "effects": Verb(
            "list the effects; what they take on a store, which a scene reads", verbs.run_effects, _add_effects
        ),
        "shape": Verb("apply a stack of effects on heights to a store, into another", verbs.run_shape, _add_shape),
        "submit": Verb("write a job that a render farm runs", farm_verbs.run_submit, farm_options.add_submit),
        "prepare": Verb(
            "make what all frames of a scene need, ahead of them", farm_verbs.run_prepare, farm_options.add_prepare
        ),
        "render": Verb(
            "render frames of a scene, each refined or not rendered", farm_verbs.run_render, farm_options.add_render
        ),
        "verify": Verb(
            "check that frames are there, whole and of one scene", farm_verbs.run_verify, farm_options.add_verify
        ),
        "query": Verb("heights, slopes and normals of a store at points, as CSV", verbs.run_query, _add_query),
        "demo": Verb("the built-in island: 24 frames, pictures and a page", verbs.run_demo, _add_demo),
    }
    if importlib.util.find_spec("...benchmarks", __package__):  # they are no part of the extension
        found["bench"] = Verb(
            "what everything costs on this machine, beside two baselines", verbs.run_bench, _add_bench
        )
    return found


class Parser(argparse.ArgumentParser):
    """A parser of arguments. `json_errors`: print wrong usage as one JSON object instead of the usage and a line."""

    def __init__(self, *arguments, json_errors: bool = False, **options):
        super().__init__(*arguments, **options)
        self.json_errors = json_errors

    def error(self, message: str) -> NoReturn:
        """Print wrong usage on stderr and exit with code 2."""
        if not self.json_errors:
            super().error(message)
        print_json({"what": message}, sys.stderr)
        self.exit(2)


def build_parser(chosen: str | None = None, json_errors: bool = False) -> argparse.ArgumentParser:
    """Build the parser of all verbs. Each verb sets `run`, the function that carries it out.

    `chosen`: the only verb that gets its options, since the options of all import the whole engine; None: every verb.
    `json_errors`: whether wrong usage is printed as JSON.
    """
    about = "A terrain at exactly the detail that the camera can see."
    parser = Parser(prog=PROGRAM, description=about, json_errors=json_errors)
    parser.add_argument("--json", dest="json_errors", action="store_true", help="print an error as JSON")
    verb_class = functools.partial(Parser, json_errors=json_errors)
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=verb_class)
    for name, (summary, run, add_options) in _verbs().items():
        verb = subparsers.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        verb.set_defaults(run=run)
        if chosen in (None, name):
            _add_progress(verb)
            add_options(verb)
    return parser


def _add_bake(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `bake`."""
    from ...cbt_terrain.field.heightfield import INTERPOLATIONS
    from ..export.formats import FORMATS

    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    metres = positive(MAX_ERROR_M)
    verb.add_argument("--max-error", type=metres, required=True, metavar="METRES", help="largest vertical error")
    verb.add_argument("--out", type=path, required=True, metavar="FILE", help=f"format by suffix: {', '.join(FORMATS)}")
    verb.add_argument("--budget", type=count, metavar="N", help=BUDGET_HELP + "; the error reached is reported")
    verb.add_argument("--interpolation", default=INTERPOLATIONS[0], choices=INTERPOLATIONS, help=BETWEEN)
    verb.add_argument("--displacement", "--detail", **DISPLACEMENT)
    verb.add_argument("--fit", action="store_true", help="move vertices off the surface: fewer triangles, same error")


def _add_export(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `export`."""
    from ...cbt_terrain.field.heightfield import INTERPOLATIONS
    from ..export.formats import FORMATS, parse_formats

    _add_view_options(verb, "a store, seen along --path; npz needs no Blender", frames_required=True)
    verb.add_argument(
        "--format", type=argparse_type(parse_formats), required=True, metavar="F,F", help=", ".join(FORMATS)
    )
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    add_settings(verb)
    verb.add_argument("--interpolation", choices=INTERPOLATIONS, help=BETWEEN)
    verb.add_argument("--displacement", "--detail", **DISPLACEMENT)
    verb.add_argument(
        "--effects",
        type=argparse_type(parse_effects),
        metavar="auto|none|F,F",
        help="attributes to write: those that the scene reads (auto; of a store none), none, or these",
    )
    about = "positions about a point near --path, not about the raster's middle: precise far from that"
    verb.add_argument("--anchor", action="store_true", help=about)
    verb.add_argument("--scatter", action="store_true", help="also the points of the scene's scatters, each as CSV")
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")
    verb.add_argument("--job-stores", **JOB_STORES)


def _add_maps(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `maps`."""
    from ...cbt_terrain.attributes.coding import FORMS as MAP_FORMS

    _add_view_options(verb, "a store, seen along --path, or as a whole")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the images and maps.json")
    verb.add_argument(
        "--maps", metavar="NAME,NAME", help=f"names (those of the scene's settings, or {verbs.DEFAULT_MAP})"
    )
    verb.add_argument("--budget", type=positive(MAX_BUDGET_MB), metavar="MB", help="of all images together, in Blender")
    verb.add_argument("--format", choices=MAP_FORMS, help="png (8 and 16 bits) or exr (floats)")


def _add_accuracy(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `accuracy`."""
    _add_view_options(verb, "a store, seen along --path, or as a whole")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the page, plots, CSV and JSON")


def _add_effects(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `effects`."""
    source = verb.add_mutually_exclusive_group()
    source.add_argument("--scene", type=path, metavar="X.blend", help="readers of each, and why others are skipped")
    source.add_argument("--store", type=path, metavar="DIR", help="time and memory of each, measured on a mesh of it")
    verb.add_argument("--camera", **CAMERA)


def _add_shape(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `shape`."""
    from ..export.formats import parse_frames

    verb.epilog = SHAPE_EXAMPLE
    verb.formatter_class = argparse.RawDescriptionHelpFormatter
    verb.add_argument("--store", type=path, required=True, metavar="DIR", help="the store to be shaped")
    verb.add_argument("--stack", type=path, required=True, metavar="FILE.json", help="the effects, in their order")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder of the store to write")
    verb.add_argument("--path", type=path, metavar="FILE.json", help="only tiles that this camera sees")
    verb.add_argument("--frames", type=argparse_type(parse_frames), metavar=FRAMES, help="of the path (all)")
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


def _add_query(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `query`."""
    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    columns = "with columns x and y: in the store's coordinate system, or metres from the terrain's middle"
    verb.add_argument("--points", type=path, required=True, metavar="FILE.csv", help=columns)
    verb.add_argument("--out", type=path, metavar="FILE.csv", help="its columns and the results (stdout)")
    verb.add_argument(
        "--profile", action="store_true", help="along the line through the points, wherever it crosses the raster's"
    )


def _add_demo(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `demo`."""
    verb.add_argument("--out", type=path, default=Path("demo"), metavar="DIR", help="folder to write (demo)")


def _add_bench(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `bench`."""
    verb.add_argument("--quick", action="store_true", help="fewer rows; fails if one is much slower than its goal")
    verb.add_argument("--with-cycles", action="store_true", help="also whole renders in Cycles (minutes more)")
    verb.add_argument("--blender", nargs="+", metavar="COMMAND", help="also frames inside the program that this starts")
    verb.add_argument("--json", type=path, metavar="FILE", help="write the rows as JSON")
    verb.add_argument("--docs", type=path, metavar="DIR", help="write performance.md and its chart into this folder")


def _add_progress(verb: argparse.ArgumentParser) -> None:
    """Add the option --progress."""
    how = {"nargs": "?", "choices": (BAR, OPENJD), "const": BAR}
    verb.add_argument(
        "--progress",
        **how,
        help="show the bar even where no terminal is, or tell a farm that runs Open Job Description",
    )


def _add_view_options(verb: argparse.ArgumentParser, store: str, frames_required: bool = False) -> None:
    """Add the options for a scene or a store and for the views of it.

    `store`: help of --store. `frames_required`: whether --frames must be given.
    """
    from ..export.formats import parse_frames

    source = verb.add_mutually_exclusive_group(required=True)
    source.add_argument("--scene", type=path, metavar="X.blend", help="the terrains and the camera of a .blend file")
    source.add_argument("--store", type=path, metavar="DIR", help=store)
    frames = {"type": argparse_type(parse_frames), "metavar": FRAMES, "help": "of the path or the scene"}
    verb.add_argument("--frames", required=frames_required, **frames)
    verb.add_argument("--camera", **CAMERA)
    camera_path = "camera path for --store (docs/reference/camera-path.md)"
    verb.add_argument("--path", type=path, metavar="FILE.json", help=camera_path)
    verb.add_argument("--resolution", type=SIZE, metavar="WxH", help="pixels (the scene's, or 1920x1080)")
