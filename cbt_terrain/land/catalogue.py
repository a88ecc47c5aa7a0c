# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect on heights that there is. A new one is a file beside this one, and its name in this list."""

from .land_effect import LandEffect
from .thermal import THERMAL

LAND_EFFECTS: dict[str, LandEffect] = {effect.name: effect for effect in (THERMAL,)}
