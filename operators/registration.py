# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the extension adds to Blender, and its removal in reverse order."""

import atexit

import bpy

from . import (
    add_terrain,
    bake_terrain,
    command_line,
    export_terrain,
    frame_terrain,
    freed_memory,
    handlers,
    import_terrain,
    live,
    measure_accuracy,
    measuring,
    overlay_panel,
    pack_store,
    panels,
    properties,
    session,
    status_bar,
    status_row,
    sweep_accuracy,
    update_terrain,
)

COMMAND = "adaptive_terrain"
MODULES = (
    properties,
    import_terrain,
    add_terrain,
    frame_terrain,
    pack_store,
    update_terrain,
    bake_terrain,
    export_terrain,
    measuring,
    measure_accuracy,
    sweep_accuracy,
    overlay_panel,
    status_row,
    panels,
    handlers,
    live,
    status_bar,
)
_commands = []


def register() -> None:
    for module in MODULES:
        module.register()
    if hasattr(bpy.utils, "register_cli_command"):
        _commands.append(bpy.utils.register_cli_command(COMMAND, command_line.main))
    if not bpy.app.binary_path:
        atexit.register(unregister)  # as a module Blender crashes at exit if it finds Python's classes registered


def unregister() -> None:
    atexit.unregister(unregister)
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for module in reversed(MODULES):
        module.unregister()
    session.clear()
    freed_memory.unregister()
