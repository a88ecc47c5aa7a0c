# SPDX-License-Identifier: GPL-3.0-or-later
"""The move of stores out of the extension's user folder, which Blender deletes with the extension, at a start."""

from pathlib import Path

from ...cbt_terrain.field.moving import MovedStores, move_stores
from .store_location import data_folder, old_folders
from .store_paths import show_notice

DELETES = "which Blender deletes with the extension"


def move_old_stores() -> None:
    """Move the stores of earlier versions into the data folder, at each start of Blender.

    Stores that cannot be moved stay, and the next start tries again.
    """
    for old in old_folders():
        try:
            moved = move_stores(old, data_folder())
        except OSError as reason:
            moved = MovedStores(failures=[f"{old}: {reason.strerror or reason}"])
        _report_moves(moved, old)


def _report_moves(moved: MovedStores, old: Path) -> None:
    """Report the stores that were moved out of the folder `old`, and those that could not be."""
    new = data_folder()
    if moved.failures:
        show_notice(
            f"kept in {old}",
            f"Stores could not be moved to {new} ({'; '.join(moved.failures)}). They are in {old}, {DELETES}: make "
            "room, or change the rights, and start Blender again.",
        )
    if moved.stores:
        names = ", ".join(moved.stores)
        show_notice(f"moved from {old}", f"Stores were moved out of {old}, {DELETES}, into {new}: {names}.")
