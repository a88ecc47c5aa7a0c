# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs that a render farm calls, and the one that writes its job."""

import sys
from pathlib import Path

from ..text.console import Progress, print_line
from .verbs import UsageError, frame_reporter, largest_bound


def run_prepare(arguments) -> None:
    """Run the verb `prepare`: import stores, shape land and bake maps that all frames need, before the farm's tasks.

    `--only` names one part of this work, such as "load" for the tiles in view; `--share 2/5` does the second fifth of
    its tiles. Raises UsageError.
    """
    from ..blender import need_bpy

    need_bpy("A .blend file")
    from ..export.blend_files import open_scene
    from ..export.preparing import DEFAULT_PARTS, IMPORT_PARTS, SHARED_PARTS, prepare
    from ..session.shot import frames_of

    if arguments.share and arguments.only not in SHARED_PARTS:
        raise UsageError(f"--share belongs to --only {' and --only '.join(SHARED_PARTS)}")
    if arguments.only in ("load", *IMPORT_PARTS) and arguments.job_stores is None:
        raise UsageError(f"--only {arguments.only} needs --job-stores")
    scene, objects = open_scene(arguments.scene)
    parts = [arguments.only] if arguments.only else DEFAULT_PARTS
    where = {"stores": arguments.job_stores, "share": arguments.share or (1, 1)}  # 1/1: all tiles
    with Progress(len(parts) * len(objects), "prepare", arguments.progress) as bar:
        prepare(objects, arguments.frames or frames_of(scene), parts, bar.say, bar.to, **where)


def run_render(arguments) -> None:
    """Run the verb `render`: render frames of a scene, and warn about File Output nodes that write elsewhere."""
    from ..blender import need_bpy

    need_bpy("A .blend file")
    from ..export.file_outputs import folders_outside
    from ..export.frame_sources import SceneFrames
    from ..export.rendering import render_frames

    source = SceneFrames(arguments.scene, camera=None, resolution=None, stores=arguments.job_stores)
    for folder in folders_outside(source.scene, Path(arguments.scene).parent, arguments.out):
        print_line(f"note: a File Output node writes outside the scene's folder, to {folder}", file=sys.stderr)
    with frame_reporter(arguments, "render") as on_frame:
        render_frames(source, arguments.frames, arguments.out, resume=arguments.resume, on_frame=on_frame)


def run_verify(arguments) -> None:
    """Run the verb `verify`: check the frames of a job, and print their number and largest bound.

    Raises TerrainError if one is missing, damaged, stale or of another scene than the others.
    """
    from ..export.verifying import verify_frames

    summaries, missing = verify_frames(arguments.folder, arguments.frames)
    terrains = [terrain for summary in summaries for terrain in summary["terrains"]]
    line = f"{len(summaries):,} frames are whole, {sum(t['triangles'] for t in terrains):,} triangles"
    with Progress(1.0, "verify", arguments.progress) as bar:
        bar.say(f"{line}, largest bound {largest_bound(terrains)}")
        if missing:
            bar.say(f"{missing:,} of the files that they were made of are not here and were not compared")
        bar.to(1.0)


def run_submit(arguments) -> None:
    """Run the verb `submit`: write a farm job for a scene, and print its files and notes."""
    from ..blender import need_bpy

    need_bpy("A .blend file")
    from ..export.blend_files import open_scene
    from ..farm.submit import submit

    scene, objects = open_scene(arguments.scene)
    lines, notes = submit(
        scene,
        objects,
        arguments.out,
        frames=arguments.frames,
        chunk=arguments.chunk,
        formats=() if arguments.render else arguments.format,
        extension=arguments.extension,
        min_memory_gib=arguments.min_memory,
        allow_outside=arguments.allow_outside,
        shared_disk=arguments.shared_disk,
    )
    for line in [*lines, *(f"note: {note}" for note in notes)]:
        print_line(line)
