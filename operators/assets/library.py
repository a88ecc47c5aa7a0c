# SPDX-License-Identifier: GPL-3.0-or-later
"""The entry of the asset library in Blender's preferences, and the child process that writes the library once.

The files are in the extension's user folder, which Blender deletes with the extension. A background Blender, as on a
farm, writes none; it lists a library that is there.
"""

import subprocess
import sys
from pathlib import Path

import bpy

from ...cbt_terrain.run import child
from ...cbt_terrain.run.named_file import read_regular
from ...cbt_terrain.run.owned_files import real_path
from ..text.console import print_line
from .build import AUTHOR, BLEND, STAMP

ASSETS = 1  # raise it when the assets change within a version
DELAY_S, POLL_S = 3.0, 0.5  # after the start of Blender, when its window is drawn; between looks at the child
MAX_STAMP = 200  # bytes
PACKAGE = __package__.rsplit(".", 2)[0]
_process: subprocess.Popen | None = None


def library_folder(create: bool = False) -> Path | None:
    """Return the library's folder; None for a package that Blender did not install. create: make it if missing."""
    if not PACKAGE.startswith("bl_ext."):
        return None
    return Path(bpy.utils.extension_path_user(PACKAGE, path="assets", create=create))


def is_current(folder: Path) -> bool:
    """Return whether a folder has the library that this version of the extension writes in this version of Blender."""
    try:
        return (folder / BLEND).is_file() and read_regular(folder / STAMP, MAX_STAMP) == _stamp().encode()
    except (OSError, ValueError):
        return False


def _stamp() -> str:
    """Return the version of the library that this extension writes in this Blender."""
    from ... import __version__

    return f"{__version__} {ASSETS}, Blender {bpy.app.version_string}"


def add_entry(folder: Path) -> None:
    """Add the library to the preferences, unless it is there."""
    if not _entries(folder):
        bpy.context.preferences.filepaths.asset_libraries.new(name=AUTHOR, directory=str(folder))


def remove_entry(folder: Path) -> None:
    """Remove the library's first entry from the preferences; other libraries stay."""
    for entry in _entries(folder)[:1]:
        bpy.context.preferences.filepaths.asset_libraries.remove(entry)


def _entries(folder: Path) -> list:
    """Return the asset libraries in the preferences whose path is the folder."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    return [entry for entry in libraries if entry.path and real_path(entry.path) == real_path(folder)]


def start_writing(folder: Path) -> subprocess.Popen:
    """Start a Blender that writes the library to a folder; return its process, to poll or to kill. Raises OSError.

    Factory settings load no extension: the process gets the paths of modules of this one.
    """
    module, arguments = "operators.assets.build", (str(folder), _stamp())
    argv = ["-c", *child.bootstrap_arguments(module, *arguments)]
    script = f"import sys\nsys.path[:], sys.argv[:] = {sys.path!r}, {argv!r}\n{child.BOOTSTRAP}"
    options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", script]
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return child.start_program([bpy.app.binary_path, *options], **streams)


def _turn() -> float | None:
    """Start the child, or look whether it has ended, from a timer; return seconds to the next look, None at the end."""
    global _process
    folder = library_folder(create=True)
    if _process is None and not is_current(folder):
        try:
            _process = start_writing(folder)
        except OSError as reason:
            print_line(f"Adaptive Terrain: the asset library cannot be written ({reason})")
            return None
        return POLL_S
    if _process is not None and (code := child.poll(_process)) is None:
        return POLL_S
    if _process is not None and code:
        print_line(f"Adaptive Terrain: the asset library cannot be written (exit code {code})")
    _process = None
    if is_current(folder):
        add_entry(folder)
    return None


def start() -> None:
    """Offer the asset library to Blender, and build it in the background if it is missing or old."""
    folder = library_folder()
    if folder is None:
        return
    if (folder / BLEND).is_file():
        add_entry(folder)
    if not bpy.app.background and not is_current(folder):
        bpy.app.timers.register(_turn, first_interval=DELAY_S, persistent=True)


def stop() -> None:
    """Stop building the library and take it out of Blender's preferences."""
    global _process
    if bpy.app.timers.is_registered(_turn):
        bpy.app.timers.unregister(_turn)
    if _process is not None:
        child.kill(_process)
        _process = None
    if (folder := library_folder()) is not None:
        remove_entry(folder)
