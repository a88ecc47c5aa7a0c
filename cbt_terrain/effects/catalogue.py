# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect that there is. A new one is a file beside this one, and its name in this list."""

from . import (
    aspect,
    color,
    flow,
    height,
    layers,
    mean_curvature,
    normal,
    occlusion,
    plan_curvature,
    profile_curvature,
    sky,
    slope,
    splat,
    sun,
    wetness,
)
from .effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        height.HEIGHT,
        slope.SLOPE,
        aspect.ASPECT,
        mean_curvature.MEAN_CURVATURE,
        profile_curvature.PROFILE_CURVATURE,
        plan_curvature.PLAN_CURVATURE,
        normal.DETAIL_NORMAL,
        flow.FLOW,
        wetness.WETNESS,
        *splat.SPLATS,
        color.COLOR,
        sky.SKY,
        occlusion.OCCLUSION,
        sun.SUN,
        *layers.LAYERS,
    )
}
