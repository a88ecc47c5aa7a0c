# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports into the store of an earlier one: only what has changed is read and measured, with the same bytes."""

import zipfile

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling import tile_steps
from mosaic_files import DEGREES, EAST, NORTH, UTM32, moved, sheet
from tiled_stores import CountingCrew, assert_same, content, tiled, write_tiles  # noqa: F401


def import_twice(tmp_path, tiled, change, **more):  # noqa: F811
    """Import a mosaic, change it, import again, and return what that has read and measured."""
    settings, store = ImportSettings(str(tmp_path / "tiles"), **more), tmp_path / "store"
    tiled(5)
    run_mosaic_import(settings, store)
    change()
    crew = CountingCrew()
    run_mosaic_import(settings, store, crew=crew)
    tiled(None)
    run_mosaic_import(settings, tmp_path / "whole")
    assert_same(store, tmp_path / "whole")
    return crew


def patch(tmp_path, name="u.tif", column=70, row=50, side=12, shift=0.0):
    """Write a small tile with the mosaic's step over the others."""
    part = sheet(UTM32, EAST + 10.0 * column, NORTH - 10.0 * row, 10.0, 10.0, side, side, shift=shift)
    part.write(tmp_path / "tiles" / name)


def test_a_replaced_file_is_read_and_measured_alone(tmp_path, tiled):  # noqa: F811
    write_tiles(tmp_path / "tiles", gap=None)
    patch(tmp_path, shift=1.0)
    crew = import_twice(tmp_path, tiled, lambda: patch(tmp_path, shift=-2.0))
    # Columns 70 .. 81 and, from the south, rows 58 .. 69 of the 5 x 4 tiles of 32; samples at 96 belong to two tiles.
    assert crew.read == [1 * 5 + 2, 2 * 5 + 2]
    margin = 96
    assert len(crew.measured) == 20 and margin > 32, "the windows of all tiles of this size meet it"


def test_an_archive_goes_on_and_its_changed_member_is_read_alone(tmp_path, tiled):  # noqa: F811
    def pack():
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            for file in sorted((tmp_path / "tiles").iterdir()):
                archive.writestr(zipfile.ZipInfo(f"in/{file.name}"), file.read_bytes())  # all of one date

    write_tiles(tmp_path / "tiles", gap=None)
    patch(tmp_path, shift=1.0)
    pack()
    settings, crew = ImportSettings(str(tmp_path / "a.zip")), CountingCrew()
    tiled(5)
    with pytest.raises(KeyboardInterrupt):
        run_mosaic_import(settings, tmp_path / "store", crew=CountingCrew(13))
    run_mosaic_import(settings, tmp_path / "store", crew=crew)
    assert (len(crew.read), len(crew.measured)) == (7, 20)
    patch(tmp_path, shift=-2.0)
    pack()
    run_mosaic_import(settings, tmp_path / "store", crew=crew)
    assert crew.read[7:] == [1 * 5 + 2, 2 * 5 + 2]
    tiled(None)
    run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "whole")
    (arrays, _), (wanted, _) = content(tmp_path / "store"), content(tmp_path / "whole")
    assert arrays.keys() == wanted.keys() and all(np.array_equal(arrays[name], wanted[name]) for name in wanted)


@pytest.mark.thorough
def test_a_file_in_a_gap_and_a_lower_peak(tmp_path, tiled):  # noqa: F811
    write_tiles(tmp_path / "tiles", gap=(1, 1))
    patch(tmp_path, "z.tif", column=20, row=20, side=4, shift=5000.0)

    def change():
        patch(tmp_path, "z.tif", column=20, row=20, side=4, shift=30.0)
        patch(tmp_path, "v.tif", column=38, row=38, side=50)

    crew = import_twice(tmp_path, tiled, change, blend=False)
    assert len(crew.read) <= 22 and len(crew.measured) == 80, "the peak had coarser codes everywhere"


def test_one_file_in_the_place_of_a_mosaic_has_its_limits(tmp_path, tiled):  # noqa: F811
    """A file is read in fewer units than a mosaic, so the records of the others are left out."""
    write_tiles(tmp_path / "tiles", gap=None)
    low = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 160, 120)
    low.heights *= 0.1
    settings = ImportSettings(str(low.write(tmp_path / "low.tif")))
    tiled(5)
    run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    run_import(settings, tmp_path / "store")
    tiled(None)
    run_import(settings, tmp_path / "whole")
    assert_same(tmp_path / "store", tmp_path / "whole")


def test_a_flat_file_replaces_a_steep_one(tmp_path, tiled):  # noqa: F811
    """The bound of interpolated positions is that of the new file's heights alone."""
    west, north = map(float, moved(UTM32, DEGREES, EAST + 400, NORTH - 20))
    steep, flat = (sheet(DEGREES, west, north, 1.4e-4, 9e-5, 30, 30) for _ in range(2))
    steep.heights *= 40.0
    sheet(UTM32, EAST, NORTH, 10.0, 10.0, 70, 40).write(tmp_path / "tiles" / "a.tif", kind="float64")
    steep.write(tmp_path / "tiles" / "b.tif", kind="float64")
    import_twice(tmp_path, tiled, lambda: flat.write(tmp_path / "tiles" / "b.tif", kind="float64"))


@pytest.mark.parametrize(
    "name",
    ["samples.npy", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("tiles.jsonl", "borders.npy"))],
)
def test_damaged_parts_of_a_store_are_not_used_again(tmp_path, tiled, name):  # noqa: F811
    write_tiles(tmp_path / "tiles", columns=2, rows=2, gap=None)

    def change():
        [file] = (tmp_path / "store").glob(f"data-*/{name}")
        text = bytearray(file.read_bytes())
        text[len(text) // 2] ^= 1
        file.write_bytes(text)
        patch(tmp_path, column=30, row=50)

    crew = import_twice(tmp_path, tiled, change)
    assert len(crew.read) == len(crew.measured) == 9


@pytest.mark.thorough
def test_holes_that_a_file_closes(tmp_path, tiled):  # noqa: F811
    write_tiles(tmp_path / "tiles", gap=(1, 1))
    import_twice(tmp_path, tiled, lambda: patch(tmp_path, "v.tif", column=45, row=45, side=20), holes=True)


@pytest.mark.thorough
def test_a_replaced_inset_is_read_as_far_as_its_ring_reaches(tmp_path, tiled):  # noqa: F811
    sheet(UTM32, EAST, NORTH, 10.0, 10.0, 420, 60).write(tmp_path / "tiles" / "a.tif")

    def write_inset(shift):
        part = sheet(UTM32, EAST + 100.0, NORTH - 100.0, 5.0, 5.0, 60, 60, shift=shift)
        part.write(tmp_path / "tiles" / "b.tif")

    write_inset(4.0)
    crew = import_twice(tmp_path, tiled, lambda: write_inset(-3.0))
    # The ring and the distances by which its width is found reach 5 x 64 samples and two cells of 8 beyond the inset.
    reached = (20 + 60 + 5 * 64 + 2 * 8) // 32
    columns = {number % 27 for number in crew.read}
    assert max(columns) <= reached < 26 and {0, 1, 2} <= columns


def test_a_changed_margin_measures_only_windows_that_meet_it(tmp_path, tiled, monkeypatch):  # noqa: F811
    """Windows smaller than a tile: the margin is not enough for exact errors, but shows which tiles are measured."""
    monkeypatch.setattr(tile_steps, "margin_of", lambda _low, _high: 8)
    write_tiles(tmp_path / "tiles", gap=None)
    patch(tmp_path, column=75, row=50, side=12)
    tiled(5)
    settings, crew = ImportSettings(str(tmp_path / "tiles")), CountingCrew()
    run_mosaic_import(settings, tmp_path / "store")
    patch(tmp_path, column=75, row=50, side=12, shift=1.0)
    run_mosaic_import(settings, tmp_path / "store", crew=crew)
    assert crew.read == [7, 12] and set(crew.measured) >= {7, 12} and len(crew.measured) <= 4
