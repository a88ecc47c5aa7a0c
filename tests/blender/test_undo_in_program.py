# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo by keys in the real program during background work."""

import pytest
from window_report import run_in_window

pytestmark = pytest.mark.thorough


def test_a_restored_terrain_is_imported_again(program, tmp_path):
    """A terrain undone and redone, or deleted and undone, during its import gets its height map.

    Adding and importing are then one step of Undo.
    """
    report = run_in_window(program, "undo_import.py", tmp_path)
    assert report["undone"] == report["deleted"] == ["", 1], "no store yet, one import"
    assert report["imported"] and report["left"] == [0, 0]
    assert report["one_step"] == [True, True, 0], "the store and the camera's range are back, and nothing is imported"
