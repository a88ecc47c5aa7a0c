# SPDX-License-Identifier: GPL-3.0-or-later
"""The examples of all height operators hold."""

import pytest
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.examples import shape_with


@pytest.mark.parametrize("name", HEIGHT_OPERATORS)
def test_the_example_of_the_declaration_holds(name):
    HEIGHT_OPERATORS[name].example(shape_with)
