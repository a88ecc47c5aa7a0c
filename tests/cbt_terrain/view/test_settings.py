# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of settings agrees with the class `Criterion`, which is written out for readers and type checkers."""

import dataclasses
import math

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.settings import CRITERIA, LIMITS, SETTINGS

RANGES = {
    "error_px": (0, 1e300),
    "edge_px": (0, 1e300),
    "area_px": (0, 1e300),
    "error_m": (0, 1e300),
    "guard_deg": (0, 1e300),
    "off_screen_factor": (1, math.inf),
    "hidden_factor": (1, math.inf),
    "shading_floor": (0, 1),
    "max_depth": (1, 2**31),
    "max_triangles": (0, 2**31 - 1),
    "meshlet": (0, 4),
    "morph": (1, 4),
}


def test_the_table_has_every_field_once_with_its_default():
    fields = {field.name: field.default for field in dataclasses.fields(Criterion)}
    assert {setting.name: setting.default for setting in SETTINGS} == fields
    assert len(SETTINGS) == len(fields)


def test_whole_numbers_and_limits_are_annotated_as_such():
    kinds = {field.name: field.type for field in dataclasses.fields(Criterion)}
    assert {s.name for s in SETTINGS if s.whole} == {name for name, kind in kinds.items() if kind is not float}
    assert {s.name for s in LIMITS} == {name for name, kind in kinds.items() if kind == int | None}


@pytest.mark.parametrize("name", RANGES)
def test_a_criterion_accepts_exactly_its_range(name):
    low, high = RANGES[name]
    more = {"edge_px": 1.0} if name == "error_px" else {}
    for value in (low, high):
        assert math.isfinite(getattr(Criterion(**{name: value}, **more), name)) or value == math.inf
    below = low - 1 if name in ("max_depth", "max_triangles", "meshlet") else low - 1e-9
    above = {math.inf: (), 2**31: ()}.get(high, (math.inf,) if high == 1e300 else (high + 1,))
    for wrong in (below, math.nan, *above):
        with pytest.raises(TerrainError, match=f"The criterion's {name} is .*; expected a") as caught:
            Criterion(**{name: wrong}, **more)
        assert str(caught.value).count(".") <= 3 and str(caught.value).endswith(".")


def test_a_usual_value_is_within_the_range():
    for setting in SETTINGS:
        for value in (setting.usual, setting.viewport, setting.render):
            assert value is None or setting.accepts(value), setting.name


def test_a_criterion_needs_a_request():
    off = {setting.name: 0.0 for setting in CRITERIA}
    with pytest.raises(TerrainError, match="Every criterion is 0: ask for an error"):
        Criterion(**off)
    for name in off:
        assert getattr(Criterion(**off | {name: 5.0}), name) == 5.0


def test_words_and_options_are_unique():
    for words in (
        [setting.label for setting in SETTINGS],
        [setting.option for setting in SETTINGS if setting.option],
        [setting.switch or setting.name for setting in SETTINGS],
    ):
        assert len(set(words)) == len(words)
