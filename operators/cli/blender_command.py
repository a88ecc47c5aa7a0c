# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line inside Blender: `blender --command adaptive_terrain VERB`."""

import atexit

import bpy

from . import command_line

COMMAND = "adaptive_terrain"
_commands = []


def register() -> None:
    """Register the command `blender --command adaptive_terrain`."""
    _commands.append(bpy.utils.register_cli_command(COMMAND, command_line.main))
    if not bpy.app.binary_path:
        atexit.register(unregister)  # as a module Blender crashes at exit if it finds Python's registrations


def unregister() -> None:
    """Remove the command from Blender's command line."""
    atexit.unregister(unregister)
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
