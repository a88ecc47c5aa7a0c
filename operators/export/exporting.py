# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames to files: each is written beside and renamed, and a summary, written last, marks a frame as complete.

A Piece is one terrain in one frame: its name, its mesh, the engine's Update, facts for JSON and its Blender object.
"""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ...cbt_terrain.errors import TerrainError, check_path
from ...cbt_terrain.field.store_folder import check_is_no_store
from ...cbt_terrain.mesh.archive import finite_json, write_npz
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.owned_files import real_path, remove_file
from ...cbt_terrain.run.partial_files import (
    final_names,
    is_device,
    private_folder,
    remove_abandoned,
    written_among,
    written_beside,
)
from ..session.pauses import handlers_paused
from ..text.console import quiet
from .blender_exporters import only_selected
from .formats import FORMATS, format_of
from .read_back import count_triangles
from .summaries import (
    close_summary,
    content_digest,
    file_sizes,
    find_complete_summary,
    input_name,
    settings_digest,
    summary_name,
)

if TYPE_CHECKING:
    from .frame_sources import Piece

# More than the blocks in which Blender's exporters write.
PROBE_BYTES = 1 << 16


def export_frames(
    source,
    frames: Sequence[int],
    formats: Sequence[str],
    out: Path,
    *,
    resume: bool = False,
    on_frame: Callable[[int, dict, bool], None] = lambda frame, summary, skipped: None,
) -> None:
    """Write every frame of `source` (a StoreFrames or SceneFrames) into the folder `out`.

    A frame's files are `NAME_FRAME.FORMAT`; `frame_FRAME.json`, written last, holds its figures and digests. With
    `resume`, frames are left as they are if settings, inputs and files agree with the digests in their summaries.
    Several processes may write into one folder at once. formats: suffixes without dots. on_frame(frame, summary,
    skipped): called after each frame.
    """
    write_frames(
        lambda frame: _export_frame(source, frame, formats, out),
        source.settings,
        source.inputs,
        frames,
        out,
        formats=formats,
        resume=resume,
        on_frame=on_frame,
    )


def write_frames(
    write: Callable[[int], dict],
    settings: dict,
    inputs: Callable[[int], Sequence[Path]],
    frames: Sequence[int],
    out: Path,
    *,
    formats: Sequence[str] = (),
    resume: bool,
    on_frame: Callable[[int, dict, bool], None],
) -> None:
    """Write each frame with `write`, and close it with a summary that is written last.

    Args:
        write: writes a frame's files into `out` and returns "files" (sizes in bytes by name), "terrains" (their
            figures) and "elapsed_ms".
        settings: what all frames have in common, as JSON.
        inputs: returns the files that a frame is made of. The digest of each is computed once, before the first
            frame that needs it: Blender, too, keeps what it has read, so later changes do not affect the frames.
        formats: suffixes, without dots, of which a complete frame has a file each; () if any files complete it.
        resume: leave frames that are complete with the same settings, inputs and formats.
        on_frame: called after each frame with its number, its summary, and whether it was complete before.

    Raises TerrainError, and Stopped between two frames.
    """
    make_folder(out)
    settings_key, contents = settings_digest(settings), cache(content_digest)
    for frame in frames:
        stopping.check()
        summary_path = out / summary_name(frame)
        digests = {input_name(path, out): contents(path) for path in inputs(frame)}
        existing = find_complete_summary(out, frame, settings_key, digests, formats)
        if existing is not None and resume:
            on_frame(frame, existing, True)
            continue
        if existing is None:  # a summary of other files must not stay while these are written; one of the same may
            _remove_summary(summary_path)
        summary = {"frame": frame, "settings": settings_key, "inputs": digests, **write(frame)}
        summary = close_summary(summary, out)  # adds digests of the files, and its own checksum
        write_text(summary_path, finite_json(summary, str(summary_path), indent=1) + "\n")
        on_frame(frame, summary, False)


def _remove_summary(path: Path) -> None:
    """Remove the summary of a frame that is about to be written again. Raises TerrainError."""
    try:
        _replace_special(path)  # `remove_file` refuses these
        remove_file(path, may_be_link=True)
    except OSError as error:
        raise TerrainError(
            f"{path} cannot be replaced ({error.strerror})",
            expected="a folder with files that can be changed",
            fix="choose another",
        ) from None


def _replace_special(path: Path) -> None:
    """Replace a link, a pipe or a socket by an empty file, which `remove_file` accepts; a link's target stays."""
    if path.is_symlink() or path.is_fifo() or path.is_socket():
        with private_folder(path.parent) as folder:
            (folder / path.name).touch()
            os.replace(folder / path.name, path)


def make_folder(path: Path) -> None:
    """Make the folder and its missing parents, and remove partial files of killed processes from it.

    Raises TerrainError.
    """
    check_is_no_store(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise TerrainError(f"{path} is, or is inside, a file", expected="a folder", fix="choose another path") from None
    except OSError as error:
        raise TerrainError(f"The folder {path} cannot be made ({error.strerror})", fix="choose another path") from None
    remove_abandoned(path)


def check_target(path: Path) -> None:
    """Raise TerrainError if a file must not be written to `path`: no file can have that path, its folder is missing, a
    folder or device has its name, or its folder belongs to a terrain's store.
    """
    check_path("The file", path)
    if os.path.isfile(path.parent):
        raise TerrainError(
            f"{path.parent} is a file", expected=f"a folder to write {path.name} into", fix="choose another"
        )
    if not os.path.isdir(path.parent):
        raise TerrainError(
            f"There is no folder {path.parent} to write {path.name} into", fix="make it, or choose another"
        )
    if os.path.isdir(path):
        raise TerrainError(f"{path} is a folder", expected="a file to write", fix="choose another name")
    if is_device(path):
        raise TerrainError(f"{path} is a device or a pipe", expected="a file to write", fix="choose another name")
    check_is_no_store(path.parent)


@contextmanager
def named_failures(path: Path):
    """Turn errors of the `with` block, which writes `path`, into a TerrainError that names the file and the reason.

    These are OSError, and RuntimeError of Blender's exporters. `check_target` is called before the block.
    """
    check_target(path)
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
    except RuntimeError as error:  # what Blender's exporters report; of a traceback, the last line
        lines = [line for line in str(error).strip().splitlines() if not line.startswith("Location: ")]
        reason = (lines or ["no reason given"])[-1].removeprefix("Error: ")
    else:
        return
    # `final_names`: users do not know the partial files that a reason may name.
    raise TerrainError(
        f"{path} cannot be written ({final_names(str(reason))})", fix="check the disk, or choose another folder"
    )


def check_disk_space(path: Path, size: int) -> None:
    """Raise TerrainError if the disk has no room for `size` bytes beside `path`."""
    with named_failures(path), private_folder(path.parent) as folder:
        (folder / path.name).write_bytes(bytes(size))


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all. Raises TerrainError."""
    write_files(path.parent, {path.name: text})


def write_files(folder: Path, contents: dict[str, str | bytes]) -> None:
    """Write small files, such as those of a report, into a folder; contents: UTF-8 text or bytes by file name.

    They are written to private folders first and renamed at the end, so an error while writing changes no file; one
    while renaming may leave some replaced. Raises TerrainError.
    """
    with ExitStack() as stack:
        for path, content in ((folder / name, content) for name, content in contents.items()):
            stack.enter_context(named_failures(path))
            data = content if isinstance(content, bytes) else content.encode()
            stack.enter_context(written_beside(path)).write_bytes(data)


def _export_frame(source, frame: int, formats: Sequence[str], out: Path) -> dict:
    """Write the files of one frame in all formats; return their sizes by name, the terrains' figures and the time.

    The result has the keys "files", "terrains" and "elapsed_ms", which go into the frame's summary. source: a
    StoreFrames or SceneFrames.
    """
    start = time.perf_counter()
    files, pieces = [], []
    for piece in source.pieces(frame):
        for form in formats:
            if not FORMATS[form].is_whole_scene:
                files.append(out / f"{piece.name}_{frame:04d}.{form}")
                write_piece(piece, files[-1])
        if source.with_scatters:
            files += _write_scatters(piece, frame, out)
        pieces.append(piece)
    for form in formats:
        if FORMATS[form].is_whole_scene:
            files.append(out / f"{source.name}_{frame:04d}.{form}")
            FORMATS[form].call("write", pieces, files[-1])
    elapsed = (time.perf_counter() - start) * 1e3
    return {
        "files": file_sizes(files, out),
        "terrains": [figures(piece) for piece in pieces],
        "elapsed_ms": round(elapsed, 3),
    }


def _write_scatters(piece: "Piece", frame: int, out: Path) -> list[Path]:
    """Write the scatters of a terrain as CSV files into `out`; return the files."""
    from .scatter_files import write_points_csv

    files = []
    for name, (points, placement) in piece.scatters.items():
        files.append(out / f"{name}_{frame:04d}.csv")
        with named_failures(files[-1]):
            write_points_csv(files[-1], points, placement)
    return files


def figures(piece: "Piece") -> dict:
    """Return the figures of one terrain for the summary of its frame: counts after the clean-up, bounds and times."""
    from .frame_sources import bounds_of

    update = piece.update
    return {
        "name": piece.name,
        "triangles": len(piece.surface.triangles),
        "vertices": len(piece.surface.positions),
        **bounds_of(update),
        "ms": {step: round(ms, 3) for step, ms in update.ms.items()},
        **({"loaded": piece.info["loaded"]} if "loaded" in piece.info else {}),  # of an incomplete store
    }


def write_piece(piece: "Piece", path: Path) -> None:
    """Write one terrain to `path`; the suffix is the format. Raises TerrainError."""
    format_of(path).call("write", [piece], path)


def write_arrays(pieces: "Sequence[Piece]", path: Path) -> None:
    """Write one terrain's arrays to an .npz."""
    [piece] = pieces
    with named_failures(path):
        write_npz(path, piece.surface, piece.origin, piece.info, piece.tree)


@contextmanager
def _written_by_blender(path: Path, written=written_beside):
    """Yield a partial file for Blender's exporters, which becomes `path` after the `with` block.

    written: context manager for partial files. Creating the file is tried first, because the exporters print tracebacks
    if they cannot. No handler of this extension runs meanwhile: an exporter may change the frame while it reads the
    mesh.
    """
    with written(path) as partial, handlers_paused():
        partial.touch()
        remove_file(partial, may_be_link=True)
        yield partial


def _check_fully_written(path: Path) -> None:
    """Raise OSError if the disk is full, RuntimeError if Blender wrote no file.

    Blender's PLY, OBJ and STL writers do not report that a full disk, a quota or a limit has cut their files short.
    """
    if not path.exists():
        raise RuntimeError("Blender wrote nothing")
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.write(bytes(PROBE_BYTES))
        file.flush()
        os.fsync(file.fileno())
        file.truncate(size)


def write_blend(pieces: "Sequence[Piece]", path: Path) -> None:
    """Save a copy of the open file, which keeps its path.

    Reading the copy back would take as long as writing it, so the triangles of `pieces` are counted in the open file.
    """
    import bpy

    path = real_path(path)
    for piece in pieces:
        _check_count(piece, path, len(piece.obj.data.polygons))
    # written_among: the partial file is in the final folder, so relative paths in it stay right.
    with named_failures(path), _written_by_blender(path, written_among) as partial, quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(partial), copy=True, check_existing=False, compress=True)
        _check_fully_written(partial)


def write_with_blender(pieces: "Sequence[Piece]", path: Path) -> None:
    """Write one terrain by Blender's own exporter, in that exporter's usual axes: glb and obj have y up, the rest z.

    The file holds the terrain's own mesh, whose bound is known, without modifiers. It is read back before it gets its
    name.
    """
    [piece] = pieces
    form = format_of(path)
    with named_failures(path), _written_by_blender(path) as partial:
        with only_selected(piece.obj), quiet(1, 2):  # the OBJ exporter prints on stderr; errors are raised too
            form.call("export", piece.obj, str(real_path(partial)))
        _check_fully_written(partial)
        try:
            found = count_triangles(partial)
        except ValueError as reason:
            raise RuntimeError(str(reason)) from None
        _check_count(piece, path, found)
        if form.finish:
            form.call("finish", piece, partial)


def _check_count(piece: "Piece", path: Path, found: int) -> None:
    """Raise TerrainError if a file would hold another number of triangles, `found`, than the terrain has."""
    expected = len(piece.surface.triangles)
    if found != expected:
        raise TerrainError(
            f"{path} would hold {found:,} triangles where the terrain {piece.name!r} has {expected:,}, and is not "
            "written",
            fix="remove what changes or multiplies its mesh in Blender (instances, handlers of other extensions)",
        )
