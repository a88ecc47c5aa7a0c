# SPDX-License-Identifier: GPL-3.0-or-later
"""An empty mesh of Blender."""

import bpy
import pytest


@pytest.fixture
def mesh():
    mesh = bpy.data.meshes.new("Terrain")
    yield mesh
    bpy.data.meshes.remove(mesh)
