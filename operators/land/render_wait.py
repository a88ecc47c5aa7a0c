# SPDX-License-Identifier: GPL-3.0-or-later
"""Land and imports that a render waits for: progress in the image editor, panel and status bar, or on the console.

A render in a window runs its handlers on another thread, so that the window can draw meanwhile. Only a render engine
may write the text above a render.
"""

import math
import time
from contextlib import suppress
from dataclasses import dataclass

import blf
import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.height_operators.shaping_cost import estimate_seconds
from ...cbt_terrain.sandbox.store_job import ChildJob
from ..bridge.writing import allow_writing
from ..text.console import print_line
from ..text.translations import phrase

CANCELLED = "land.cancelled"  # code of the error after Esc
PRINTED_S = 10.0  # between lines on the console
MEASURED = 0.05  # fraction of the work after which the remaining time is computed from the time that it took
POLL_S = 0.05  # between looks at an import that a render waits for
TEXT_PX, MARGIN_PX = 16, 20
_handle = None


@dataclass
class LandWait:
    """Shaping that a render waits for.

    Attributes:
        folder: store of the land that is shaped, "" for an import.
        started: monotonic seconds of its start.
        estimate: seconds that were expected before it started.
        fraction: done, 0 to 1.
        message: the present step.
        printed: monotonic seconds of the last line on the console.
        is_watched: an operator in each window hears Esc.
    """

    folder: str
    started: float
    estimate: float = math.inf
    fraction: float = 0.0
    message: str = ""
    printed: float = 0.0
    is_watched: bool = False

    @property
    def text(self) -> str:
        """Return the progress as one line for the image editor and the console."""
        return phrase("Shaping land, {} ({})", self.brief, self.message)

    @property
    def brief(self) -> str:
        """Return the fraction done and the estimated seconds left, for a narrow panel."""
        remaining = 1.0 - self.fraction
        seconds = remaining * self.estimate
        if self.fraction >= MEASURED:  # the smaller of both: coarse levels come first and are slower than planned
            seconds = min(seconds, remaining * (time.monotonic() - self.started) / self.fraction)
        done = f"{self.fraction:.0%}"
        return phrase("{}, about {} s left", done, f"{seconds:.0f}") if seconds < math.inf else done


@dataclass
class ImportWait(LandWait):
    """A running import that a render waits for."""

    @property
    def text(self) -> str:
        """Return the progress as one line for the image editor and the console."""
        return phrase("Importing, {} ({})", f"{self.fraction:.0%}", phrase(self.message))


waiting: LandWait | None = None
_is_cancelled = False  # by Esc, until the render ends


def _on_shaping(land: Land, fraction: float, message: str) -> None:
    """Set `waiting` to the progress of shaping, and print it if Blender has no window; on any thread.

    The engine calls it while an update shapes land itself, as a render's does. fraction: done, 1 at the end. message:
    the present step. Raises TerrainError, which ends the shaping, once the user has pressed Esc.
    """
    global waiting
    wait = waiting
    if _is_cancelled and fraction < 1.0:
        raise TerrainError(
            "The render was cancelled while land was shaped",
            fix="render again: finished tiles are reused",
            code=CANCELLED,
        )
    if fraction >= 1.0:
        waiting = None
        return
    if wait is None or wait.folder != land.folder:
        now = time.monotonic()
        wait = LandWait(land.folder, now, _estimate_seconds(land), printed=now)
    wait.fraction, wait.message, waiting = fraction, message, wait
    if bpy.app.background and time.monotonic() - wait.printed >= PRINTED_S:
        wait.printed = time.monotonic()
        print_line(f"Adaptive Terrain: {wait.text}")


def wait_for_import(child: ChildJob) -> None:
    """Wait on a render's thread until a child process that imports has ended, well or not; its error is not raised.

    Raises TerrainError after Esc, without cancelling the child process.
    """
    global waiting
    wait = waiting = ImportWait("", time.monotonic())
    try:
        while (progress := child.reached) is not None:  # None when the child process has ended
            wait.fraction, wait.message = progress
            if _is_cancelled:
                raise TerrainError(
                    "The render was cancelled while the height map was imported",
                    fix="render again when it is complete",
                    code=CANCELLED,
                )
            time.sleep(POLL_S)
    finally:
        waiting = None


def _estimate_seconds(land: Land) -> float:
    """Return the expected seconds of shaping land, infinity if they are unknown."""
    with suppress(TerrainError, OSError):
        seconds = estimate_seconds(land.source, land.stack, derived_store.preview_of(land), land.of_views)
        return math.inf if seconds is None else seconds
    return math.inf


def watch() -> None:
    """Let Esc end the shaping or the import that a render waits for; called by a timer on the main thread.

    While Blender's interface is locked, only its own operators get events.
    """
    wait, manager = waiting, bpy.context.window_manager
    if wait is None or wait.is_watched or manager.is_interface_locked:
        return
    wait.is_watched = True
    _listen(manager.windows)


@allow_writing
def _listen(windows) -> None:
    """Start the operator that hears Esc in each window."""
    for window in windows:
        with bpy.context.temp_override(window=window):
            bpy.ops.adaptive_terrain.cancel_waiting("INVOKE_DEFAULT")


def forget_cancelling() -> None:
    """Allow land to be shaped again after a cancelled render."""
    global _is_cancelled
    _is_cancelled = False


class CancelWaiting(bpy.types.Operator):
    """Cancel the shaping of land that a render waits for when Esc is pressed; the render gets the key, too"""

    bl_idname = "adaptive_terrain.cancel_waiting"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    def invoke(self, context, _event):
        """Begin to receive the window's events, so that `modal` hears Escape."""
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, _context, event):
        """Note that Escape was pressed; end when no render waits any more."""
        global _is_cancelled
        if waiting is None:
            return {"FINISHED", "PASS_THROUGH"}
        _is_cancelled |= event.type == "ESC" and event.value == "PRESS"
        return {"PASS_THROUGH"}


def _draw_over_render() -> None:
    """Draw the progress at the lower left of an image editor: a render that waits has no other display."""
    wait = waiting
    if wait is None:
        return
    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, TEXT_PX * scale)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 5, 0.0, 0.0, 0.0, 1.0)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    blf.position(0, MARGIN_PX * scale, MARGIN_PX * scale, 0)
    blf.draw(0, wait.text)
    blf.disable(0, blf.SHADOW)


def start() -> None:
    """Have the engine report all shaping to `_on_shaping`, and in a window draw a render's wait over image editors."""
    global _handle
    derived_store.on_shaping = _on_shaping
    if not bpy.app.background:
        _handle = bpy.types.SpaceImageEditor.draw_handler_add(_draw_over_render, (), "WINDOW", "POST_PIXEL")


def stop() -> None:
    """Stop drawing, and forget the wait of a render and its cancelling."""
    global _handle, waiting
    if _handle is not None:
        bpy.types.SpaceImageEditor.draw_handler_remove(_handle, "WINDOW")
    _handle = waiting = None
    forget_cancelling()
