# SPDX-License-Identifier: GPL-3.0-or-later
"""The labels in Blender's languages, as the real program translates them."""

import json

import pytest
from adaptive_terrain.operators.text.translations import LANGUAGES
from ui_labels import LEFT_TO_BLENDER

OURS = ("Set Up Scene", "Terrain Material", "Import Options", "Add Scatter", "Camera underground")


@pytest.fixture(scope="module")
def translated(program, tmp_path_factory):
    path = tmp_path_factory.mktemp("translations") / "labels.json"
    labels = {locale: [*table, *LEFT_TO_BLENDER] for locale, table in LANGUAGES.items()}
    path.write_text(json.dumps(labels), "utf-8")
    found = program.script("translate_labels.py", path)
    if not found["locales"]:
        pytest.skip("the program has no languages: unpack it anew with tools/get_blender.sh")
    return found


@pytest.mark.parametrize("locale", LANGUAGES)
def test_the_program_shows_our_translations(translated, locale):
    assert locale in translated["locales"]
    shown = translated[locale]
    assert [shown[label] for label in OURS] == [[LANGUAGES[locale][label]] * 2 for label in OURS]
    untranslated = [label for label, text in LANGUAGES[locale].items() if shown[label] == [label] * 2 != [text] * 2]
    assert untranslated == [], "Blender's own translation or ours is shown"


@pytest.mark.parametrize("locale", ["ja_JP", "zh_HANS"])
def test_the_program_translates_the_labels_left_to_it(translated, locale):
    """German, French and Spanish share words with English, so that equality is no sign there."""
    assert [label for label in sorted(LEFT_TO_BLENDER) if translated[locale][label][0] == label] == []
