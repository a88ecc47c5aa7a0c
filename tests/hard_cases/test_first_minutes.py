# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 67: the first import in the window of the real Blender program."""

import json

import numpy as np
import pytest
from program_window import SCREEN, WHOLE, read_screen, wait_for, window
from real_program import SCRIPTS

LIT = 100  # of 255: between the background of a factory scene and a terrain in solid shading


def lit_fraction(picture, viewport: list[int]) -> float:
    """Return the fraction of the viewport's pixels that is as light as ground, without headers, tools and gizmos."""
    x, y, width, height = viewport
    top = SCREEN[1] - y - height
    pixels = np.asarray(picture.convert("L"))[top + height // 5 : top + height, x + width // 10 : x + width * 9 // 10]
    return float((pixels > LIT).mean())


@pytest.fixture(scope="module")
def pictures(program, dem, tmp_path_factory):
    """Return the screen after the import, the same with a factory scene's view, and the script's report."""
    folder = tmp_path_factory.mktemp("first_import")
    arguments = ["--python", str(SCRIPTS / "first_import.py"), "--", str(folder), str(dem["tif"])]
    with window(program, arguments, folder, place=WHOLE) as blender:
        wait_for(folder / "imported.json", blender, ended=folder / "done.json")
        after = read_screen(folder)
        (folder / "imported_pictured").touch()
        wait_for(folder / "done.json", blender)
        factory = read_screen(folder)
    assert json.loads((folder / "done.json").read_text()) == {}
    return after, factory, json.loads((folder / "imported.json").read_text())


def test_case_67_an_imported_dem_is_on_the_screen(pictures):
    """A DEM 30 km wide covers at least a tenth of the viewport; the factory view shows an empty grid."""
    after, factory, report = pictures
    assert report["width_m"] > 29_000
    assert lit_fraction(after, report["viewport"]) > 0.1
    assert lit_fraction(factory, report["viewport"]) < 0.02, "the light pixels are the terrain"


def test_case_67_clip_ranges_reach_it_and_keep_their_precision(pictures):
    """Clip ranges of viewport and camera cover the terrain at a ratio of at most 100,000; the camera stays in place."""
    _, _, report = pictures
    diagonal = report["width_m"] * 2**0.5
    for start, end in (report["clip"], report["camera_clip"]):
        assert end > diagonal and end / start <= 1.01e5
    assert report["camera_moved"] is False
