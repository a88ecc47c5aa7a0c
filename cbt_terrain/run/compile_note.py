# SPDX-License-Identifier: GPL-3.0-or-later
"""One line on stderr when a program waits for kernels that are compiled, which takes from seconds to minutes.

A child process tells its parent instead (sandbox/store_job.py): its stderr is not shown.
"""

import sys
from collections.abc import Callable

NOTE = "Compiling kernels for the first use: about 10 s on two free cores, minutes on a busy machine."
ERASE = "\r\x1b[K"  # erases the line of a progress bar in a terminal

_tell: Callable[[], None] | None = None
_is_noted = False


def note() -> None:
    """Print the line, at most once in a process, or call the function of `replace`."""
    global _is_noted
    if _is_noted:
        return
    _is_noted = True
    if _tell is not None:
        _tell()
    elif sys.stderr is not None:  # a window without a console has none
        print(f"{ERASE if sys.stderr.isatty() else ''}{NOTE}", file=sys.stderr, flush=True)


def replace(tell: Callable[[], None]) -> None:
    """Let `note` call a function instead of printing, for the rest of this process."""
    global _tell, _is_noted
    _tell, _is_noted = tell, False
