# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers have no powers of ten, and lengths have suitable units."""

import pytest
from adaptive_terrain.operators.text.numbers import length_text, plain, time_text


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (100.0, 2, "100"),
        (99.96, 3, "100"),
        (1234567.0, 3, "1,234,567"),
        (0.25, 2, "0.25"),
        (0.0, 3, "0"),
        (5.6e-6, 2, "< 0.001"),
        (-0.404298, 4, "-0.4043"),
        (float("inf"), 3, "inf"),
    ],
)
def test_plain_numbers(value, digits, text):
    assert plain(value, digits) == text


def test_lengths():
    lengths = (31_902.0, 20.0, 999.9, 0.25, 0.0195, 0.0)
    assert [length_text(m) for m in lengths] == ["31.9 km", "20 m", "1,000 m", "0.25 m", "19.5 mm", "0 m"]


def test_a_time_that_rounds_to_a_second_is_in_seconds():
    assert [time_text(ms) for ms in (999.0, 999.6, 1000.0)] == ["999 ms", "1 s", "1 s"]
