# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages in the window from handlers and threads, which cannot report."""

import bpy

_lines: list[str] = []  # of the next message


def show_soon(lines) -> None:
    """Show lines in one message of the window, at the next turn of the main thread; nothing without a window."""
    if bpy.app.background or not lines:
        return
    _lines.extend(line for line in lines if line not in _lines)
    if not bpy.app.timers.is_registered(_show):
        bpy.app.timers.register(_show, first_interval=0.0)  # popups need the main thread


def _show() -> None:
    """Show the message; a timer calls it."""
    lines = list(_lines)
    _lines.clear()
    manager = bpy.context.window_manager
    if not manager.windows:
        return

    def draw(self, _context):
        """Draw the message as lines of the popup."""
        for line in lines:
            self.layout.label(text=line)

    with bpy.context.temp_override(window=_render_window(manager.windows)):
        manager.popup_menu(draw, title="Adaptive Terrain", icon="ERROR")


def _render_window(windows):
    """Return the first of some windows that shows a render, which may cover the others; without one the first."""
    for window in windows:
        for area in window.screen.areas:
            image = area.spaces.active.image if area.type == "IMAGE_EDITOR" else None
            if image is not None and image.type == "RENDER_RESULT":
                return window
    return windows[0]
