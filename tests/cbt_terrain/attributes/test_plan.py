# SPDX-License-Identifier: GPL-3.0-or-later
"""Plans: from the attributes that are read to the functions that run."""

import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import GEOMETRY, PICTURE, AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.plan import NOTHING_READS_IT, plan
from adaptive_terrain.cbt_terrain.errors import TerrainError


def test_two_requests_merge_and_geometry_decides_the_scale():
    made = plan(
        [AttributeRequest("slope", ("material Rock",)), AttributeRequest("slope", ("modifier Trees",), GEOMETRY)]
    )
    assert made.steps == (AttributeRequest("slope", ("material Rock", "modifier Trees"), GEOMETRY),)
    assert plan([AttributeRequest("slope", ("material Rock",))]).steps[0].family == PICTURE


def test_what_is_not_run_says_why_and_foreign_names_are_left_out():
    made = plan([AttributeRequest("slope", ("material Rock",)), AttributeRequest("Col", ("material Rock",))])
    assert made.attributes == ("slope",) and made.skipped["aspect"] == NOTHING_READS_IT
    assert "slope" not in made.skipped and plan([]).steps == ()


def test_a_parameter_that_there_is_not_is_one_sentence():
    with pytest.raises(TerrainError, match="The effect 'slope' has no parameter 'sharpness'"):
        plan([AttributeRequest("slope", ("x",), parameters=(("sharpness", 2.0),))])
