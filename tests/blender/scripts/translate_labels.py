# SPDX-License-Identifier: GPL-3.0-or-later
"""Translate the labels of a JSON file, {locale: labels}, in the contexts of properties and operators."""

import json
import sys
from pathlib import Path

import bpy

view, translations = bpy.context.preferences.view, bpy.app.translations
result = {"locales": translations.locales}
for locale, labels in json.loads(Path(sys.argv[-1]).read_text("utf-8")).items():
    if locale in translations.locales:
        view.language, view.use_translate_interface = locale, True
        result[locale] = {
            label: [translations.pgettext_iface(label, context) for context in ("*", "Operator")] for label in labels
        }
print("RESULT " + json.dumps(result))
