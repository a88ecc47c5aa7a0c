# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive Terrain: a terrain of any size at exactly the detail that the camera can see, as an ordinary Blender mesh.

The repository's root is this package. Blender calls `register` and `unregister`; nothing here imports bpy before that,
so that the engine runs, tests and benchmarks without Blender.
"""

__version__ = "0.1.0"


def register() -> None:
    """Add properties, panels, operators, handlers and the command to Blender."""
    from .operators import registration
    from .operators.cli import blender_command

    registration.register()
    blender_command.register()


def unregister() -> None:
    """Take off everything that `register` added."""
    from .operators import registration
    from .operators.cli import blender_command

    blender_command.unregister()
    registration.unregister()
