# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects of the tests' own in the catalogue."""

import pytest
from adaptive_terrain.cbt_terrain.land_effects.catalogue import LAND_EFFECTS
from land_effects import OWN


@pytest.fixture
def own_effects(monkeypatch):
    """The catalogue with the effects of land_effects.py."""
    for name, effect in OWN.items():
        monkeypatch.setitem(LAND_EFFECTS, name, effect)
    return OWN
