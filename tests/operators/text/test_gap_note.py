# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences about land that mostly consists of gaps."""

from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_terrain.operators.text.gap_note import gap_note, gap_percent, missing_text


@pytest.mark.parametrize(
    ("filled", "valid", "expected"),
    [
        (0, None, ""),
        (999, None, ""),
        (2500, None, ". 25 % of its rectangle is gaps without data, filled from the nearest heights"),
        (9555, 1, ". 95.55 % of its rectangle is holes"),
    ],
)
def test_a_note_names_gaps_from_a_tenth_on(filled, valid, expected):
    assert gap_note(SimpleNamespace(filled=filled, valid=valid, samples=np.zeros((100, 100)))) == expected


def test_many_missing_samples_are_a_percentage():
    assert missing_text(9_999, 100_000) == "9,999" and missing_text(10_000, 100_000) == "10 %"


def test_a_percentage_of_gaps_is_below_100():
    assert gap_percent(99.99999) == "99.99 %" and gap_percent(12.3456) == "12.35 %"
