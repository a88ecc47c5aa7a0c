# SPDX-License-Identifier: GPL-3.0-or-later
"""An import in a scene with another Unit Scale warns that Blender shows the terrain in another size."""

import bpy
import numpy as np
import pytest


@pytest.mark.parametrize(
    ("system", "scale", "factor"), [("METRIC", 0.01, "100"), ("IMPERIAL", 1.0, ""), ("NONE", 0.01, "")]
)
def test_an_import_names_the_unit_scale(scene, add_terrain, imports_here, tmp_path, capfd, system, scale, factor):
    np.save(tmp_path / "hills.npy", np.ones((5, 5), np.float32))
    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    settings.source, settings.source_path = "FILE", str(tmp_path / "hills.npy")
    settings.use_extent, settings.extent = True, (1000.0, 1000.0)
    scene.unit_settings.system, scene.unit_settings.scale_length = system, scale
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    output = "".join(capfd.readouterr())
    assert ("Unit Scale is 0.01" in output) == bool(factor)
    assert factor == "" or f"scale the terrain by {factor}." in output
