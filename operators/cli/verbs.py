# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs of the command line: arguments in, work done, lines on stdout."""

import time
from contextlib import contextmanager

from ...cbt_terrain.errors import TerrainError, shown
from ..text.console import LONGEST_LINE, Progress, duration, print_line

DEFAULT_RESOLUTION = (1920, 1080)
DEFAULT_MAP = "detail_normal"


class UsageError(Exception):
    """Arguments that contradict each other."""


def run_bake(arguments) -> None:
    """Run the verb `bake`: write one static mesh of a store with a given largest vertical error."""
    from ...cbt_terrain.field.store import open_store
    from ...cbt_terrain.run.partial_files import remove_abandoned
    from ..export.exporting import check_target, figures, write_piece
    from ..export.formats import format_of
    from ..export.frame_sources import baked_piece
    from ..text.gap_note import gap_note

    try:
        form = format_of(arguments.out)
    except TerrainError as error:
        raise UsageError(f"--out: {error}") from None
    check_target(arguments.out)
    remove_abandoned(arguments.out.parent)  # partial files of killed processes
    with Progress(1.0, "bake", arguments.progress) as bar:
        piece = baked_piece(
            arguments.store,
            arguments.max_error,
            arguments.budget,
            in_blender=form.needs_blender,
            interpolation=arguments.interpolation,
            detail=_displacement(arguments),
            fitted=arguments.fit,
            on_progress=bar.to,
        )
    write_piece(piece, arguments.out)
    print_line(summary_line(arguments.out.name, [figures(piece)]) + gap_note(open_store(arguments.store)))
    if arguments.fit and not piece.update.rounds:
        print_line("the fit saved no triangles: this is the mesh without it")


def _displacement(arguments):
    """Return the Detail that --displacement describes, None without the option."""
    from ...cbt_terrain.field.detail import Detail

    amplitude, wavelength = arguments.displacement or (0.0, 0.0)
    return Detail(amplitude, wavelength) if arguments.displacement else None


def run_export(arguments) -> None:
    """Run the verb `export`: write the terrain's mesh for each frame."""
    from ..export.exporting import export_frames

    source = _export_source(arguments)
    with frame_reporter(arguments, "export") as on_frame:
        export_frames(
            source, arguments.frames, arguments.format, arguments.out, resume=arguments.resume, on_frame=on_frame
        )


@contextmanager
def frame_reporter(arguments, label: str):
    """Yield a function to call after each of `arguments.frames`, which prints a line and advances the progress bar.

    It takes the frame, its summary, and whether the frame was complete before.
    """
    counter = iter(range(1, len(arguments.frames) + 1))

    def on_frame(frame: int, summary: dict, skipped: bool) -> None:
        """Print a line about a frame and move the progress bar."""
        line = summary_line(f"frame {frame}", summary["terrains"], summary["elapsed_ms"])
        bar.say(f"{line}, complete before" if skipped else line)
        bar.to(next(counter), worked=not skipped)

    with Progress(len(arguments.frames), label, arguments.progress) as bar:
        yield on_frame


def _export_source(arguments):
    """Return the frames to export, of a scene or of a store seen along a camera path. Raises UsageError.

    --job-stores, a farm job's folder for the stores that its tasks import, and scatters are of scenes only.
    """
    from ...cbt_terrain.field.heightfield import INTERPOLATIONS
    from ...cbt_terrain.view.criterion import Criterion
    from ..blender import need_bpy
    from ..export.formats import needs_blender
    from ..export.frame_sources import SceneFrames, StoreFrames
    from ..terrain.overrides import Overrides
    from .argument_types import given_settings

    _check_source(arguments)
    settings, displacement = given_settings(arguments), _displacement(arguments)  # settings: of the criterion
    if arguments.scene:
        need_bpy("A .blend file")
        if arguments.anchor:
            raise UsageError("--anchor belongs to --store: in a scene Move World Here sets anchors")
        overrides = Overrides(
            criterion=settings,
            interpolation=arguments.interpolation,
            effects=arguments.effects,
            ground=displacement,
        )
        return SceneFrames(
            arguments.scene,
            arguments.camera,
            arguments.resolution,
            overrides,
            with_scatters=arguments.scatter,
            stores=arguments.job_stores,
        )
    if arguments.job_stores:
        raise UsageError("--job-stores belongs to --scene")
    if arguments.scatter:
        raise UsageError("--scatter belongs to --scene: a store has no scatters")
    if not arguments.path:
        raise UsageError("--store needs --path FILE.json, a camera path: see docs/reference/camera-path.md")
    return StoreFrames(
        arguments.store,
        arguments.path,
        Criterion(**settings),
        arguments.resolution or DEFAULT_RESOLUTION,
        in_blender=needs_blender(arguments.format),
        interpolation=arguments.interpolation or INTERPOLATIONS[0],
        effects=arguments.effects or (),
        detail=displacement,
        has_anchor=arguments.anchor,
    )


def run_effects(arguments) -> None:
    """Run the verb `effects`: print the readers of attributes in a scene if there is one; otherwise the declarations of
    all attributes, and their cost on a store if there is one.
    """
    from ..blender import need_bpy
    from . import effects_command

    if arguments.camera and not arguments.scene:
        raise UsageError("--camera belongs to --scene")
    if arguments.scene:
        need_bpy("A .blend file")
        for line in effects_command.list_readers(arguments.scene, arguments.camera):
            print_line(line)
        return
    print_fields(effects_command.describe_attributes())
    if arguments.store:
        for line in effects_command.list_costs(arguments.store):
            print_line(line)


def run_maps(arguments) -> None:
    """Run the verb `maps`: bake attributes of a store or a scene's terrains into images."""
    from ..blender import need_bpy
    from . import maps_command

    _check_source(arguments)
    if arguments.scene:
        need_bpy("A .blend file")
    elif arguments.frames and not arguments.path:
        raise UsageError("--frames are those of a --path FILE.json, or of a scene")
    if arguments.maps is not None and not arguments.maps.strip(", "):
        raise UsageError("--maps names no map; expected names with commas between, as --maps detail_normal,sky")
    names = arguments.maps.split(",") if arguments.maps else None
    if arguments.scene:
        look = {"camera": arguments.camera, "resolution": arguments.resolution, "frames": arguments.frames}
        subjects = maps_command.subjects_of_scene(arguments.scene, arguments.out, names, **look)
    else:
        names, size = names or [DEFAULT_MAP], arguments.resolution or DEFAULT_RESOLUTION
        subjects = maps_command.subjects_of_store(
            arguments.store, arguments.out, names, arguments.path, arguments.frames, size
        )
    maps_command.run(subjects, arguments.budget, arguments.format, arguments.progress)


def run_shape(arguments) -> None:
    """Run the verb `shape`: apply height operators to a store, and write the result as a store and as rasters."""
    from ...cbt_terrain.field.store import open_store
    from ...cbt_terrain.height_operators.export import check_export, export_raster
    from ..text.gap_note import gap_note
    from . import shape_command

    for option in () if arguments.path else ("frames", "resolution", "pixel_error"):
        if getattr(arguments, option):
            raise UsageError(f"--{option.replace('_', '-')} is of a --path FILE.json: without one every tile counts")
    if arguments.whole and arguments.path:
        raise UsageError("--whole and --path contradict each other: all tiles, or those that the camera sees")
    if arguments.export:
        check_export(arguments.export)
    start = time.monotonic()
    report = shape_command.run(
        arguments.store,
        arguments.stack,
        arguments.out,
        path=arguments.path,
        frames=arguments.frames,
        resolution=arguments.resolution or DEFAULT_RESOLUTION,
        pixel_error=arguments.pixel_error or 1.0,
        whole=arguments.whole,
        finish_early_s=arguments.finish_early,
        show_progress=arguments.progress,
    )
    levels = report.pop("levels")
    print_fields(report | {"tiles": f"{report['tiles_built']:,} built of {report['tiles_there_are']:,} there are"})
    for line in levels:
        print_line(f"level: {shown(line)}")
    for file in export_raster(arguments.out, arguments.export) if arguments.export else ():
        print_line(f"{file} is written{gap_note(open_store(arguments.out))}")
    print_line(f"{arguments.out} is ready after {duration(time.monotonic() - start)}")


def run_query(arguments) -> None:
    """Run the verb `query`: write heights, slopes and normals at points."""
    from . import query_command

    query_command.run(arguments.store, arguments.points, arguments.out, arguments.profile)


def run_accuracy(arguments) -> None:
    """Run the verb `accuracy`: measure errors and their costs, and write a report."""
    from ..accuracy import subject as accuracy_subject
    from ..blender import need_bpy
    from . import accuracy_command

    _check_source(arguments)
    if arguments.scene:
        need_bpy("A .blend file")
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
    """Raise UsageError if --path is given with a scene, or --camera with a store."""
    if arguments.scene and arguments.path:
        raise UsageError("--path belongs to --store; a scene has its own cameras (--camera NAME)")
    if arguments.store and arguments.camera:
        raise UsageError("--camera belongs to --scene; a store is seen along --path FILE.json")


def run_demo(arguments) -> None:
    """Run the verb `demo`: write pictures and a page of the built-in island."""
    from ..demo.demo import run

    run(arguments.out, arguments.progress)


def run_bench(arguments) -> None:
    """Run the verb `bench`: measure costs on this machine. Only a checkout has it, not the extension."""
    if arguments.quick and (arguments.docs or arguments.with_cycles):
        raise UsageError("--quick leaves rows out; --docs and --with-cycles belong to a whole run")
    from ...benchmarks import suite

    suite.run(
        quick=arguments.quick,
        with_cycles=arguments.with_cycles,
        blender=arguments.blender,
        json_file=arguments.json,
        docs=arguments.docs,
    )


def summary_line(what: str, terrains: list[dict], elapsed_ms: float | None = None) -> str:
    """Return a line such as `frame 12: 184,302 triangles, bound 0.98 px, update 31 ms`.

    `what`: its first words. `terrains`: figures of each terrain by name; triangles and times are added up, the largest
    bound counts. `elapsed_ms`: of all work on the frame, None to leave it out.
    """
    from ..text.shown_bounds import limit_text

    parts = [f"{sum(t['triangles'] for t in terrains):,} triangles", f"bound {largest_bound(terrains)}"]
    if empty := [t["name"] for t in terrains if not t["triangles"]]:
        parts.append(f"nothing is left of {' and '.join(empty)}")
    if limited := sorted({t["limited"] for t in terrains if t["limited"]}):
        parts.append(f"held back by {limit_text(*limited)}")
    parts += [f"{t['name']} is loaded {t['loaded']}" for t in terrains if t.get("loaded")]
    parts.append(f"update {sum(t['ms'].get('total', 0.0) for t in terrains):.0f} ms")
    if elapsed_ms is not None:
        parts.append(f"{elapsed_ms:.0f} ms in all")
    return f"{what}: {', '.join(parts)}"


def largest_bound(terrains: list[dict]) -> str:
    """Return the largest bound of the terrains with its unit: of the first kind in BOUNDS that one of them has,
    else "none".
    """
    from ...cbt_terrain.view.settings import BOUNDS
    from ..text.shown_bounds import bound_text

    for name, (_, unit) in BOUNDS.items():
        bounds = [t[name] for t in terrains if t[name] is not None]
        if bounds:
            return bound_text(max(bounds), unit)
    return "none"


def print_fields(fields: dict, indent: str = "") -> None:
    """Print a line for each field that is not None or "", and a dict as indented lines below its name.

    Control characters are escaped (`shown`), because texts may come from a file. indent: spaces before each line.
    """
    for name, value in fields.items():
        if isinstance(value, dict):
            print_line(f"{indent}{name}:")
            print_fields(value, indent + "  ")
        elif name == "warnings":
            for warning in value:
                print_line(f"{indent}warning: {shown(warning, LONGEST_LINE)}")
        elif isinstance(value, list | tuple):
            print_line(f"{indent}{shown(name)}: {shown(', '.join(map(str, value)), LONGEST_LINE)}")
        elif value != "" and value is not None:
            print_line(f"{indent}{shown(name)}: {shown(value, LONGEST_LINE)}")
