# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `adaptive-terrain VERB`, and the same as `blender --command adaptive_terrain VERB`.

Exit codes: 0 done, 1 failed (one line on stderr says why), 2 wrong usage. bpy is imported only by what needs it;
the engine, whose import takes a moment, only where an interruption is told in one line.
"""

import argparse
import os
import sys
import time
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from .argument_types import MAX_INT, argument, count, pair, path, positive
from .console import Progress, duration

PROGRAM = "adaptive-terrain"
DEFAULT_RESOLUTION = (1920, 1080)
MAX_PIXELS = 65_536  # a side, as in Blender
MAX_ERROR_PX, MAX_ERROR_M = 1e6, 1e9


class UsageError(Exception):
    """Arguments that contradict each other."""


def main(argv: list[str] | None = None) -> int:
    """Run one command; `argv` without the program's name (None: the process's own). Returns the exit code."""
    try:
        arguments = build_parser().parse_args(argv)
        arguments.run(arguments)
    except SystemExit as exit_:  # argparse has printed its message
        return exit_.code or 0
    except UsageError as error:
        print(f"{PROGRAM} {arguments.verb}: {error}", file=sys.stderr)
        return 2
    except (TerrainError, OSError) as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{PROGRAM}: stopped", file=sys.stderr)
        return 1
    return 0


def build_parser() -> argparse.ArgumentParser:
    from ..cbt_terrain.heightfield import INTERPOLATIONS
    from ..cbt_terrain.island import DEFAULT_SEED, DEFAULT_SIZE
    from ..cbt_terrain.sources import RAW_TYPES
    from .exporting import FORMATS, parse_formats, parse_frames

    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="A terrain of any size at exactly the detail that the camera can see."
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)

    verb = _verb(verbs, "import", "turn a height map into a store", run_import)
    verb.add_argument("source", help="height map (GeoTIFF, VRT, .asc, .hgt, PNG, EXR, RAW, .npy), or `island`")
    verb.add_argument("--store", type=path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument(
        "--extent",
        type=pair("x", float, float("inf")),
        metavar="XxY",
        help="metres east and north, instead of the file's",
    )
    verb.add_argument("--height-scale", type=float, default=1.0, metavar="F", help="metres per unit of the file (1)")
    verb.add_argument("--height-offset", type=float, default=0.0, metavar="METRES", help="added to every height (0)")
    verb.add_argument("--no-data", type=float, metavar="VALUE", help="value that means no data, instead of the file's")
    verb.add_argument("--band", type=int, default=1, metavar="N", help="band of a file with several, from 1 (1)")
    verb.add_argument("--channel", default="", metavar="NAME", help="channel of an EXR file (the first that fits)")
    verb.add_argument("--first-row-south", action="store_true", help="for files that do not say where north is")
    verb.add_argument(
        "--raw-size", type=pair("x", int, MAX_INT), metavar="WxH", help="samples of a RAW file (a square)"
    )
    verb.add_argument("--raw-type", choices=RAW_TYPES, default="uint16", help="samples of a RAW file (uint16)")
    verb.add_argument("--big-endian", action="store_true", help="byte order of a RAW file; little endian otherwise")
    verb.add_argument(
        "--size", type=int, default=DEFAULT_SIZE, metavar="N", help=f"island: samples a side ({DEFAULT_SIZE})"
    )
    verb.add_argument("--seed", type=int, default=DEFAULT_SEED, metavar="N", help=f"island: its shape ({DEFAULT_SEED})")

    verb = _verb(verbs, "info", "say what a store, a height map or an exported .npz holds", run_info)
    verb.add_argument("path", type=path)

    verb = _verb(verbs, "bake", "write one static mesh with a given largest vertical error", run_bake)
    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    metres = positive(MAX_ERROR_M)
    verb.add_argument("--max-error", type=metres, required=True, metavar="METRES", help="largest vertical error")
    verb.add_argument("--out", type=path, required=True, metavar="FILE", help=f"format by suffix: {', '.join(FORMATS)}")
    verb.add_argument("--budget", type=count, metavar="N", help="triangles at most; the error reached is reported")
    between = {"choices": INTERPOLATIONS, "help": "of the surface between samples"}
    verb.add_argument("--interpolation", default=INTERPOLATIONS[0], **between)
    verb.add_argument("--fit", action="store_true", help="move vertices off the surface: fewer triangles, same error")

    verb = _verb(verbs, "export", "write the terrain's mesh for each frame", run_export)
    source = verb.add_mutually_exclusive_group(required=True)
    source.add_argument("--scene", type=path, metavar="X.blend", help="the terrains and the camera of a .blend file")
    source.add_argument("--store", type=path, metavar="DIR", help="a store, seen along --path; npz needs no Blender")
    verb.add_argument("--frames", type=argument(parse_frames), required=True, metavar="A-B[:S]")
    verb.add_argument("--format", type=argument(parse_formats), required=True, metavar="F,F", help=", ".join(FORMATS))
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    verb.add_argument("--camera", metavar="NAME", help="a camera of the scene, instead of its active one")
    verb.add_argument("--path", type=path, metavar="FILE.json", help="camera path for --store (docs/manual.md)")
    size = pair("x", int, MAX_PIXELS)
    verb.add_argument("--resolution", type=size, metavar="WxH", help="pixels (the scene's, or 1920x1080)")
    pixels = positive(MAX_ERROR_PX)
    verb.add_argument("--pixel-error", type=pixels, metavar="PX", help="screen error (the scene's, or 1)")
    verb.add_argument("--budget", type=count, metavar="N", help="triangles at most")
    verb.add_argument("--meshlet", type=int, choices=range(5), metavar="M", help="4^M triangles a leaf, 0 to 4")
    verb.add_argument("--interpolation", **between)
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")

    verb = _verb(verbs, "accuracy", "measure errors, and what they cost in time and triangles", run_accuracy)
    source = verb.add_mutually_exclusive_group(required=True)
    source.add_argument("--scene", type=path, metavar="X.blend", help="the terrains and the camera of a .blend file")
    source.add_argument("--store", type=path, metavar="DIR", help="a store, seen along --path, or as a whole")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the page, plots, CSV and JSON")
    verb.add_argument("--camera", metavar="NAME", help="a camera of the scene, instead of its active one")
    verb.add_argument("--path", type=path, metavar="FILE.json", help="camera path for --store (docs/manual.md)")
    verb.add_argument("--frames", type=argument(parse_frames), metavar="A-B[:S]", help="of the path or the scene")
    verb.add_argument("--resolution", type=size, metavar="WxH", help="pixels (the scene's, or 1920x1080)")

    verb = _verb(verbs, "demo", "the built-in island: 24 frames, pictures and a page", run_demo)
    verb.add_argument("--out", type=path, default=Path("demo"), metavar="DIR", help="folder to write (demo)")

    verb = _verb(verbs, "bench", "what everything costs on this machine, beside two baselines", run_bench)
    verb.add_argument("--quick", action="store_true", help="fewer rows; fails if one is much slower than its goal")
    verb.add_argument("--with-cycles", action="store_true", help="also whole renders in Cycles (minutes more)")
    verb.add_argument("--json", type=path, metavar="FILE", help="write the rows as JSON")
    verb.add_argument("--docs", type=path, metavar="DIR", help="write performance.md and its plot into this folder")
    return parser


def _verb(verbs, name: str, summary: str, run) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
    verb.add_argument("--progress", action="store_true", default=None, help="show the bar even where no terminal is")
    verb.set_defaults(run=run)
    return verb


def run_import(arguments) -> None:
    from ..cbt_terrain.importing import ImportSettings, import_source

    settings = ImportSettings(
        source=arguments.source,
        raw_size=arguments.raw_size,
        raw_dtype=arguments.raw_type,
        raw_little_endian=not arguments.big_endian,
        extent=arguments.extent,
        height_scale=arguments.height_scale,
        height_offset=arguments.height_offset,
        no_data=arguments.no_data,
        band=arguments.band,
        channel=arguments.channel,
        first_row_south=arguments.first_row_south,
        size=arguments.size,
        seed=arguments.seed,
    )
    start = time.monotonic()
    bar = Progress(1.0, "import", arguments.progress)
    try:
        report = import_source(settings, arguments.store, on_progress=lambda fraction, message: bar.to(fraction))
    finally:
        bar.close()
    print_fields(report)
    print(f"{arguments.store} is ready after {duration(time.monotonic() - start)}")


def run_info(arguments) -> None:
    if arguments.path.suffix == ".npz":
        from ..cbt_terrain.archive import read_npz

        print_fields(read_npz(arguments.path)["info"])
        return
    from ..cbt_terrain.importing import describe

    print_fields(describe(arguments.path) if os.path.isdir(arguments.path) else describe_source(arguments.path))


def describe_source(path: Path) -> dict:
    """What a height map's header says."""
    from ..cbt_terrain.sources import ImportSettings, open_source

    bpy = sys.modules.get("bpy")
    if path.suffix.lower() == ".exr" and bpy is not None and bpy.app.binary_path:
        # The OpenEXR package clashes with the one inside the Blender program; an import has a process of its own.
        raise TerrainError(f"{path} is an EXR file, which is not opened inside Blender; import it first.")
    raster = open_source(ImportSettings(source=str(path)))
    try:
        place = raster.georeference
        fields = {"path": str(path), "format": raster.format, "stored": raster.stored}
        fields["raster"] = [raster.width, raster.height]
        if place is not None:
            fields |= {"step_m": [place.step_x, place.step_y], "middle": list(place.middle), "crs": place.crs}
        return fields | {"warnings": [*raster.warnings, *(place.warnings if place else ())]}
    finally:
        raster.close()


def run_bake(arguments) -> None:
    from .exporting import FORMATS, check_target, figures, needs_blender, write_piece
    from .frame_sources import baked_piece

    form = arguments.out.suffix[1:].lower()
    if form not in FORMATS:
        raise UsageError(f"--out {arguments.out} has no known format; expected one of {', '.join(FORMATS)}")
    check_target(arguments.out)
    bar = Progress(1.0, "bake", arguments.progress)
    try:
        piece = baked_piece(
            arguments.store,
            arguments.max_error,
            arguments.budget,
            needs_blender([form]),
            arguments.interpolation,
            arguments.fit,
            bar.to,
        )
    finally:
        bar.close()
    write_piece(piece, arguments.out)
    print(summary_line(arguments.out.name, [figures(piece)]))
    if arguments.fit and not piece.update.rounds:
        print("the fit saved no triangles: this is the mesh without it")


def run_export(arguments) -> None:
    from .exporting import export_frames

    source = _export_source(arguments)
    bar = Progress(len(arguments.frames), "export", arguments.progress)
    counter = iter(range(1, len(arguments.frames) + 1))

    def on_frame(frame: int, summary: dict, skipped: bool) -> None:
        line = summary_line(f"frame {frame}", summary["terrains"], summary["elapsed_ms"])
        bar.to(next(counter), worked=not skipped)
        bar.say(f"{line}, complete before" if skipped else line)

    try:
        export_frames(
            source, arguments.frames, arguments.format, arguments.out, resume=arguments.resume, on_frame=on_frame
        )
    finally:
        bar.close()


def _export_source(arguments):
    from ..cbt_terrain.criterion import Criterion
    from ..cbt_terrain.heightfield import INTERPOLATIONS
    from .exporting import needs_blender
    from .frame_sources import SceneFrames, StoreFrames

    _check_source(arguments)
    if arguments.scene:
        return SceneFrames(
            arguments.scene,
            arguments.camera,
            arguments.resolution,
            arguments.pixel_error,
            arguments.budget,
            arguments.meshlet,
            arguments.interpolation,
        )
    if not arguments.path:
        raise UsageError("--store needs --path FILE.json, the camera's keyframes (docs/manual.md has the format)")
    criterion = Criterion(
        error_px=1.0 if arguments.pixel_error is None else arguments.pixel_error,
        max_triangles=arguments.budget,
        meshlet=arguments.meshlet or 0,
    )
    resolution = arguments.resolution or DEFAULT_RESOLUTION
    interpolation = arguments.interpolation or INTERPOLATIONS[0]
    in_blender = needs_blender(arguments.format)
    return StoreFrames(arguments.store, arguments.path, criterion, resolution, in_blender, interpolation)


def run_accuracy(arguments) -> None:
    from . import accuracy_command, accuracy_subject

    _check_source(arguments)
    if arguments.scene:
        subjects = accuracy_subject.scene_subjects(
            arguments.scene, arguments.camera, arguments.frames, arguments.resolution
        )
    else:
        if arguments.frames and not arguments.path:
            raise UsageError("--frames are those of a --path FILE.json, or of a scene")
        resolution = arguments.resolution or DEFAULT_RESOLUTION
        subjects = [accuracy_subject.store_subject(arguments.store, arguments.path, arguments.frames, resolution)]
    accuracy_command.run(subjects, arguments.out, arguments.progress)


def _check_source(arguments) -> None:
    """A scene has cameras, a store a camera path."""
    if arguments.scene and arguments.path:
        raise UsageError("--path belongs to --store; a scene has cameras of its own (--camera NAME)")
    if arguments.store and arguments.camera:
        raise UsageError("--camera belongs to --scene; a store is seen along --path FILE.json")


def run_demo(arguments) -> None:
    from .demo import run

    run(arguments.out, arguments.progress)


def run_bench(arguments) -> None:
    if arguments.quick and (arguments.docs or arguments.with_cycles):
        raise UsageError("--quick leaves rows out; --docs and --with-cycles belong to a whole run")
    try:
        from ..benchmarks import suite
    except ModuleNotFoundError as error:
        if not error.name.endswith("benchmarks"):
            raise
        raise TerrainError(
            "The benchmarks are not part of the extension; install the Python package adaptive-terrain for them."
        ) from None
    suite.run(arguments.quick, arguments.with_cycles, arguments.json, arguments.docs)


def summary_line(what: str, terrains: list[dict], elapsed_ms: float | None = None) -> str:
    """`frame 12: 184,302 triangles, bound 0.98 px, update 31 ms`; of several terrains the sum, the largest bound."""
    from .shown_bounds import limit_text

    parts = [f"{sum(t['triangles'] for t in terrains):,} triangles", f"bound {_largest_bound(terrains)}"]
    if empty := [t["name"] for t in terrains if not t["triangles"]]:
        parts.append(f"the clean-up leaves nothing of {' and '.join(empty)}")
    if limited := sorted({t["limited"] for t in terrains if t["limited"]}):
        parts.append(f"held back by {limit_text(', '.join(limited))}")
    parts.append(f"update {sum(t['ms'].get('total', 0.0) for t in terrains):.0f} ms")
    if elapsed_ms is not None:
        parts.append(f"{elapsed_ms:.0f} ms in all")
    return f"{what}: {', '.join(parts)}"


def _largest_bound(terrains: list[dict]) -> str:
    """With its unit: pixels where a camera was looked through, else metres."""
    from .shown_bounds import bound_text

    pixels = [t["bound_px"] for t in terrains if t["bound_px"] is not None]
    return bound_text(max(pixels), "px") if pixels else bound_text(max(t["bound_m"] for t in terrains), "m")


def print_fields(fields: dict, indent: str = "") -> None:
    """One line a field, a dict below its own name; what is empty is left out."""
    for name, value in fields.items():
        if isinstance(value, dict):
            print(f"{indent}{name}:")
            print_fields(value, indent + "  ")
        elif name == "warnings":
            for warning in value:
                print(f"{indent}warning: {warning}")
        elif isinstance(value, list | tuple):
            print(f"{indent}{name}: {', '.join(str(part) for part in value)}")
        elif value != "" and value is not None:
            print(f"{indent}{name}: {value}")


if __name__ == "__main__":
    sys.exit(main())
