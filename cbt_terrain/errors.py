# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error for bad input."""


class TerrainError(Exception):
    """Something that came from outside cannot be used.

    The message is one sentence for the user: what is wrong, where (file, value), what was expected, what to do.
    """


def check_number(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise TerrainError for what is not a number between `low` and `high`; name: "The detail's wavelength"."""
    if not (isinstance(value, int | float) and low <= value <= high):
        raise TerrainError(f"{name} is {value!r}; expected {low:g} .. {high:g} {unit}.")


def check_seed(name: str, seed: int) -> None:
    """Raise TerrainError for what is not a whole number of 32 bits."""
    if not (isinstance(seed, int) and 0 <= seed < 2**32):
        raise TerrainError(f"{name} is {seed!r}; expected a whole number, 0 .. {2**32 - 1}.")


def named_once(pairs: list[tuple[str, object]]) -> dict:
    """An object of JSON; ValueError where a name stands in it twice, of which Python would take the last."""
    content = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"{shown(name)!r} stands twice in one object")
        content[name] = value
    return content


def shown(text: object, most: int = 200) -> str:
    """A text from outside as it is shown: one line of at most `most` characters, none of which a terminal obeys."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= most else f"{line[:most]}..."
