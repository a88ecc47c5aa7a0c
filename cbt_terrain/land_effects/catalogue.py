# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect on heights that there is. A new one is a file beside this one, and its name in this list."""

from .droplets import DROPLETS
from .flood import FLOOD
from .land_effect import LandEffect
from .relief import RELIEF
from .rivers import RIVERS
from .snow import SNOW
from .thermal import THERMAL
from .water import WATER

# In the order in which a stack usually has them.
LAND_EFFECTS: dict[str, LandEffect] = {
    effect.name: effect for effect in (RIVERS, THERMAL, DROPLETS, RELIEF, WATER, FLOOD, SNOW)
}
