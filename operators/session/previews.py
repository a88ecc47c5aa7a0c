# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews of slow effects in a viewport, refined to the values of a render while it rests."""

from dataclasses import replace

from ...cbt_terrain.attributes import sky, sky_layer
from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.run import launch
from ..terrain.request import Request


def with_previews(request: Request, heights: HeightField) -> Request:
    """Return the request with previews in place of slow attributes that have no cached value yet.

    It is the same object if none is needed. heights: the request's height field.
    """
    names = [item.name for item in request.effects.requests]
    if sky.SKY.name not in names or sky_layer.is_known(heights, request.vertical_scale):
        return request
    items = tuple(_preview(item) if item.name == sky.SKY.name else item for item in request.effects.requests)
    return replace(request, effects=replace(request.effects, requests=items))


def refine(request: Request, heights: HeightField) -> bool:
    """Compute one step of the slow attributes of a request without previews, and return whether all are done.

    The sky is the only slow attribute.
    """
    return sky_layer.advance(heights, request.vertical_scale, launch.default_threads())


def _preview(item: AttributeRequest) -> AttributeRequest:
    """Return a request for the preview quality of an attribute."""
    return replace(item, parameters=tuple(sorted((dict(item.parameters) | {"quality": sky.PREVIEW}).items())))
