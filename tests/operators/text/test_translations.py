# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels in Blender's languages are complete; tests/blender/test_translations.py sees them in the real program."""

import pytest
from adaptive_terrain.operators.blender import need_bpy
from adaptive_terrain.operators.text import translations
from ui_labels import LEFT_TO_BLENDER, UNTRANSLATED, collect_labels, drawn_f_strings


@pytest.fixture(scope="module")
def labels():
    need_bpy("the test")
    return collect_labels()


@pytest.mark.parametrize("locale", translations.LANGUAGES)
def test_every_label_is_translated(labels, locale):
    done = translations.LANGUAGES[locale].keys() | LEFT_TO_BLENDER | UNTRANSLATED
    missing = [f"{label!r} ({place})" for label, place in sorted(labels.items()) if label not in done]
    assert not missing, f"add to the {locale} table in operators/text/translations: {', '.join(missing)}"


def test_labels_with_values_in_them_are_translated():
    assert drawn_f_strings() == [], "draw `phrase(template, values)` instead"


@pytest.mark.parametrize("locale", translations.LANGUAGES)
def test_no_translation_is_unused(labels, locale):
    unused = sorted(translations.LANGUAGES[locale].keys() - labels.keys())
    assert not unused, f"remove from the {locale} table in operators/text/translations: {', '.join(map(repr, unused))}"


def test_no_label_is_listed_twice_or_needlessly(labels):
    assert not LEFT_TO_BLENDER & UNTRANSLATED
    assert sorted((LEFT_TO_BLENDER | UNTRANSLATED) - labels.keys()) == []
    for table in translations.LANGUAGES.values():
        assert sorted(table.keys() & (LEFT_TO_BLENDER | UNTRANSLATED)) == []


@pytest.mark.parametrize("locale", translations.LANGUAGES)
def test_translations_keep_placeholders_and_units(locale):
    for label, text in translations.LANGUAGES[locale].items():
        assert text == text.strip() and text.count("{}") == label.count("{}"), label
        for unit in ("(px)", "(px²)", "(m)", "(°)", "(ms)", "(K)", "(mm/h)"):
            assert (unit in text) == (unit in label), label


@pytest.mark.parametrize("locale, letters", [("ja_JP", "\u3040-\u9fff"), ("zh_HANS", "\u4e00-\u9fff")])
def test_tables_are_written_in_their_script(locale, letters):
    first, last = letters.split("-")
    for label, text in translations.LANGUAGES[locale].items():
        assert any(first <= letter <= last for letter in text), label
