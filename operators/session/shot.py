# SPDX-License-Identifier: GPL-3.0-or-later
"""The views of a terrain in all frames of a shot."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np

from ...cbt_terrain.view.linear import inverse, product
from ...cbt_terrain.view.view import View
from ..terrain.request import RENDER, gather
from .pauses import paused


def frames_of(scene) -> range:
    """Return the frames of a scene's render range."""
    return range(scene.frame_start, scene.frame_end + 1)


def visit_views(obj, scene, frames: Iterable[int], placement: np.ndarray, **look) -> Iterator[float | list[View]]:
    """Step through frames; yield the fraction done after each, and at the end the list of all views of the terrain
    `obj`.

    The views are relative to a terrain that stays at `placement`, float64 [4, 4]. The scene then returns to its
    frame. look: `criterion`, `camera`, `resolution` or `overrides` in place of those of the scene. Raises TerrainError.
    """
    views, now, frames = [], (scene.frame_current, scene.frame_subframe), list(frames)
    try:
        for number, frame in enumerate(frames):
            if frame != scene.frame_current:
                with paused():
                    scene.frame_set(frame)
            moved = gather(obj, bpy.context.evaluated_depsgraph_get(), RENDER, **look)
            views += [_move_view(view, moved.placement, placement) for view in moved.views]
            yield number / len(frames)
    finally:
        with suppress(ReferenceError):  # undo or another file removed the scene between two steps
            if (scene.frame_current, scene.frame_subframe) != now:
                with paused():
                    scene.frame_set(now[0], subframe=now[1])
    yield views


def _move_view(view: View, placement: np.ndarray, first: np.ndarray) -> View:
    """Convert a view of a terrain at `placement` to the same view of the terrain at `first`, float64 [4, 4] both."""
    if np.array_equal(placement, first):
        return view
    return replace(view, world_to_camera=product(product(view.world_to_camera, placement), inverse(first)))
