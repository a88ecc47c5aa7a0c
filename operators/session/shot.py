# SPDX-License-Identifier: GPL-3.0-or-later
"""The views of a terrain in all frames of a shot."""

from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import replace

import bpy
import numpy as np

from ...cbt_terrain.view.linear import inverse, product
from ...cbt_terrain.view.view import View
from ..terrain.request import RENDER, Request, gather
from .pauses import handlers_paused


def frames_of(scene) -> range:
    """Return the frames of a scene's render range, with its step."""
    return range(scene.frame_start, scene.frame_end + 1, scene.frame_step)


def visit_requests(obj, scene, frames: Iterable[int], **options) -> Iterator[Request]:
    """Step through frames, and yield after each the request of a render; the scene then returns to its frame.

    options: keyword arguments of `gather`, such as `camera` or `about_middle`. Raises TerrainError.
    """
    now = scene.frame_current, scene.frame_subframe
    try:
        for frame in frames:
            if frame != scene.frame_current:
                with handlers_paused():
                    scene.frame_set(frame)
            yield gather(obj, bpy.context.evaluated_depsgraph_get(), RENDER, **options)
    finally:
        with suppress(ReferenceError):  # undo or another file removed the scene between two steps
            if (scene.frame_current, scene.frame_subframe) != now:
                with handlers_paused():
                    scene.frame_set(now[0], subframe=now[1])


def visit_views(obj, scene, frames: Iterable[int], placement: np.ndarray, **options) -> Iterator[float | list[View]]:
    """Step through frames; yield after each a float, the fraction of the frames before it, and at the end the views.

    The last item is the list of all views of the terrain `obj`, as if it stayed at `placement`, float64 [4, 4]. The
    scene then returns to its frame. options: keyword arguments of `gather`, such as `camera`. Raises TerrainError.
    """
    views, frames = [], list(frames)
    with closing(visit_requests(obj, scene, frames, **options)) as requests:
        for number, request in enumerate(requests):
            views += [_move_view(view, request.placement, placement) for view in request.views]
            yield number / len(frames)
    yield views


def _move_view(view: View, placement: np.ndarray, target: np.ndarray) -> View:
    """Return the View that shows a terrain at `target` as `view` shows it at `placement`, both float64 [4, 4]."""
    if np.array_equal(placement, target):
        return view
    return replace(view, world_to_camera=product(product(view.world_to_camera, placement), inverse(target)))
