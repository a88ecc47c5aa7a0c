# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error for bad input."""


class TerrainError(Exception):
    """Something that came from outside cannot be used.

    The message is one sentence for the user: what is wrong, where (file, value), what was expected, what to do.
    """


def shown(text: object, most: int = 200) -> str:
    """A text from outside as it is shown: one line of at most `most` characters, none of which a terminal obeys."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= most else f"{line[:most]}..."
