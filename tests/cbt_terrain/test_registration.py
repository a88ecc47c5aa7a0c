# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of attributes and height operators from outside."""

from dataclasses import replace

import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES, register_attribute, unregister_attribute
from adaptive_terrain.cbt_terrain.attributes.plan import kernels_of_steps, plan
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators.catalogue import (
    HEIGHT_OPERATORS,
    register_height_operator,
    unregister_height_operator,
)
from adaptive_terrain.cbt_terrain.height_operators.prepare import kernels_of
from adaptive_terrain.cbt_terrain.height_operators.stack import stack_from
from adaptive_terrain.cbt_terrain.run.warmup import import_kernels


def test_a_registered_attribute_is_planned_with_its_kernels():
    register_attribute(replace(ATTRIBUTES["wetness"], name="damp"))
    try:
        steps = plan([AttributeRequest("damp", ("a test",))])
        assert steps.steps[-1].name == "damp"
        assert set(import_kernels(ATTRIBUTES["damp"].kernels)) <= set(kernels_of_steps(steps))
    finally:
        unregister_attribute("damp")
    assert "damp" not in ATTRIBUTES


def test_a_registered_height_operator_stands_in_stacks():
    register_height_operator(replace(HEIGHT_OPERATORS["scree"], name="slide"))
    try:
        stack = stack_from({"version": 1, "entries": [{"effect": "slide"}]})
        assert kernels_of(stack) == import_kernels(HEIGHT_OPERATORS["scree"].kernels)
    finally:
        unregister_height_operator("slide")
    with pytest.raises(TerrainError, match="slide"):
        stack_from({"version": 1, "entries": [{"effect": "slide"}]})


@pytest.mark.parametrize("name", ["wetness", "scree", "two words", "Upper"])
def test_a_taken_or_invalid_name_is_an_error(name):
    before = list(ATTRIBUTES), list(HEIGHT_OPERATORS)
    if name != "scree":
        with pytest.raises(TerrainError, match=name):
            register_attribute(replace(ATTRIBUTES["flow"], name=name))
    if name != "wetness":
        with pytest.raises(TerrainError, match=name):
            register_height_operator(replace(HEIGHT_OPERATORS["flood"], name=name))
    assert before == (list(ATTRIBUTES), list(HEIGHT_OPERATORS))


def test_an_attribute_that_reads_an_unknown_one_is_an_error():
    with pytest.raises(TerrainError, match="reads 'nowhere', which is not registered"):
        register_attribute(replace(ATTRIBUTES["wetness"], name="damp", reads=("nowhere",)))
