# SPDX-License-Identifier: GPL-3.0-or-later
"""Hooks of mkdocs for the site of docs/: GitHub's names of repeated headings, and the package for the API page."""

from pathlib import Path

from markdown.extensions import toc

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / ".cache" / "site" / "adaptive_terrain"


def number_repeated(name: str, used: set[str], *_counters) -> str:
    """Return an anchor that is not in `used`, with GitHub's numbers: `snow`, `snow-1`; and add it."""
    anchor, number = name, 0
    while not anchor or anchor in used:
        number += 1
        anchor = f"{name}-{number}"
    used.add(anchor)
    return anchor


def on_startup(**_arguments):
    """Link the package's files into a folder of its name, in which mkdocstrings looks for it."""
    toc.unique = number_repeated
    PACKAGE.mkdir(parents=True, exist_ok=True)
    for name in ("__init__.py", "cbt_terrain", "kernels"):
        link = PACKAGE / name
        if not link.is_symlink():
            link.symlink_to(ROOT / name)
