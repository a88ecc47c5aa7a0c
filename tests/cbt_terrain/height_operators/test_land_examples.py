# SPDX-License-Identifier: GPL-3.0-or-later
"""The examples of all height operators hold."""

import pytest
from adaptive_terrain.cbt_terrain.height_operators.catalogue import LAND_EFFECTS
from adaptive_terrain.cbt_terrain.height_operators.examples import shape_with


@pytest.mark.parametrize("name", LAND_EFFECTS)
def test_the_example_of_the_declaration_holds(name):
    LAND_EFFECTS[name].example(shape_with)
