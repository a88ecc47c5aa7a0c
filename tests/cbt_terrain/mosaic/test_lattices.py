# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles share a lattice wherever it begins, if their samples are at most a thousandth of a sample off it."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mosaic.catalogue import SourceTile
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.lattices import find_lattices
from mosaic_files import EAST, NORTH, UTM32, settings_of
from rasterio.transform import Affine
from rasters import hills, write_raster

OFF = 5e-4  # samples between two tiles of one lattice


def tile(west, north, step=10.0, angle=0.0, size=(60, 40), crs=UTM32):
    """Return the header of a tile whose rows run at an angle (radians); west and north are those of its corner."""
    a, b = step * math.cos(angle), step * math.sin(angle)
    place = (a, b, west, b, -a, north)
    numbers = {"scale": 1.0, "offset": 0.0, "block_rows": 1, "roundings": (), "warnings": ()}
    return SourceTile("a.tif", (), *size, place, crs, "", "float32", "GTiff", **numbers)


def tiles_of(*tiles):
    return [lattice.tiles.tolist() for lattice in find_lattices(tiles)]


@pytest.mark.parametrize("fraction", np.linspace(0.0, 1.0, 41).tolist())
def test_the_place_of_a_lattice_does_not_split_it(fraction):
    west = EAST + 10.0 * fraction
    for shift in (-OFF, OFF):
        [lattice] = find_lattices([tile(west, NORTH), tile(west + 600.0 + 10.0 * shift, NORTH)])
        assert lattice.rectangles.tolist() == [[0, 0, 59, 39], [60, 0, 119, 39]]
        assert lattice.off_grid == pytest.approx(OFF, rel=1e-3)
    assert tiles_of(tile(west, NORTH), tile(west + 600.02, NORTH)) == [[0], [1]], "2 thousandths are too many"


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 0.3, 1.2])
def test_turns_that_nearly_agree_share_a_lattice(angle):
    west, north = EAST + 600.0 * math.cos(angle), NORTH + 600.0 * math.sin(angle)
    for turn in (0.0, -4e-6, 4e-6):  # 59 samples long, so at most 2.4e-4 samples off
        assert tiles_of(tile(EAST, NORTH, angle=angle), tile(west, north, angle=angle + turn)) == [[0, 1]]
    assert tiles_of(tile(EAST, NORTH, angle=angle), tile(west, north, angle=angle + 4e-5)) == [[0], [1]]


def test_tiles_of_other_systems_steps_and_sides_are_apart():
    first = tile(EAST, NORTH)
    others = [
        tile(EAST, NORTH, crs="EPSG:32633"),
        tile(EAST, NORTH, step=10.001),
        tile(EAST, NORTH, step=20.0, size=(1, 1)),  # half a sample off
        tile(EAST - 5.0, NORTH + 5.0, step=20.0, size=(1, 1)),  # it is on it, a next one would not be
        tile(EAST + 10.0 * 2**31, NORTH),
    ]
    for other in others:
        assert tiles_of(first, other, first) == [[0, 2], [1]]
    assert tiles_of(first, *others) == [[0], [1], [2], [3], [4], [5]]


def test_heights_do_not_depend_on_the_place_of_a_lattice(tmp_path):
    heights, found = hills(120, 60), []
    for name, west in (("a", EAST), ("b", EAST + 10.0 * math.acos(0.005) / (2 * math.pi) - 10.0 * OFF / 2)):
        (tmp_path / name).mkdir()
        for n in range(2):
            place = Affine(10.0, 0.0, west - 5.0 + n * (600.0 + 10.0 * OFF), 0.0, -10.0, NORTH)
            write_raster(tmp_path / name / f"{n}.tif", heights[:, 60 * n : 60 * n + 60], crs=UTM32, transform=place)
        report = run_mosaic_import(settings_of(tmp_path / name), tmp_path / f"{name}.store")
        found.append(np.asarray(open_store(tmp_path / f"{name}.store").samples)[::-1])
        assert report["edges"] == 1, "both files meet without an overlap"
    assert np.array_equal(found[0], heights) and np.array_equal(found[1], heights)
