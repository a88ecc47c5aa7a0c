# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels in Blender's languages: a module per language with its table, from the English label to the translation.

A label without an entry is one that Blender itself translates. Blender's own translation always comes first. Draw code
writes labels with values as `phrase(template, ...)`.
"""

import bpy

from . import chinese, french, german, japanese, spanish

LANGUAGES = {
    "de_DE": german.LABELS,
    "fr_FR": french.LABELS,
    "es": spanish.LABELS,
    "ja_JP": japanese.LABELS,
    "zh_HANS": chinese.LABELS,
}
CONTEXTS = ("*", "Operator")  # of properties, panels and menus; of operators and their buttons


def phrase(template: str, *values: object) -> str:
    """Return a label with values in its `{}`, in the language of the interface.

    Blender translates a drawn text only as a whole, so that one with numbers in it must be translated before.
    """
    text = bpy.app.translations.pgettext_iface(template)
    return text.format(*values) if values else text


def start() -> None:
    """Register the translations of all labels with Blender."""
    tables = {
        locale: {(context, label): text for label, text in labels.items() for context in CONTEXTS}
        for locale, labels in LANGUAGES.items()
    }
    bpy.app.translations.register(__package__, tables)


def stop() -> None:
    """Unregister the translations of the interface."""
    bpy.app.translations.unregister(__package__)
