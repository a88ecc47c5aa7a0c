# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames to pictures, as `blender -f` renders them.

Each is whole under its final name or missing, and a summary closes it as it closes the frame of an export.
"""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.owned_files import NotOursError
from ...cbt_terrain.run.partial_files import private_folder
from ..land.request import land_of
from ..session import session, stale_renders
from ..session.pauses import handlers_paused
from ..session.record import Record
from ..terrain.request import RENDER
from .exporting import check_disk_space, check_target, write_frames
from .file_outputs import escape_braces, publish_outputs, redirected_outputs
from .frame_sources import SceneFrames, bounds_of, loading_note
from .summaries import file_sizes

# Blender does not report that a disk was too full for a picture. So a file of this size is tried afterwards: more than
# the buffer that is written last, and as large as a network folder's block.
SPACE_BYTES = 1 << 20


def render_frames(
    source: SceneFrames,
    frames: Sequence[int],
    out: Path,
    *,
    resume: bool = False,
    on_frame: Callable[[int, dict, bool], None] = lambda frame, summary, skipped: None,
) -> None:
    """Render every frame of the open scene into `out`: `frame_FRAME` with the suffix of the scene's format.

    resume: skip frames that are complete. on_frame: called with the frame, its summary and whether it was skipped.
    Raises TerrainError if a frame would show a stale mesh, or the scene's format is a movie.
    """
    render = source.scene.render
    if render.is_movie_format:
        raise TerrainError(
            f"The scene {source.scene.name!r} is rendered into a movie ({render.image_settings.file_format})",
            expected="a picture a frame",
            fix="choose an image format under Output",
        )
    settings = source.settings | {"picture": [bpy.app.version_string, render.engine]}
    write = partial(_render_frame, source, out)
    write_frames(write, settings, source.inputs, frames, out, resume=resume, on_frame=on_frame)


def _render_frame(source: SceneFrames, out: Path, frame: int) -> dict:
    """Render one frame: a picture for each of its views, and those of the compositor's File Output nodes.

    Returns the sizes in bytes of its files, the terrains' figures and the time. Pictures get their final names only
    when all are complete. The scene stays at the frame, with another output path. Raises TerrainError.
    """
    start = time.perf_counter()
    scene = source.scene
    terrains: list[dict] = []  # filled by `_collect_figures` while Blender renders
    with handlers_paused():  # the render sets it again, and then updates each terrain once
        scene.frame_set(frame)
    _check_land(source.objects, frame)  # before the render, which may take long: no file of a user is in the way
    with private_folder(out) as folder:
        picture_folder, output_folder = folder / "pictures", folder / "outputs"
        scene.render.filepath = escape_braces(picture_folder / f"frame_{frame:04d}")
        scene.render.use_file_extension = True
        with (
            _collect_figures(terrains, source.objects),
            redirected_outputs(scene, output_folder),
            stale_renders.raise_for_stale_frames(),  # ends the render at a terrain that cannot be refined
        ):
            try:
                bpy.ops.render.render(write_still=True)
            except RuntimeError as error:
                raise TerrainError(
                    f"Blender cannot render frame {frame} ({str(error).strip()})",
                    fix="render this frame in Blender, which reports more",
                ) from None
        stopping.check()
        pictures = sorted(picture_folder.iterdir()) if picture_folder.is_dir() else []
        if pictures:
            check_disk_space(out / pictures[0].name, SPACE_BYTES)
        for picture in pictures:
            check_target(out / picture.name)
        files = publish_outputs(scene, output_folder)
        for picture in pictures:
            os.replace(picture, out / picture.name)
    if not pictures:
        raise TerrainError(
            f"Blender wrote no picture of frame {frame} into {out}", fix="check the disk and Blender's messages"
        )
    sizes = file_sizes([*(out / picture.name for picture in pictures), *files], out)
    return {"files": sizes, "terrains": terrains, "elapsed_ms": round((time.perf_counter() - start) * 1e3, 3)}


def _check_land(objects: list, frame: int) -> None:
    """Raise TerrainError if a symbolic link or a user's file has the name of a file of a terrain's land.

    `land_of` checks the names; it shapes nothing. Other errors are left to the render.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for obj in objects:
        try:
            if not obj.hide_render:
                land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
        except NotOursError as error:
            raise stale_renders.stale_frame_error(frame, [error]) from None
        except TerrainError:
            pass  # the render finds it too, if it needs the land


@contextmanager
def _collect_figures(terrains: list[dict], objects: list):
    """Put the figures of the rendered meshes into `terrains` while the `with` block renders.

    A handler does it after the render, before the viewport restores its own detail.
    """

    def note(_scene, _unused=None) -> None:
        """Note the figures of all terrains that the render has updated; a handler of Blender."""
        shown = {obj.name: session.record_of(obj) for obj in objects}
        terrains[:] = [_figures(name, record) for name, record in shown.items() if record.status.mode == RENDER]

    bpy.app.handlers.render_post.append(note)
    try:
        yield
    finally:
        bpy.app.handlers.render_post.remove(note)


def _figures(name: str, record: Record) -> dict:
    """Return the figures of the terrain that was rendered, with the keys of `exporting.figures`."""
    status = record.status
    ms = {step: round(ms, 3) for step, ms in status.ms.items()}
    figures = {"name": name, "triangles": status.triangles_left, **bounds_of(status.bounds), "ms": ms}
    return figures | loading_note(record.field)
