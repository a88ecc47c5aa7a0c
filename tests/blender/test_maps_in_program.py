# SPDX-License-Identifier: GPL-3.0-or-later
"""The real program bakes maps, and what it renders shows them."""

from adaptive_terrain.cbt_terrain.maps.folder import read_index


def test_the_program_bakes_maps_and_both_engines_show_them(program, scene, tmp_path):
    said = program.script("bake_maps.py", tmp_path, "CYCLES", "BLENDER_EEVEE_NEXT", blend=scene[0], timeout=600)
    [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
    assert set(read_index(folder)["maps"]) == {"color", "detail_normal"}
    (cycles, shaded), (eevee, also) = said["red"].values()
    assert 0.01 < cycles < 0.1 and abs(eevee - cycles) < 0.2 * cycles, "the decal is seen, and in the same place"
    assert shaded > 0.02 and also > 0.02, "the ground under it is not flat"


def test_no_line_is_seen_between_tiles(program, scene, tmp_path):
    """In EEVEE, which would show the mean of a tile there: by a picture that has no mips."""
    said = program.script("tile_seams.py", tmp_path, blend=scene[0], timeout=600)
    assert said["tiles"] == 16 and said["range"] > 0.3
    assert said["most"] < 5 * said["median"] + 0.002
