# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operator, property and enum item that users see has a tooltip, in Blender's form and in plain words."""

import re

import pytest
from adaptive_terrain.operators.blender import need_bpy
from ui_labels import collect_tooltips

MAX_SENTENCES, MAX_LENGTH = 3, 260
# Rows that no panel names, and properties that Blender's own classes bring.
WITHOUT = re.compile(r"\.(active|active_layer|align|location|rotation|filepath)$|^CancelJob\.")
# Words that only papers and the code use.
PRIVATE = re.compile(
    r"\b(splat|lattice|bisect\w*|diamond|stack|halo|digest|meshlets?|effects on heights|samples a side|thereof|whereto|"
    r"nowhere|none the less|no longer|what (is|lies|stays|of)|so far|so many|laid down|lay down)\b",
    re.IGNORECASE,
)


@pytest.fixture(scope="module")
def tooltips():
    need_bpy("the test")
    found = collect_tooltips()
    assert len(found) > 400
    return {place: text for place, text in found.items() if text or not WITHOUT.search(place)}


def test_everything_that_users_see_has_a_tooltip(tooltips):
    assert [place for place, text in tooltips.items() if not text] == []


def test_tooltips_are_short_and_end_without_a_full_stop(tooltips):
    for place, text in tooltips.items():
        text = " ".join(text.split())
        assert text[0].isupper() or not text[0].isalpha(), f"{place}: {text}"
        assert not text.endswith((".", ":", ";")), f"{place}: {text}"
        assert len(text) <= MAX_LENGTH and len(re.findall(r"\. [A-Z]", text)) < MAX_SENTENCES, f"{place}: {text}"


def test_tooltips_have_no_private_words(tooltips):
    assert {place: text for place, text in tooltips.items() if PRIVATE.search(text)} == {}
