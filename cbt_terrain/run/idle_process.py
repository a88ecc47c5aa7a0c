# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that loads nothing until its parent needs it: see `child.start`."""

import importlib
import io

PACKAGE = __package__.rsplit(".", 2)[0]


def child_main(module: str) -> None:
    """Wait for a line on stdin, and call `idle_main` of a module of this package with it; end without a line."""
    line = io.FileIO(0, closefd=False).readline()  # unbuffered: the next lines are for `idle_main`
    if line:
        importlib.import_module(f"{PACKAGE}.{module}").idle_main(line)
