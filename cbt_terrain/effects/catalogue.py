# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of all attributes. A new one is a file in this folder and an entry in this list."""

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
