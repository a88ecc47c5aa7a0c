# SPDX-License-Identifier: GPL-3.0-or-later
"""The real program bakes maps, and its renders show them."""

import pytest
from adaptive_terrain.cbt_terrain.attributes.folder import read_index


@pytest.fixture
def show(program, scene, tmp_path, monkeypatch):
    """Return a function that runs a script, which writes maps and pictures into a folder, and returns its report."""
    monkeypatch.setenv("GALLIVM_PERF", "nopt")  # saves a quarter of Mesa's time for compiling shaders
    return lambda script: program.script(script, tmp_path, blend=scene[0], timeout=600)


@pytest.mark.thorough
def test_the_program_bakes_maps_and_both_engines_show_them(show, tmp_path):
    report = show("bake_maps.py")
    [folder] = [path for path in (tmp_path / "maps").iterdir() if path.is_dir()]
    assert set(read_index(folder)["maps"]) == {"color", "detail_normal"}
    (cycles, shaded), (eevee, also) = report["red"].values()
    assert 0.01 < cycles < 0.1 and abs(eevee - cycles) < 0.2 * cycles, "the decal is seen, and in the same place"
    assert shaded > 0.02 and also > 0.02, "the ground under it is not flat"


@pytest.mark.thorough
def test_no_line_is_seen_between_tiles(show):
    """EEVEE shows no mean colour at the borders of tiles, compared with a picture without mips."""
    report = show("tile_seams.py")
    assert report["tiles"] == 4 and report["range"] > 0.3
    assert report["most"] < 5 * report["median"] + 0.002
