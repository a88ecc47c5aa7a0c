# SPDX-License-Identifier: GPL-3.0-or-later
"""Every declaration is complete, and its example holds."""

import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.examples import evaluate_on


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_the_example_of_a_declaration_holds(name):
    ATTRIBUTES[name].example(evaluate_on)


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_a_declaration_is_complete(name):
    effect = ATTRIBUTES[name]
    assert effect.about and effect.source and effect.cost_ns > 0
    assert set(effect.reads) <= set(ATTRIBUTES) - {name}
    for parameter in effect.parameters:
        assert parameter.about
