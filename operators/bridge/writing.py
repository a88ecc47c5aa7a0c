# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions of timers and handlers that may write to Blender's data at any time.

Blender forbids scripts to write while panels are drawn, by one flag for all threads. Each call of a Python class saves
the flag and restores it. If a render engine is called on the render's thread while a panel is drawn, the two restore it
in the wrong order: the flag then stays set after the render. Until Blender is restarted, a timer or a handler can call
no operator and set no property of an object, while meshes can be written. The update function of a property may always
write, so what meets the flag runs inside one. Blender redraws the window after each such call.
"""

import threading
import time
from functools import wraps

import bpy

NAME = "adaptive_terrain_write"  # of the property of the window manager
NO_ENTRY = "adaptive_terrain_no_entry"  # a custom property that no scene has
DRAWING_S = 0.2  # at most, for which a render's thread waits until no panel is drawn
_run = None  # called by the property's update function


def may_write() -> bool:
    """Return whether Blender lets Python write to its data now."""
    try:
        del bpy.data.scenes[0][NO_ENTRY]  # which no scene has
    except KeyError:
        return True
    except AttributeError:  # Blender looks at its flag first
        return False


def allow_writing(function):
    """Decorate a function that a timer or a handler calls, so that it may write after any render.

    Where Blender's flag forbids writing, the function runs inside the update function of a property.
    """

    @wraps(function)
    def allowed(*arguments):
        """Call the function, at once or inside the update function; return its result or raise its exception."""
        global _run
        if may_write() or _wait_for_drawing():
            return function(*arguments)
        results, errors = [], []

        def call() -> None:
            """Call the function and keep its result, or the exception, which Blender would only print."""
            try:
                results.append(function(*arguments))
            except Exception as error:  # Blender would print it
                errors.append(error)

        _run = call
        setattr(bpy.context.window_manager, NAME, True)  # its update function calls `_run`
        if errors:
            raise errors[0]
        return results[0]

    return allowed


def _wait_for_drawing() -> bool:
    """Wait on a render's thread while the window draws a panel; return whether Blender then allows writing."""
    if threading.current_thread() is threading.main_thread():  # which draws nothing now
        return False
    end = time.monotonic() + DRAWING_S
    while time.monotonic() < end:
        time.sleep(0.005)
        if may_write():
            return True
    return False


def _on_update(_manager, _context) -> None:
    """Run the waiting writes; Blender calls this when the property changes."""
    _run()


def start() -> None:
    """Add the property to the window manager."""
    setattr(bpy.types.WindowManager, NAME, bpy.props.BoolProperty(update=_on_update, options={"HIDDEN", "SKIP_SAVE"}))


def stop() -> None:
    """Remove the property from the window manager."""
    delattr(bpy.types.WindowManager, NAME)
