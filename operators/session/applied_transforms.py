# SPDX-License-Identifier: GPL-3.0-or-later
"""Take back an Apply or a Set Origin of a terrain: an update would write its mesh anew, and the terrain would jump.

Other edits of its mesh are reported before an update replaces them.
"""

import bpy

from ..bridge import popup
from ..bridge.applied import Placed, is_as_placed, remember, take_back
from ..text.console import print_line
from . import session


def take_back_changed(depsgraph) -> None:
    """Take back an Apply or a Set Origin of the terrains that a dependency graph reports as changed.

    Report meshes that were edited: the next update replaces them.
    """
    changed = [update.id.original for update in depsgraph.updates if isinstance(update.id, bpy.types.Object)]
    terrains = [obj for obj in dict.fromkeys(changed) if session.is_terrain(obj) and obj.mode == "OBJECT"]
    _report(
        f"The mesh of {obj.name} was edited, and its next update replaces it. Ctrl Z takes that back, and Bake Static "
        "Mesh gives a mesh to edit or to join."
        for obj in terrains
        if 0 < len(session.record_of(obj).placed) and _written(obj) is None
    )
    take_back_of(terrains)


def take_back_of(terrains: list) -> None:
    """Take back an Apply or a Set Origin of terrains, and report it; let the next update replace other edits.

    Those would else stay while the view is the same, if they move vertices only.
    """
    restored = []
    for obj in terrains:
        record, before = session.record_of(obj), _written(obj)
        if before is None:
            remember(record.placed, obj)
        elif obj.mode == "OBJECT" and not is_as_placed(obj, before):
            record.shown = record.postponed_normals = record.live_key = None
            restored += [obj] if take_back(obj, before) else []
    _report(
        f"{obj.name} keeps its transform and its origin: its mesh is computed anew for each view. Bake Static Mesh "
        "gives a mesh to which you can apply them."
        for obj in restored
    )


def _written(obj) -> Placed | None:
    """Return the last written mesh with as many vertices as a terrain's mesh, None without one."""
    return session.record_of(obj).placed.get(len(obj.data.vertices))


def _report(lines) -> None:
    """Print lines, and show them in the window."""
    lines = list(lines)
    for line in lines:
        print_line(f"Adaptive Terrain: {line}")
    popup.show_soon(lines)
