# SPDX-License-Identifier: GPL-3.0-or-later
"""Every effect that there is. A new one is a file beside this one, and its name in this list."""

from . import flow, slope
from .effect import Effect

EFFECTS: dict[str, Effect] = {effect.name: effect for effect in (slope.SLOPE, flow.FLOW)}
