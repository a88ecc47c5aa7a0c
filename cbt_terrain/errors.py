# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error for bad input."""

import os
import sys
from pathlib import Path

# Windows counts characters of two bytes; a name in it has at most three bytes a character in UTF-8.
MAX_PATH_BYTES = {"linux": 4096, "darwin": 1024}.get(sys.platform, 32_767)
MAX_NAME_BYTES = 765 if sys.platform == "win32" else 255


class TerrainError(Exception):
    """Something that came from outside cannot be used. Its text is one sentence for the user, made by `to_sentence`.

    Attributes:
        what: clause that says what is wrong: "The saved tree has version 3".
        where: file, object or setting, if `what` does not name it: "/land/alps.store".
        expected: what can be used: "version 2".
        fix: what the user can do: "save it again".
        code: identifier for code that handles this error, "" if none does: "store.changed".
    """

    FIELDS = ("what", "where", "expected", "fix", "code")

    def __init__(self, what: str, where: object = "", expected: str = "", fix: str = "", code: str = ""):
        super().__init__(what, str(where), expected, fix, code)
        self.what, self.where, self.expected, self.fix, self.code = self.args

    def __str__(self) -> str:
        return to_sentence(self)

    def to_json(self) -> dict[str, str]:
        """Return the fields that are not empty."""
        return {name: value for name, value in zip(self.FIELDS, self.args, strict=True) if value}


def to_sentence(error: TerrainError) -> str:
    """Return "What (where); expected this: do that." """
    place = f" ({error.where})" if error.where else ""
    expected = f"; expected {error.expected}" if error.expected else ""
    fix = f": {error.fix}" if error.fix else ""
    return f"{error.what.removesuffix('.')}{place}{expected}{fix}."


def path_fault(path: str | os.PathLike) -> str:
    """Return why no system can have a file of this name, "" if it can: the end of a sentence."""
    text = os.fspath(path)
    if "\0" in text:
        return "holds a NUL character: expected the name of a file or folder."
    try:
        whole = Path(text).absolute()
        parts = [os.fsencode(part) for part in whole.parts]
        size = len(os.fsencode(whole))
    except (UnicodeEncodeError, OSError) as reason:  # OSError: the current folder was removed
        return f"cannot be a path ({reason}): expected the name of a file or folder."
    if size >= MAX_PATH_BYTES:
        return f"is a path of {size:,} bytes: expected fewer than {MAX_PATH_BYTES:,}; choose a shorter one."
    longest = max(map(len, parts), default=0)
    if longest > MAX_NAME_BYTES:
        return f"holds a name of {longest:,} bytes: expected at most {MAX_NAME_BYTES}; choose a shorter one."
    return ""


def check_path(what: str, path: str | os.PathLike) -> None:
    """Raise TerrainError for a path that no system can have; what: "The store"."""
    reason = path_fault(path)
    if reason:
        raise TerrainError(f"{what} {shown(path)} {reason}")


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
