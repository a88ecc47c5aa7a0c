# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that a render waits for: its progress in the image editor, the panel and the status bar, or on the console.

A render in a window runs its handlers on another thread, so that the window can draw meanwhile. Only a render engine
may write the text above a render.
"""

import time
from dataclasses import dataclass

import blf
import bpy

from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.height_operators.derived_store import Land
from ..text.console import print_line

PRINTED_S = 10.0  # between lines on the console
KNOWN = 0.05  # part of the work after which the time that is left can be told
TEXT_PX, MARGIN_PX = 16, 20
_handle = None


@dataclass
class LandWait:
    """Shaping that a render waits for. `started`, `printed`: monotonic seconds."""

    folder: str
    started: float
    fraction: float = 0.0
    message: str = ""
    printed: float = 0.0

    @property
    def text(self) -> str:
        spent = time.monotonic() - self.started
        left = spent * (1.0 - self.fraction) / self.fraction if self.fraction >= KNOWN else None
        known = f", about {left:.0f} s left" if left is not None else ""
        return f"Shaping land, {self.fraction:.0%}{known} ({self.message})"


waiting: LandWait | None = None


def _on_shaping(land: Land, fraction: float, message: str) -> None:
    """Note the progress of shaping; on any thread."""
    global waiting
    wait = waiting
    if fraction >= 1.0:
        waiting = None
        return
    if wait is None or wait.folder != land.folder:
        wait = LandWait(land.folder, time.monotonic())
    wait.fraction, wait.message, waiting = fraction, message, wait
    if bpy.app.background and time.monotonic() - wait.printed >= PRINTED_S:
        wait.printed = time.monotonic()
        print_line(f"Adaptive Terrain: {wait.text}")


def _draw() -> None:
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


def register() -> None:
    global _handle
    derived_store.on_shaping = _on_shaping
    if not bpy.app.background:
        _handle = bpy.types.SpaceImageEditor.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    global _handle, waiting
    if _handle is not None:
        bpy.types.SpaceImageEditor.draw_handler_remove(_handle, "WINDOW")
    _handle = waiting = None
