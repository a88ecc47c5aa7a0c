# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame whose terrain cannot be refined would show the mesh of another frame, and nobody would know.

Without a window, on a farm say, such a frame is not written and the process ends with exit code 1, unless the scene
says otherwise. With one, Blender lets nobody but the user cancel a render, so a message tells of it in the end. A
command that renders gets an error that it can tell in its own way.
"""

import os
import signal
import sys
from contextlib import contextmanager, suppress

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.owned_files import remove_empty
from ..text.console import print_line

EXIT_CODE = 1
FRAMES_NAMED = 10
_ending = False
_raising = False
_caught: list[str] = []
_shown_stale: dict[int, str] = {}  # frame -> why


@contextmanager
def raising():
    """A render inside ends, and a TerrainError is raised after it, where a terrain cannot be refined."""
    global _raising
    _raising = True
    _caught.clear()
    try:
        yield
    finally:
        _raising = False
    if _caught:
        raise TerrainError(_caught[0])


def meet(scene, reasons: list[str]) -> None:
    """The terrains of the frame that is about to be rendered cannot be refined, for these `reasons`."""
    global _ending
    if _ending:  # each view layer asks, and a second interruption would kill Blender
        return
    why = " ".join(reasons)
    if _raising:
        stopping.end_host_work()
        _caught.append(f"Frame {scene.frame_current} is not rendered, since its mesh would be stale. {why}")
        return
    if not (bpy.app.background and scene.adaptive_terrain.stop_stale_renders):
        print_line(f"Adaptive Terrain: frame {scene.frame_current} is rendered with a stale mesh. {why}")
        _shown_stale[scene.frame_current] = why
        return
    print_line(
        f"Adaptive Terrain: frame {scene.frame_current} is not rendered, since its mesh would be stale. {why}",
        file=sys.stderr,
    )
    _ending = True
    # The Blender program takes an interruption as the wish to end the render: it writes no more frames and closes a
    # movie. Blender as a Python module has nothing of the kind, nor has a program whose script caught it first.
    if bpy.app.binary_path and signal.getsignal(signal.SIGINT) is None:
        signal.raise_signal(signal.SIGINT)
    else:
        leave()


def leave() -> None:
    """End the process if a render was stopped; called again when Blender has closed what it was writing."""
    if not _ending:
        return
    with suppress(OSError, TerrainError):
        remove_empty(bpy.app.tempdir)  # as Blender does at its end; only if nothing is in it
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(EXIT_CODE)


def report() -> None:
    """Tell who looks at a window which frames of the render that has ended are stale."""
    if _shown_stale and not bpy.app.background:
        bpy.app.timers.register(_pop_up, first_interval=0.0)  # a popup is the main thread's
    else:
        _shown_stale.clear()


def lines_of(stale: dict[int, str]) -> list[str]:
    """What is said of stale frames and why they are: the first few frames by number, each reason once."""
    frames = ", ".join(map(str, sorted(stale)[:FRAMES_NAMED]))
    more = f" and {len(stale) - FRAMES_NAMED:,} more" if len(stale) > FRAMES_NAMED else ""
    return [f"Rendered with the mesh of another frame: {frames}{more}", *dict.fromkeys(stale.values())]


def _pop_up() -> None:
    lines = lines_of(_shown_stale)
    _shown_stale.clear()
    manager = bpy.context.window_manager
    if not manager.windows:
        return

    def draw(self, _context):
        for line in lines:
            self.layout.label(text=line)

    with bpy.context.temp_override(window=manager.windows[0]):
        manager.popup_menu(draw, title="Adaptive Terrain", icon="ERROR")
