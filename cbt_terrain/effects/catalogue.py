# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect that there is. A new one is a file beside this one, and its name in this list; what one
function makes together is one file."""

from . import color, flow, jet, layers, occlusion, sky, splat, sun, wetness
from .effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        *jet.JETS,
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
