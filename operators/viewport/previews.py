# SPDX-License-Identifier: GPL-3.0-or-later
"""What a viewport shows of effects that take long: a preview at once, and when it rests what a render computes."""

from dataclasses import replace

from ...cbt_terrain.effects import sky, sky_layer
from ...cbt_terrain.effects.effect import Asked
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.run import launch
from ..request.request import Request


def begun(request: Request, heights: HeightField) -> Request:
    """The request with previews in place of what is not known yet; the same one if there is nothing of the kind."""
    names = [item.name for item in request.effects.asked]
    if sky.SKY.name not in names or sky_layer.is_known(heights, request.vertical_scale):
        return request
    asked = tuple(_preview(item) if item.name == sky.SKY.name else item for item in request.effects.asked)
    return replace(request, effects=replace(request.effects, asked=asked))


def refine(request: Request, heights: HeightField) -> bool:
    """One step of what can be made ahead for the request in full; returns whether none is left."""
    return sky_layer.advance(heights, request.vertical_scale, launch.default_threads())


def _preview(item: Asked) -> Asked:
    return replace(item, parameters=tuple(sorted((dict(item.parameters) | {"quality": sky.PREVIEW}).items())))
