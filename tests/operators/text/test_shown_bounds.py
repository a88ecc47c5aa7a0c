# SPDX-License-Identifier: GPL-3.0-or-later
"""Shown bounds are never below the bounds."""

import math

import pytest
from adaptive_terrain.operators.text.shown_bounds import LIMITS, NO_BOUND, bound_text, limit_text
from hypothesis import given
from hypothesis import strategies as st


@given(st.floats(1e-30, 1e29), st.sampled_from([3, 4]))
def test_a_bound_is_never_shown_smaller_nor_much_larger(bound, digits):
    shown = float(bound_text(bound, "px", digits).removesuffix(" px").replace(",", ""))
    assert bound <= shown <= bound * (1 + 1.001 * 10.0 ** (1 - digits))


@pytest.mark.parametrize(
    ("bound", "shown"),
    [
        (0.0, "0 px"),
        (0.1, "0.1 px"),
        (0.99999, "1 px"),
        (0.9971, "0.998 px"),
        (1.0, "1 px"),
        (99.91, "100 px"),
        (100.1, "101 px"),
        (12345.6, "12,346 px"),
    ],
)
def test_three_digits_and_all_before_the_point(bound, shown):
    assert bound_text(bound, "px") == shown


@pytest.mark.parametrize("bound", [1e30, math.inf, math.nan])
def test_no_bound_is_shown_in_words(bound):
    assert bound_text(bound, "px") == NO_BOUND


def test_limits_are_shown_in_words():
    assert limit_text("max_depth", "precision") == "the depth limit and float32 precision"
    assert limit_text("source") == "source rounding"
    assert limit_text("") == "" and limit_text("precision") == LIMITS["precision"]
