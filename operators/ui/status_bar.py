# SPDX-License-Identifier: GPL-3.0-or-later
"""What takes long is said in Blender's status bar, wherever the panel is."""

import traceback

import bpy

from ...cbt_terrain.run import warmup
from ..effects import bake_maps
from ..importing import import_terrain, pack_store
from ..scene import land_jobs
from ..viewport import live

TURN_S = 0.1
WIDTH = 14  # in the interface's units, so that the bar does not move with its text
STEPS = 200  # a bar that has not grown by one is not drawn anew
_shown: tuple | None = None


def work() -> tuple[float | None, str] | None:
    """How far what is under way is (0 .. 1; None where that is not known) and what it is; None if nothing is."""
    fraction = warmup.progress()
    if fraction is not None:
        return fraction, "Preparing kernels (first use)"
    for fraction, message in import_terrain.all_progress():
        return fraction, f"Importing: {message}"
    for fraction, message in land_jobs.all_progress():
        return fraction, f"Shaping: {message}"
    fraction = pack_store.progress()
    if fraction is not None:
        return fraction, "Packing stores"
    baking = bake_maps.progress()
    if baking is not None:
        return baking
    seconds = live.seconds_under_way()
    return (None, f"{live.stage()}, {seconds:.0f} s") if seconds >= 1.0 else None


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
    now = work()
    if now is not None and now[0] is not None:
        now = round(now[0] * STEPS), now[1]
    if now != _shown:
        _shown = now
        live.redraw_panels()
        # The status bar belongs to no screen, so that no script can tag it; it listens to the window's view layer.
        bpy.msgbus.publish_rna(key=(bpy.types.Window, "view_layer"))


def register() -> None:
    if not bpy.app.background:
        bpy.types.STATUSBAR_HT_header.prepend(_draw)
        bpy.app.timers.register(_turn, first_interval=TURN_S, persistent=True)


def unregister() -> None:
    global _shown
    if bpy.app.timers.is_registered(_turn):
        bpy.app.timers.unregister(_turn)
        bpy.types.STATUSBAR_HT_header.remove(_draw)
    _shown = None
