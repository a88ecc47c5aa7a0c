# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue of height operators with those of the tests."""

import pytest
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from land_effects import OWN


@pytest.fixture(autouse=True)
def own_effects(monkeypatch):
    """Add the operators of land_effects.py to the catalogue."""
    for name, effect in OWN.items():
        monkeypatch.setitem(HEIGHT_OPERATORS, name, effect)
