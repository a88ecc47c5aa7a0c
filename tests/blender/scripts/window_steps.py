# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the steps of a script in a window of Blender, and write its report into FOLDER, the script's first argument.

A step may write to Blender's data even if a render has left its flag against that set (operators/bridge/writing.py).

Blender handles events and draws only between the turns of a timer. Every step is therefore one turn: a generator yields
the seconds until its next step. Clicks need the program's option --enable-event-simulate.
"""

import importlib
import json
import sys
import time
import traceback
from pathlib import Path

import bpy

folder = Path(sys.argv[sys.argv.index("--") + 1])
WAIT_S = 900.0  # ends a hang


def terrain():
    return next((item for item in bpy.data.objects if item.adaptive_terrain.enabled), None)


def parts(kind: str = "UI"):
    """Return the first window, its 3D viewport and one of the viewport's regions."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    return window, area, next(region for region in area.regions if region.type == kind)


def run(operator, *how, **asked):
    """Run an operator in the viewport."""
    window, area, region = parts("WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region, screen=window.screen):
        return operator(*how, **asked)


def until(condition, pause_s: float = 0.1):
    end = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("waited in vain")
        yield pause_s


def click(x: int, y: int):
    """Move the mouse, press and release the left button, one event a turn."""
    window = parts()[0]
    for kind, value in (("MOUSEMOVE", "NOTHING"), ("LEFTMOUSE", "PRESS"), ("LEFTMOUSE", "RELEASE")):
        window.event_simulate(type=kind, value=value, x=x, y=y)
        yield 0.2


def picture(moment: str):
    """Wait until the test has saved a picture of the screen."""
    (folder / moment).touch()
    yield from until((folder / f"{moment}_pictured").exists)


def only_open(panels, names: set[str]) -> None:
    """Close all panels of the sidebar except some; presets keep their place."""
    register, unregister = bpy.utils.register_classes_factory(panels.CLASSES)
    unregister()
    for cls in panels.CLASSES:
        cls.bl_options = set() if cls.bl_idname in names else {"DEFAULT_CLOSED"}
    register()


def module(name: str):
    """Import a module of the extension, such as "operators.jobs"."""
    package = bpy.types.Object.adaptive_terrain.keywords["type"].__module__.partition(".operators")[0]
    return importlib.import_module(f"{package}.{name}")


def show_tab():
    """Show the sidebar and wait until it has our tab: only a region that has been drawn knows its tabs."""

    def is_shown() -> bool:
        try:
            parts()[2].active_panel_category = "Terrain"
        except (AttributeError, TypeError):
            return False
        return True

    parts()[1].spaces.active.show_region_ui = True
    parts()[1].tag_redraw()
    yield from until(is_shown)
    parts()[1].tag_redraw()
    yield 1.0


def write_json(name: str, content: dict) -> None:
    """Write a file of the folder for the test, which reads it as soon as it exists: the last step is a rename."""
    (folder / f"{name}.part").write_text(json.dumps(content))
    (folder / f"{name}.part").rename(folder / name)


def take_steps(steps, report: dict, first_interval: float = 0.5, persistent: bool = False) -> None:
    """Take the steps one after the other, and write the report at their end or at their first error.

    persistent: whether the steps go on after another file is opened.
    """

    @module("operators.bridge.writing").allow_writing
    def turn():
        try:
            return next(steps)
        except StopIteration:
            pass
        except Exception:
            report["error"] = traceback.format_exc()
        write_json("done.json", report)
        return None

    bpy.app.timers.register(turn, first_interval=first_interval, persistent=persistent)
