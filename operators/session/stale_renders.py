# SPDX-License-Identifier: GPL-3.0-or-later
"""Handle frames whose terrain cannot be refined, which would silently show the mesh of another frame.

In the background, such a frame is not written and the process ends with exit code 1, unless the scene allows stale
renders. With a window only the user can cancel a render, so a message appears at its end. A command that renders gets
an error.
"""

import os
import signal
import sys
from contextlib import contextmanager, suppress

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import stopping
from ...cbt_terrain.run.owned_files import remove_empty
from ..bridge import popup
from ..land.render_wait import CANCELLED
from ..text.console import print_line
from ..text.translations import phrase

EXIT_CODE = 1
FRAMES_NAMED = 10
_ending = False  # a render in the background is being ended
_raising = False  # inside of `raise_for_stale_frames`
_caught: list[TerrainError] = []  # errors that its block raises
_shown_stale: dict[int, str] = {}  # frame -> why
_messages: list[str] = []  # about the render as a whole


@contextmanager
def raise_for_stale_frames():
    """End a render in the `with` block at a frame whose terrain cannot be refined; raise its TerrainError after it."""
    global _raising
    _raising = True
    _caught.clear()
    try:
        yield
    finally:
        _raising = False
    if _caught:
        raise _caught[0]


def handle_stale_frame(scene, frame: int, errors: list[TerrainError]) -> None:
    """Handle a frame, before its render, whose terrains cannot be refined because of `errors`.

    In the background it is not rendered unless the scene allows it; with a window it is noted for
    `report_stale_frames`. Inside `raise_for_stale_frames` the render ends, and the error is kept for that. A render
    that the user has cancelled with Esc ends by itself. frame: number of the picture, which in a video edit is not the
    scene's.
    """
    global _ending
    if _ending:  # each view layer calls this, and a second interruption would kill Blender
        return
    if _raising:
        stopping.end_host_work()  # ends the render
        _caught.append(stale_frame_error(frame, errors))
        return
    why = " ".join(dict.fromkeys(map(str, errors)))
    if any(error.code == CANCELLED for error in errors):  # Blender ends the render
        print_line(f"Adaptive Terrain: {why}")
        _messages.append(why)
        return
    if not (bpy.app.background and scene.adaptive_terrain.stop_stale_renders):
        print_line(f"Adaptive Terrain: frame {frame} is rendered with a stale mesh. {why}")
        _shown_stale[frame] = why
        return
    print_line(
        f"Adaptive Terrain: frame {frame} is not rendered, since its mesh would be stale. {why}",
        file=sys.stderr,
    )
    _ending = True
    # An interruption makes the Blender program end the render and close a movie. The bpy module, or a program whose
    # script handles the signal, exits at once.
    if bpy.app.binary_path and signal.getsignal(signal.SIGINT) is None:
        signal.raise_signal(signal.SIGINT)
    else:
        exit_if_stopped()  # at once, since `_ending` is set


def add_message(text: str) -> None:
    """Add a sentence about the render as a whole to the message in the window at its end."""
    if text not in _messages:  # every frame and view layer adds it
        _messages.append(text)


def stale_frame_error(frame: int, errors: list[TerrainError]) -> TerrainError:
    """Return the error of a frame that is not rendered: the last of `errors`, after the sentences of the others."""
    others = [str(error).removesuffix(".") for error in errors[:-1] if str(error) != str(errors[-1])]
    return errors[-1].within(
        ". ".join([f"Frame {frame} is not rendered, since its mesh would be stale", *dict.fromkeys(others)])
    )


def exit_if_stopped() -> None:
    """Exit the process with EXIT_CODE if `handle_stale_frame` has stopped the render; called once Blender has
    closed its files.
    """
    if not _ending:
        return
    with suppress(OSError, TerrainError):
        remove_empty(bpy.app.tempdir)  # as Blender does at exit
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(EXIT_CODE)


def report_stale_frames() -> None:
    """Show a message in the window with the stale frames and messages of the finished render, then forget them."""
    popup.show_soon([*dict.fromkeys(_messages), *(message_lines(_shown_stale) if _shown_stale else ())])
    _shown_stale.clear()
    _messages.clear()


def message_lines(stale: dict[int, str]) -> list[str]:
    """Return the message's lines: the first FRAMES_NAMED stale frames by number, and each reason once.

    stale: reason by frame, not empty.
    """
    frames = ", ".join(map(str, sorted(stale)[:FRAMES_NAMED]))
    if len(stale) > FRAMES_NAMED:
        frames = phrase("{} and {} more", frames, f"{len(stale) - FRAMES_NAMED:,}")
    return [phrase("Rendered with the mesh of another frame: {}", frames), *dict.fromkeys(stale.values())]
