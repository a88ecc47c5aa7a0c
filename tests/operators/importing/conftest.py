# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of the tests of imports."""

import bpy
import pytest


@pytest.fixture
def saved(scene, tmp_path):
    """Return the scene and its folder."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return scene, tmp_path
