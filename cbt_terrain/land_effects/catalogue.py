# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of all height operators. A new one is a file in this folder and an entry in this list."""

from .droplets import DROPLETS
from .flood import FLOOD
from .land_effect import LandEffect
from .relief import RELIEF
from .rivers import RIVERS
from .snow import SNOW
from .thermal import THERMAL
from .water import WATER

# In the usual order of a stack.
LAND_EFFECTS: dict[str, LandEffect] = {
    effect.name: effect for effect in (RIVERS, THERMAL, DROPLETS, RELIEF, WATER, FLOOD, SNOW)
}
