# SPDX-License-Identifier: GPL-3.0-or-later
"""Hooks of mkdocs for the site of docs/: GitHub's names of repeated headings, and the package for the API page."""

import os
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
        point_link(PACKAGE / name, ROOT / name)


def point_link(link: Path, target: Path) -> None:
    """Make a link to a target, in place of one to another checkout, which may be gone, in a shared `.cache`."""
    if link.is_symlink() and os.readlink(link) == str(target):
        return
    new = link.with_name(f"{link.name}.{os.getpid()}")
    new.symlink_to(target)
    os.replace(new, link)
