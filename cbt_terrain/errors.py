# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error for bad input."""

import os
import sys
from collections.abc import Container
from pathlib import Path

# Windows counts characters of two bytes; a name in it has at most three bytes a character in UTF-8.
MAX_PATH_BYTES = {"linux": 4096, "darwin": 1024}.get(sys.platform, 32_767)
MAX_NAME_BYTES = 765 if sys.platform == "win32" else 255


class TerrainError(Exception):
    """Error of input that cannot be used. Its text is one sentence for the user, made by `to_sentence`.

    Attributes:
        what: clause that names the fault: "The saved tree has version 3".
        where: file, object or setting, if `what` does not name it: "/land/alps.store".
        expected: usable values: "version 2".
        fix: instruction for the user: "save it again".
        code: identifier for code that handles this error, "" if none does: "store.changed".
    """

    FIELDS = ("what", "where", "expected", "fix", "code")

    def __init__(self, what: str, where: object = "", expected: str = "", fix: str = "", code: str = "") -> None:
        super().__init__(what, str(where), expected, fix, code)
        self.what, self.where, self.expected, self.fix, self.code = self.args

    def __str__(self) -> str:
        return to_sentence(self)

    def within(self, clause: str) -> "TerrainError":
        """Return this error, without its code, after a clause: "The scatter 'Firs' cannot be made"."""
        return TerrainError(f"{clause}. {self.what}", self.where, self.expected, self.fix)

    @property
    def problem(self) -> str:
        """Return the sentence without the fix, for a panel that shows the fix apart."""
        return to_sentence(TerrainError(self.what, self.where, self.expected))

    def to_json(self) -> dict[str, str]:
        """Return the fields that are not empty, by name; a child process reports its error with this."""
        return {name: value for name, value in zip(self.FIELDS, self.args, strict=True) if value}


def to_sentence(error: TerrainError) -> str:
    """Return the sentence "What (where); expected this: do that"."""
    place = f" ({error.where})" if error.where else ""
    expected = f"; expected {error.expected}" if error.expected else ""
    fix = f": {error.fix}" if error.fix else ""
    return f"{error.what.removesuffix('.')}{place}{expected}{fix}."


def path_fault(subject: str, path: str | os.PathLike) -> TerrainError | None:
    """Return the error for a path that no file can have, None if a file can have it. A relative path is made absolute.

    Args:
        subject: start of the error's clause: "The store a/b".
    """
    expected = "the name of a file or folder"
    if not isinstance(path, str | os.PathLike):
        return TerrainError(f"{subject} is of the type {type(path).__name__}", expected=expected)
    text = os.fspath(path)
    if "\0" in text:
        return TerrainError(f"{subject} holds a NUL character", expected=expected)
    try:
        absolute = Path(text).absolute()
        parts = [os.fsencode(part) for part in absolute.parts]
        size = len(os.fsencode(absolute))
    except (UnicodeEncodeError, OSError) as reason:  # OSError: the current folder was removed
        return TerrainError(f"{subject} cannot be a path ({reason})", expected=expected)
    fix = "choose a shorter one"
    if size >= MAX_PATH_BYTES:
        return TerrainError(
            f"{subject} is a path of {size:,} bytes", expected=f"fewer than {MAX_PATH_BYTES:,}", fix=fix
        )
    longest = max(map(len, parts), default=0)
    if longest > MAX_NAME_BYTES:
        return TerrainError(
            f"{subject} holds a name of {longest:,} bytes", expected=f"{MAX_NAME_BYTES} at most", fix=fix
        )
    return None


def check_path(what: str, path: str | os.PathLike) -> None:
    """Raise TerrainError for a path that no file can have, as one with a null character.

    what: words before the path in the error, as "The store".
    """
    error = path_fault(f"{what} {shown(path)}", path)
    if error is not None:
        raise error


def check_kind(value: object, kind: type | tuple[type, ...], name: str, expected: str) -> None:
    """Raise TerrainError unless `value` is an instance of `kind`.

    name: subject of the error, as "The criterion". expected: noun for such values, in the error.
    """
    if not isinstance(value, kind):
        raise TerrainError(f"{name} is {shown(repr(value))}", expected=expected)


def check_function(value: object, name: str) -> None:
    """Raise TerrainError unless `value` can be called. name: of the argument."""
    if not callable(value):
        raise TerrainError(f"The argument {name} is {shown(repr(value))}", expected="a function", fix="leave it out")


def check_number(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise TerrainError unless `value` is an int or a float from `low` to `high`, which excludes NaN.

    name: subject of the error, as "The detail's wavelength". unit: the range's unit, for the error's text only.
    """
    if not (isinstance(value, int | float) and low <= value <= high):
        raise TerrainError(f"{name} is {value!r}", expected=f"{low:g} .. {high:g} {unit}")


def check_seed(name: str, seed: int) -> None:
    """Raise TerrainError unless `seed` is an int of 0 to 2^32 - 1. name: subject of the error."""
    if not (isinstance(seed, int) and 0 <= seed < 2**32):
        raise TerrainError(f"{name} is {seed!r}", expected=f"a whole number, 0 .. {2**32 - 1}")


def check_free_name(kind: str, name: str, known: Container[str]) -> None:
    """Raise TerrainError unless `name` is a lower-case identifier that is not in `known`.

    Registries check the name of a new entry with it; kind: word for the entry in the error, as "effect".
    """
    if not (name.isidentifier() and name == name.lower()):
        raise TerrainError(
            f"The name {name!r} of the {kind} is no identifier", expected="lower-case letters, digits, _"
        )
    if name in known:
        raise TerrainError(f"The {kind} {name!r} is registered already", fix="choose another name")


def unwritable(what: str, reason: Exception, elsewhere: str = "choose another folder") -> TerrainError:
    """Return the error for output that the system does not write.

    what: the file, with a noun before its name. elsewhere: instruction that the fix offers beside making room.
    """
    why = getattr(reason, "strerror", None) or reason
    return TerrainError(f"{what} cannot be written ({why})", fix=f"make room or {elsewhere}")


def named_once(pairs: list[tuple[str, object]]) -> dict:
    """Return a JSON object as a dict, as `object_pairs_hook` of json.loads.

    Raises ValueError for a repeated name, of which Python would keep the last.
    """
    content = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"{shown(name)!r} occurs twice in one object")
        content[name] = value
    return content


def shown(text: object, max_length: int = 200) -> str:
    """Return a text from outside as one line of printable characters, safe for a terminal.

    A text of more than `max_length` characters is cut there and gets "..." at its end.
    """
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= max_length else f"{line[:max_length]}..."
