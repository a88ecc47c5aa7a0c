# SPDX-License-Identifier: GPL-3.0-or-later
"""Render Map: the picture of the map camera, whole or in tiles, with files that give its position on Earth.

Blender renders on another thread, beside the window, if its operator is invoked in one. Esc ends such a render, and
Python cannot.
With *Lock Interface* no other event arrives until the picture is complete, while the status bar shows the progress.
"""

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.exporting.pictures import WORLD_FILES, write_geotiffs, write_world_file
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.partial_files import private_folder
from .. import jobs
from ..bridge.camera import render_resolution
from ..bridge.scene_paths import absolute_path, propose_file
from ..importing.imported import imported_of
from ..job_operator import FileJobOperator
from ..session import session, stale_renders
from ..text.translations import phrase
from .exporting import named_failures
from .file_outputs import escape_braces
from .map_camera import EXTENT, extent_of, is_unchanged

FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".tif": "TIFF", ".tiff": "TIFF"}


def render_map(scene, path: Path, tiles: tuple[int, int] = (1, 1), with_geotiff: bool = True) -> list[Path]:
    """Render the map of the scene's camera before returning; return the files, the first picture first.

    tiles: pictures across and down. with_geotiff: whether each becomes a GeoTIFF, too. Raises TerrainError.
    """
    steps = map_steps(scene, path, tiles, with_geotiff)
    try:
        while True:
            next(steps)
    except StopIteration as end:
        return end.value


def map_steps(
    scene,
    path: Path,
    tiles: tuple[int, int] = (1, 1),
    with_geotiff: bool = True,
    job: jobs.BackgroundJob | None = None,
) -> Generator[None, None, list[Path]]:
    """Render the map of the scene's camera in `tiles` across and down; return the files, the first picture first.

    Raises TerrainError, and JobStopped if `job` was cancelled; complete pictures stay.

    Each picture gets a world file and, with `with_geotiff`, becomes a GeoTIFF, too. All tiles show the mesh of the
    whole map, so they fit together.

    tiles: number of pictures across and down; several have column and row, from the top left, in their names. job:
    shows the progress, and renders beside the window; without it nothing is yielded before a picture is complete.
    """
    extent, size = extent_of(scene.camera), render_resolution(scene)
    form = FORMATS.get(path.suffix.lower())
    if form is None:
        raise TerrainError(f"{path} is of no format for maps", expected=", ".join(FORMATS))
    if not all(1 <= count <= side for count, side in zip(tiles, size, strict=True)):
        raise TerrainError(f"{tiles[0]} x {tiles[1]} tiles of {size[0]} x {size[1]} pixels", expected="fewer tiles")
    written, geotiffs, total = [], [], tiles[0] * tiles[1]
    for number, (row, column) in enumerate(np.ndindex(tiles[1], tiles[0])):
        stopping.check()
        if not is_unchanged(scene) or render_resolution(scene) != size:
            raise TerrainError("The map's camera or the picture's aspect was changed", fix="use Map Camera again")
        x = [size[0] * k // tiles[0] for k in (column, column + 1)]  # first pixel, and the one after the last
        y = [size[1] * k // tiles[1] for k in (row, row + 1)]
        name = path.name if tiles == (1, 1) else f"{path.stem}_x{column}_y{row}{path.suffix}"
        picture = path.with_name(name)
        geotiff = picture if form == "TIFF" else picture.with_suffix(".tif")
        _check_keeps_sources(scene, {picture, geotiff} if with_geotiff else {picture})
        if job is not None:
            job.progress(number / total, phrase("Picture {} of {}; Esc: cancel", number + 1, total))
        transform = extent.transform(size, x[0], y[0])
        with named_failures(picture):
            yield from _render_part(scene, picture, size, x, y, job)
            written += [picture, write_world_file(picture, transform)]
        geotiffs.append((picture, geotiff, transform))
    if with_geotiff:
        write = partial(write_geotiffs, geotiffs, extent.crs)
        if job is None:
            write()
        else:
            job.progress(1.0, phrase("Writing GeoTIFF files"))
            yield from jobs.run_on_thread(job, write)
        written += [file for picture, file, _ in geotiffs if file != picture]
    return written


def _check_keeps_sources(scene, files: set[Path]) -> None:
    """Raise TerrainError if one of the files to write is a height map of a terrain, chosen now or imported before."""
    for settings in (obj.adaptive_terrain for obj in session.terrains_of(scene)):
        imported = imported_of(settings)
        sources = [settings.source_path, *(item.path for item in settings.more_sources)]
        sources.append(imported.settings.get("source", "") if imported else "")
        for source in (Path(absolute_path(name)) for name in sources if name):
            if any(os.path.exists(file) and os.path.exists(source) and file.samefile(source) for file in files):
                raise TerrainError(f"The map would replace the height map {source}", fix="choose another name")


def _render_part(scene, picture: Path, size: tuple[int, int], x: list[int], y: list[int], job) -> Iterator[None]:
    """Render the columns x[0] .. x[1] - 1 and rows y[0] .. y[1] - 1, from the top, into a file. Raises TerrainError.

    size: pixels of the whole frame. job: yield while Blender renders beside the window; None to render before
    returning.
    """
    render, (width, height) = scene.render, size
    values = {"use_border": True, "use_crop_to_border": True}
    # Blender truncates float32 fractions to pixels: a quarter of a pixel keeps them on the right side.
    values |= {"border_min_x": (x[0] + 0.25) / width, "border_max_x": (x[1] + 0.25) / width}
    values |= {"border_min_y": (height - y[1] + 0.25) / height, "border_max_y": (height - y[0] + 0.25) / height}
    with private_folder(picture.parent) as folder:
        values |= {"filepath": escape_braces(folder / picture.name), "use_file_extension": False}
        with _temporarily_set(render.image_settings, _image_settings(picture)), stale_renders.raise_for_stale_frames():
            if job is None:
                with _temporarily_set(render, values):
                    _start_render(scene)
            else:
                yield from _render_beside_window(scene, values, job)
        if not (folder / picture.name).is_file():
            raise TerrainError(f"Blender wrote no picture into {picture.parent}", fix="check the disk")
        os.replace(folder / picture.name, picture)
    if job is None:
        yield  # once a picture, so that a caller can stop between two


def _start_render(scene, *how: str) -> None:
    """Call Blender's operator that renders a scene. how: "INVOKE_DEFAULT" or nothing. Raises TerrainError."""
    try:
        bpy.ops.render.render(*how, write_still=True, scene=scene.name)
    except RuntimeError as error:
        raise TerrainError(f"Blender cannot render the map ({str(error).strip()})") from None


def _render_beside_window(scene, values: dict, job: jobs.BackgroundJob) -> Iterator[None]:
    """Yield while Blender renders a part of the frame on its own thread. Raises JobStopped if that was cancelled.

    A render that is already running ends first. `values` of the render settings are in effect only until Blender has
    copied them, so that a file that is saved meanwhile does not get them.
    """
    seen: set[str] = set()
    watched = {name: lambda *_, name=name: seen.add(name) for name in ("render_pre", "render_cancel")}
    while jobs.is_rendering():
        yield
        job.raise_if_stopped()
    for name, note in watched.items():
        getattr(bpy.app.handlers, name).append(note)
    try:
        with _temporarily_set(scene.render, values):
            with _temporarily_set(bpy.context.preferences.view, {"render_display_type": "NONE"}):
                _start_render(scene, "INVOKE_DEFAULT")
            while jobs.is_rendering() and "render_pre" not in seen:
                yield
        while jobs.is_rendering():
            yield
    finally:
        for name, note in watched.items():
            getattr(bpy.app.handlers, name).remove(note)
    if "render_cancel" in seen:
        job.stop()
    job.raise_if_stopped()


def _image_settings(picture: Path) -> dict:
    """Return the values of Blender's image settings for the format of a file."""
    form = {"file_format": FORMATS[picture.suffix.lower()]}
    return form if bpy.app.version < (5, 0) else {"media_type": "IMAGE"} | form


@contextmanager
def _temporarily_set(owner, values: dict):
    """Set properties of `owner` for the `with` block."""
    before = {name: getattr(owner, name) for name in values}
    try:
        for name, value in values.items():
            setattr(owner, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(owner, name, value)


class RenderMap(FileJobOperator, bpy.types.Operator):
    """Render the picture of the map camera, whole or in tiles, with files that give map programs its place on Earth"""

    bl_idname = "adaptive_terrain.render_map"
    bl_label = "Render Map"

    kind = jobs.MAP
    filename_ext = ".png"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{s}" for s in WORLD_FILES), options={"HIDDEN"})
    tiles: bpy.props.IntVectorProperty(
        name="Tiles",
        description="Number of pictures across and down: use several for a map that is too large for one render",
        size=2,
        default=(1, 1),
        min=1,
    )
    geotiff: bpy.props.BoolProperty(
        name="GeoTIFF",
        description="Also write each picture as a GeoTIFF, which contains its place on Earth",
        default=True,
    )

    @classmethod
    def poll(cls, context):
        """Return whether the scene's camera is a map camera and no map is being rendered; otherwise set the reason."""
        cls.poll_message_set("The scene's camera is no map camera: use Map Camera first")
        if context.scene.camera is None or EXTENT not in context.scene.camera:
            return False
        cls.poll_message_set("A map is rendered already: wait for it, or cancel it beside its progress bar")
        return jobs.find(jobs.MAP) is None

    def propose(self, context) -> None:
        """Propose a file with the name of the terrain that the panels show."""
        if (terrain := session.shown_terrain(context)) is not None:
            propose_file(self, terrain, "_map")

    def subject(self, _context) -> None:
        """Return None: a map is a job of the scene, not of one terrain."""

    def stops_on_escape(self) -> bool:
        """Return True: Escape ends Blender's renders, too."""
        return True

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Render the map into the chosen file, or into tiles with its name; return the files."""
        path, shown_by = Path(self.filepath), job if self.beside_window else None
        try:
            return (yield from map_steps(context.scene, path, tuple(self.tiles), self.geotiff, job=shown_by))
        except ReferenceError:  # undo has replaced the scene, or it is gone
            raise jobs.JobStopped from None

    def finish(self, _context, _obj, files: list[Path]) -> None:
        """Report the written files."""
        self.report({"INFO"}, f"Written: {files[0].name} and {len(files) - 1} more")
