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


def current_work() -> tuple[float | None, str] | None:
    """Return the progress (0 .. 1, None if unknown) and a text of the long work that runs now; None if nothing runs.

    It is the first of: kernels, a render's wait, the oldest job, and a live update of a second or more.
    """
    fraction = warmup.progress()
    if fraction is not None:
        return fraction, jobs.PREPARING
    wait = render_wait.waiting
    if wait is not None:
        return wait.fraction, wait.text
    for job in jobs.running:
        return job.fraction, job.text
    seconds = live.seconds_under_way()
    return (None, f"{phrase(live.stage())}, {seconds:.0f} s") if seconds >= 1.0 else None


def _draw_progress(self, _context) -> None:
    """Draw the current work in the status bar; Blender calls it as part of the bar's header."""
    now = current_work()
    if now is None:
        return
    fraction, text = now
    row = self.layout.row()
    row.ui_units_x = WIDTH
    if fraction is None:
        row.label(text=f"Adaptive Terrain: {text}", icon="SORTTIME")
    else:
        row.progress(factor=fraction, text=text)


def _tick() -> float:
    """Redraw the status bar if needed, and return the seconds until Blender calls this timer again."""
    try:
        _redraw_if_changed()
    except Exception:  # Blender silently removes a timer that raises
        traceback.print_exc()
    return TURN_S


def _redraw_if_changed() -> None:
    """Redraw the status bar and the panels if the progress that they show has changed."""
    global _shown
    render_wait.watch()  # lets Esc end a render's wait
    now = current_work()
    if now is not None and now[0] is not None:
        now = round(now[0] * jobs.SHOWN_STEPS), now[1]
    if now != _shown:
        _shown = now
        jobs.redraw_panels()
        # The status bar belongs to no screen, so that no script can tag it; it listens to the window's view layer.
        bpy.msgbus.publish_rna(key=(bpy.types.Window, "view_layer"))


def start() -> None:
    """Show the progress of jobs in the status bar of a window."""
    if not bpy.app.background:
        bpy.types.STATUSBAR_HT_header.prepend(_draw_progress)
        bpy.app.timers.register(_tick, first_interval=TURN_S, persistent=True)


def stop() -> None:
    """Remove the progress from the status bar."""
    global _shown
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
        bpy.types.STATUSBAR_HT_header.remove(_draw_progress)
    _shown = None
