# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work in Blender's status bar, visible wherever the panel is."""

import traceback

import bpy

from ...cbt_terrain.run import warmup
from .. import jobs
from ..land import render_wait
from ..session import live
from ..text.translations import phrase

TURN_S = 0.1
WIDTH = 14  # in the interface's units, so that the bar does not move with its text
_shown: tuple | None = None


def work() -> tuple[float | None, str] | None:
    """Return the progress of what runs now (0 .. 1; None if it is unknown) and its text; None if nothing runs."""
    fraction = warmup.progress()
    if fraction is not None:
        return fraction, "Preparing kernels (first use)"
    wait = render_wait.waiting
    if wait is not None:
        return wait.fraction, wait.text
    for job in jobs.running:
        return job.fraction, job.text
    seconds = live.seconds_under_way()
    return (None, f"{phrase(live.stage())}, {seconds:.0f} s") if seconds >= 1.0 else None


def _draw(self, _context) -> None:
    now = work()
    if now is None:
        return
    fraction, text = now
    row = self.layout.row()
    row.ui_units_x = WIDTH
    if fraction is None:
        row.label(text=f"Adaptive Terrain: {text}", icon="SORTTIME")
    else:
        row.progress(factor=fraction, text=text)


def _turn() -> float:
    try:
        _redraw_if_changed()
    except Exception:  # Blender would silently take a timer off that raises
        traceback.print_exc()
    return TURN_S


def _redraw_if_changed() -> None:
    global _shown
    render_wait.watch()
    now = work()
    if now is not None and now[0] is not None:
        now = round(now[0] * jobs.SHOWN_STEPS), now[1]
    if now != _shown:
        _shown = now
        jobs.redraw_panels()
        # The status bar belongs to no screen, so that no script can tag it; it listens to the window's view layer.
        bpy.msgbus.publish_rna(key=(bpy.types.Window, "view_layer"))


def start() -> None:
    if not bpy.app.background:
        bpy.types.STATUSBAR_HT_header.prepend(_draw)
        bpy.app.timers.register(_turn, first_interval=TURN_S, persistent=True)


def stop() -> None:
    global _shown
    if bpy.app.timers.is_registered(_turn):
        bpy.app.timers.unregister(_turn)
        bpy.types.STATUSBAR_HT_header.remove(_draw)
    _shown = None
