# SPDX-License-Identifier: GPL-3.0-or-later
"""Adapting a stack to other land: heights move with the land, other values stay."""

import math

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators.fitted import fitted
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.stack import (
    Entry,
    Stack,
    read_stack,
    stack_content,
    stack_from,
    write_stack,
)

RULES = (GroundRule("height", 600.0, edge=100.0), GroundRule("slope", high=45.0, edge=10.0))
MADE = Stack(
    (
        Entry("rivers", {"rise": 4e-4, "years": 1e6}, seed=2, mask=HeightMask("", RULES, 0.5)),
        Entry("snow", {"line": 800.0, "fall": 4.0}),
        Entry("snow"),
    ),
    (200.0, 1200.0),
)


def test_heights_keep_their_fraction_of_the_relief():
    """From 200 - 1200 m to 1000 - 1500 m: half the relief."""
    rivers, snow, plain = fitted(MADE, 1000.0, 1500.0).entries
    assert rivers.parameters == {"rise": 2e-4, "years": 1e6} and rivers.seed == 2 and rivers.mask.factor == 0.5
    height, slope = rivers.mask.rules
    assert (height.low, height.high, height.edge) == (1200.0, math.inf, 50.0) and slope == RULES[1]
    assert snow.parameters == {"line": 1300.0, "fall": 4.0} and plain.parameters == {}


def test_the_foot_of_land_in_the_sea_is_the_sea():
    assert fitted(MADE, -300.0, 2000.0).entries[1].parameters["line"] == 1200.0
    assert fitted(MADE, -900.0, -400.0).entries[1].parameters["line"] == -600.0, "all of it is below 0"


def test_values_stay_in_range_and_flat_land_changes_nothing():
    assert fitted(MADE, 0.0, 9e4).entries[0].parameters["rise"] == 0.02
    assert fitted(MADE, 5.0, 5.5) is MADE and fitted(Stack(MADE.entries), 0.0, 500.0) == Stack(MADE.entries)


def test_a_file_keeps_the_heights_and_wrong_ones_are_refused(tmp_path):
    write_stack(MADE, tmp_path / "made.json")
    assert read_stack(tmp_path / "made.json") == MADE
    for right in ([19_999, 20_000], [-12_000, -11_999]):
        assert stack_from(stack_content(MADE) | {"heights": right}).heights == tuple(right)
    for wrong in ([0], [5, 5], [0, "1"], [True, 900], [0, float("nan")], [-1e9, 10], [0, 20_001], [-12_001, 10], 7):
        with pytest.raises(TerrainError, match="expected the land's lowest and highest height in metres"):
            stack_from(stack_content(MADE) | {"heights": wrong})
