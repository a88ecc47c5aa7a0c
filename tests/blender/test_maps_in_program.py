# SPDX-License-Identifier: GPL-3.0-or-later
"""The real program bakes maps, and what it renders shows them."""

import os

from adaptive_terrain.cbt_terrain.maps.folder import read_index

# On a processor EEVEE compiles its shaders for minutes.
ENGINES = ["CYCLES", "BLENDER_EEVEE_NEXT"][: 2 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 1]


def test_the_program_bakes_maps_and_its_engines_show_them(program, scene, tmp_path):
    said = program.script("bake_maps.py", tmp_path, *ENGINES, blend=scene[0], timeout=600)
    [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
    assert set(read_index(folder)["maps"]) == {"color", "detail_normal"}
    (cycles, _), *_ = said["red"].values()
    assert 0.01 < cycles < 0.1, "the decal is seen"
    for red, shaded in said["red"].values():
        assert abs(red - cycles) < 0.2 * cycles, "in the same place"
        assert shaded > 0.02, "the ground under it is not flat"
