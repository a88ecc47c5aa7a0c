# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect that there is. A new one is a file beside this one, and its name in this list."""

from . import aspect, color, curvature, flow, height, layers, normal, occlusion, sky, slope, splat, sun, wetness
from .effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        height.HEIGHT,
        slope.SLOPE,
        aspect.ASPECT,
        curvature.MEAN_CURVATURE,
        curvature.PROFILE_CURVATURE,
        curvature.PLAN_CURVATURE,
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
