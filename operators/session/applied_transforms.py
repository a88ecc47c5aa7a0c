# SPDX-License-Identifier: GPL-3.0-or-later
"""Take back an Apply or a Set Origin of a terrain: an update would write its mesh anew, and the terrain would jump."""

import bpy

from ..bridge import popup
from ..bridge.applied import is_as_placed, take_back
from ..text.console import print_line
from . import session


def take_back_changed(depsgraph) -> None:
    """Take back an Apply or a Set Origin of the terrains that a dependency graph reports as changed."""
    changed = [update.id.original for update in depsgraph.updates if isinstance(update.id, bpy.types.Object)]
    take_back_of([obj for obj in dict.fromkeys(changed) if session.is_terrain(obj)])


def take_back_of(terrains: list) -> None:
    """Take back an Apply or a Set Origin of terrains, and report it; let the next update replace other edits.

    Those would else stay while the view is the same, if they move vertices only.
    """
    lines = []
    for obj in terrains:
        record = session.record_of(obj)
        before = record.placed.get(len(obj.data.vertices))
        if obj.mode != "OBJECT" or before is None or is_as_placed(obj, before):
            continue
        record.shown = record.postponed_normals = record.live_key = None
        if take_back(obj, before):
            lines.append(
                f"{obj.name} keeps its transform and its origin: its mesh is computed anew for each view. "
                "Bake Static Mesh gives a mesh to which you can apply them."
            )
    for line in lines:
        print_line(f"Adaptive Terrain: {line}")
    popup.show_soon(lines)
