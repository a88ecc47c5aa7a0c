# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrains whose store is incomplete: a render waits for its tiles, or reports them; packing refuses them."""

from ...cbt_terrain.errors import TerrainError
from .. import jobs
from ..land import render_wait
from ..session import stale_renders
from ..text.console import print_line
from ..text.translations import phrase
from . import view_tiles
from .imported import loaded_text


def wait_for_imports(terrains: list, depsgraph) -> list[TerrainError]:
    """Wait before a render until the tiles that it sees are loaded; if it needs finer ones, until imports are complete.

    depsgraph: the render's. Return the error of a wait that the user ended with Esc, [] if there was none.
    """
    for obj in terrains:
        job = jobs.find(jobs.IMPORT, obj)
        is_seen = obj.evaluated_get(depsgraph).is_evaluated
        # loaded_text is "" for a complete store, which a running import only replaces.
        if is_seen and job is not None and job.child is not None and loaded_text(obj.adaptive_terrain):
            try:
                loader = view_tiles.loader_of(obj)
                if loader is None or not loader.wait_for(obj, depsgraph):
                    render_wait.wait_for_import(job.child)
            except TerrainError as error:
                return [error]
    return []


def note_incomplete(scene, terrains: list) -> None:
    """Report in the summary of a render, and on the console, the detail of incomplete terrains that it shows.

    Call it after each frame's update. While an import runs, the summary does not propose to load the rest.
    """
    for obj in terrains:
        text = loaded_text(obj.adaptive_terrain)
        if text and not obj.hide_render:
            print_line(f"Adaptive Terrain: frame {scene.frame_current}, {obj.name}: {text}")
            rest = "" if jobs.find(jobs.IMPORT, obj) else f". {phrase('Load All imports the rest')}"
            stale_renders.add_message(f"{obj.name}: {text}{rest}")


def check_complete(obj, remedy: str) -> None:
    """Raise TerrainError if the store of a terrain to be packed is incomplete. remedy: the instruction of the error."""
    text = loaded_text(obj.adaptive_terrain)
    if text:
        what = f"The store of {obj.name!r} is incomplete ({text[0].lower()}{text[1:]})"
        raise TerrainError(what, expected="all samples of its source", fix=remedy)
