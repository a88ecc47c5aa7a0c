# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line takes as an argument: each of these gives argparse a value or the reason why not."""

import argparse
import math
from pathlib import Path

from ...cbt_terrain.errors import path_fault, shown

MAX_INT = 2**31 - 1


def argument(parse):
    """Let argparse show what a parser's ValueError says."""

    def checked(text: str):
        try:
            return parse(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return checked


def positive(most: float):
    """A number above 0, at most `most`."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} is not more than 0")
        if value > most:
            raise argparse.ArgumentTypeError(f"{text} is more than {most:g}")
        return value

    return number


def part(text: str) -> float:
    """A part of a whole."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 and 1")
    return value


def count(text: str) -> int:
    """A number of things that Blender can hold."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 0 <= value <= MAX_INT:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 and {MAX_INT:,}")
    return value


def some(text: str) -> int:
    """A number of things of which there has to be one."""
    value = count(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def path(text: str) -> Path:
    """Parse a path; an empty text would be the current folder."""
    return Path(path_text(text))


def path_text(text: str) -> str:
    """Check a path, or a name that may stand in its place, and return it as it is."""
    if not text.strip():
        raise argparse.ArgumentTypeError("the name is empty")
    fault = path_fault(shown(text), text)
    if fault is not None:
        raise argparse.ArgumentTypeError(str(fault))
    return text


def pair(separator: str, kind, most: float):
    """Two finite numbers of `kind` above 0, at most `most`, with `separator` between."""

    def checked(text: str):
        try:
            first, second = (kind(part) for part in text.lower().split(separator))
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not two numbers with {separator!r} between") from None
        if not (first > 0 and second > 0):
            raise argparse.ArgumentTypeError(f"{text!r} is not two numbers above 0")
        if max(first, second) > most or math.inf in (first, second):
            raise argparse.ArgumentTypeError(f"{text!r} has a number above {most:g}")
        return first, second

    return checked


def parse_effects(text: str) -> tuple[str, ...] | None:
    """Names of effects, each once; () for `none`, None for `auto`."""
    from ...cbt_terrain.effects.catalogue import EFFECTS
    from ..text.effect_lines import unknown

    if text in ("auto", "none"):
        return None if text == "auto" else ()
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    for name in names:
        if name not in EFFECTS:
            raise ValueError(unknown(name))
    return names
