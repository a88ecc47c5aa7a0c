# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of the command line's arguments: each gives argparse a value or the reason for refusing it."""

import argparse
import math
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, path_fault, shown
from ...cbt_terrain.view.settings import SETTINGS, CriterionSetting

MAX_INT = 2**31 - 1
MAX_ERROR_M = 1e9
METAVARS = {"px": "PX", "px²": "PX2", "m": "METRES", "°": "DEG"}  # by unit


def argparse_type(parse):
    """Wrap a parser for argparse, which shows the text of an ArgumentTypeError only: convert ValueError and
    TerrainError.
    """

    def checked(text: str):
        """Parse a text; argparse prints the error of a bad one."""
        try:
            return parse(text)
        except (ValueError, TerrainError) as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return checked


def positive(max_value: float):
    """Return a parser of numbers above 0 and up to `max_value`, for argparse."""

    def number(text: str) -> float:
        """Parse a number above 0, up to the limit."""
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} is not more than 0")
        if value > max_value:
            raise argparse.ArgumentTypeError(f"{text} is more than {max_value:g}")
        return value

    return number


def count(text: str) -> int:
    """Parse a whole number, 0 or more, that fits into Blender's 32 bits."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 0 <= value <= MAX_INT:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 and {MAX_INT:,}")
    return value


def count_from_one(text: str) -> int:
    """Parse a whole number, 1 or more, for argparse."""
    value = count(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def share(text: str) -> tuple[int, int]:
    """Parse a share as K/N, the K-th of N, for argparse."""
    number, _, parts = text.partition("/")
    found = count_from_one(number), count_from_one(parts)
    if found[0] > found[1]:
        raise argparse.ArgumentTypeError(f"{text} is not one of {found[1]} shares")
    return found


def path(text: str) -> Path:
    """Parse a path; an empty text would be the current folder."""
    return Path(path_text(text))


def path_text(text: str) -> str:
    """Return a path, or a name in place of one, unchanged, after a check that a file may have it."""
    if not text.strip():
        raise argparse.ArgumentTypeError("the name is empty")
    fault = path_fault(shown(text), text)
    if fault is not None:
        raise argparse.ArgumentTypeError(str(fault))
    return text


def pair(separator: str, kind, max_value: float):
    """Return a parser for argparse of two finite numbers above 0, such as 1920x1080.

    `separator`: text between the numbers. `kind`: int or float. `max_value`: upper limit of both.
    """

    def checked(text: str):
        """Parse "A<separator>B" as two numbers above 0."""
        try:
            first, second = (kind(part) for part in text.lower().split(separator))
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not two numbers with {separator!r} between") from None
        if not (first > 0 and second > 0):
            raise argparse.ArgumentTypeError(f"{text!r} is not two numbers above 0")
        if max(first, second) > max_value or math.inf in (first, second):
            raise argparse.ArgumentTypeError(f"{text!r} has a number above {max_value:g}")
        return first, second

    return checked


def parse_effects(text: str) -> tuple[str, ...] | None:
    """Parse names of attributes, with commas between; return each once.

    Returns () for `none`, and None for `auto`, which each verb explains. Raises ValueError for an unknown name.
    """
    from ...cbt_terrain.attributes.catalogue import ATTRIBUTES

    if text in ("auto", "none"):
        return None if text == "auto" else ()
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    for name in names:
        if name not in ATTRIBUTES:
            raise ValueError(f"{name!r} is no effect; expected some of {', '.join(ATTRIBUTES)}")
    return names


def add_settings(verb: argparse.ArgumentParser) -> None:
    """Add an option to a verb's parser for each criterion setting that declares one; None stands for one not given."""
    for setting in SETTINGS:
        if not setting.option:
            continue
        default = "off" if setting.is_flag else "no limit" if setting.default is None else f"{setting.default:g}"
        text = f"{setting.tooltip[0].lower()}{setting.tooltip[1:]} (the scene's, or {default})"
        about = {"dest": setting.name, "help": text}
        if setting.is_flag:
            verb.add_argument(setting.option, action=argparse.BooleanOptionalAction, **about)
        else:
            metavar = METAVARS.get(setting.unit, "N" if setting.whole else "F")
            verb.add_argument(setting.option, type=setting_value(setting), metavar=metavar, **about)


def setting_value(setting: CriterionSetting):
    """Return a parser for argparse of the numbers that a criterion's setting accepts."""

    def number(text: str) -> float:
        """Parse a number that the criterion's setting accepts."""
        try:
            value = int(text) if setting.whole else float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {setting.expected}") from None
        if not setting.accepts(value):
            raise argparse.ArgumentTypeError(f"{text} is not {setting.expected}")
        return value

    return number


def given_settings(arguments: argparse.Namespace) -> dict[str, float]:
    """Return the criterion's settings that were given on the command line, by the names of the settings.

    A flag stands for the setting's usual value, its negation for the default.
    """
    values = {setting.name: (setting, getattr(arguments, setting.name)) for setting in SETTINGS if setting.option}
    return {
        name: value if not setting.is_flag else setting.usual if value else setting.default
        for name, (setting, value) in values.items()
        if value is not None
    }
