# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 75 to 90: many files as one terrain. Expected heights come from the arrays that were written."""

import itertools
import os
import sqlite3
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mosaic import composite as composites
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.mosaic.seams import find_seams
from mosaic_files import DEGREES, EAST, NORTH, UTM32, moved, settings_of, sheet
from rasterio.transform import from_origin
from rasters import write_raster

MANY = 2_500 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 320  # files; more than stay open


def composed(*sources, **more):
    """Return the composite of sources and all of its heights, row 0 north."""
    composite = open_composite(settings_of(*sources, **more), None)
    return composite, composite.read(0, composite.grid.height)[0]


def sample_places(composite):
    """Return x and y of all samples of a composite."""
    grid = composite.grid
    return grid.positions(*np.meshgrid(grid.column + np.arange(grid.width), grid.row + np.arange(grid.height)))


def write_tile(path, heights, column=0, row=0, step=10.0, **options):
    """Write samples at a column and a row of one grid in UTM."""
    path.parent.mkdir(parents=True, exist_ok=True)
    place = from_origin(EAST + column * step, NORTH - row * step, step, step)
    return write_raster(path, heights, **({"crs": UTM32, "transform": place} | options))


def refusal(*sources, folder, **more):
    """Return the one sentence with which an import ends, and check that no store is left."""
    with pytest.raises(TerrainError) as caught:
        run_mosaic_import(settings_of(*sources, **more), folder / "store")
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".") and len(text) < 900 and not (folder / "store/store.json").exists()
    return text


def test_case_75_a_shared_border_has_samples_of_the_later_file(tmp_path):
    """Four files share a row, a column and one corner; there the later file counts, elsewhere each its own samples."""
    values = np.arange(4 * 81, dtype=np.float32).reshape(4, 9, 9)
    places = [(0, 0), (8, 0), (0, 8), (8, 8)]
    files = [write_tile(tmp_path / f"{n}.tif", values[n], *place) for n, place in enumerate(places)]
    for order in itertools.permutations(range(4)):
        wanted = np.full((17, 17), np.nan)
        for n in order:
            column, row = places[n]
            wanted[row : row + 9, column : column + 9] = values[n]
        assert np.array_equal(composed(*(files[n] for n in order))[1], wanted)


def test_case_76_files_of_one_sample_are_a_raster(tmp_path):
    """30 files of one sample, one of a row and one of a column form one lattice, whose every sample is exact."""
    values = np.random.default_rng(76).integers(0, 999, (7, 7)).astype(np.float32)
    files = [
        write_tile(tmp_path / f"{row}{column}.tif", values[row : row + 1, column : column + 1], column, row)
        for row in range(6)
        for column in range(5)
    ]
    files.append(write_tile(tmp_path / "column.tif", values[:6, 5:6], 5, 0))
    files.append(write_tile(tmp_path / "row.tif", values[6:7, :6], 0, 6))
    composite, heights = composed(*files)
    assert len(composite.lattices) == 1 and np.array_equal(heights, values[:, :6])
    assert len(find_seams(composite).steps) == 0


def test_case_77_files_without_any_height_cover_nothing(tmp_path):
    """A file without data hides nothing of those below it, and a mosaic of such files is one error."""
    below = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 12, 12)
    empty = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 12, 12)
    empty.heights[:] = np.nan
    files = [below.write(tmp_path / "a.tif"), empty.write(tmp_path / "b.tif"), empty.write(tmp_path / "c.tif")]
    assert np.array_equal(composed(*files)[1], below.heights)
    assert "b.tif and 1 more has only missing samples" in refusal(*files[1:], folder=tmp_path)


@pytest.mark.thorough
def test_case_78_thousands_of_tiny_files_keep_few_open(tmp_path):
    """More tiny files than may be open give every sample exactly, and at most MAX_OPEN of them are open at a time."""
    across = 20
    values = np.random.default_rng(78).integers(0, 9999, (4 * (MANY // across), 4 * across)).astype(np.float32)
    for n in range(MANY):
        row, column = 4 * (n // across), 4 * (n % across)
        write_tile(tmp_path / "tiles" / f"{n:05}.tif", values[row : row + 4, column : column + 4], column, row)
    composite, heights = composed(tmp_path / "tiles")
    assert np.array_equal(heights, values)
    num_open = sum(str(tmp_path) in os.path.realpath(link) for link in Path("/proc/self/fd").iterdir())
    assert 0 < num_open <= composites.MAX_OPEN < MANY
    composite.close()


def test_case_79_links_count_as_the_files_that_they_lead_to(tmp_path):
    """Links to files elsewhere are tiles; broken, circular and folder links are not, and no loop is followed."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 10)
    folder = tmp_path / "tiles"
    whole.write(folder / "a.tif", columns=10)
    whole.write(tmp_path / "elsewhere" / "b.tif", first_column=10)
    (folder / "link.tif").symlink_to(tmp_path / "elsewhere" / "b.tif")
    (folder / "broken.tif").symlink_to("missing.tif")
    (folder / "circle.tif").symlink_to("circle.tif")
    (folder / "folder.tif").symlink_to(tmp_path / "elsewhere")
    (folder / "12").symlink_to(folder)
    composite, heights = composed(folder)
    assert np.array_equal(heights, whole.heights)
    assert [Path(tile.path).name for tile in composite.tiles] == ["a.tif", "link.tif"]


@pytest.mark.parametrize("change", ["rewritten", "linked", "removed", "piped", "grown", "emptied", "folder"])
def test_case_80_a_file_that_changes_meanwhile_is_one_error(tmp_path, change):
    """A file that is rewritten, longer, empty, removed, a link, a pipe or a folder meanwhile ends the import."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 20)
    files = [whole.write(tmp_path / f"{n}.tif", first_column=20 * n, columns=20) for n in range(2)]
    other = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20, shift=9.0).write(tmp_path / "other" / "o.tif")
    os.utime(other, ns=(5, 5))

    changed = []

    def act(done, *_):
        if done < 0.2 or changed:
            return
        file = files[1]
        changed.append(file)
        if change == "rewritten":
            file.write_bytes(other.read_bytes())
        elif change in ("grown", "emptied"):
            file.write_bytes(file.read_bytes() + bytes(9999) if change == "grown" else b"")
        else:
            file.unlink()
            if change == "linked":
                file.symlink_to(other)
            elif change == "piped":
                os.mkfifo(file)
            elif change == "folder":
                file.mkdir()

    with pytest.raises(TerrainError, match="1.tif has changed while it was imported; expected the file as it was"):
        run_mosaic_import(settings_of(*files), tmp_path / "store", act)
    assert not (tmp_path / "store" / "store.json").exists()


@pytest.mark.parametrize("first", [177.0, -183.0, 537.0])
def test_case_81_the_date_line_is_no_border(tmp_path, first):
    """Files west of it, across it, and east of it with longitudes of any turn form one raster without a gap."""
    step, values = 0.25, np.random.default_rng(81).integers(0, 500, (8, 24)).astype(np.float32)
    starts = [(first, 0), (179.0, 8), (-179.0, 16)]
    files = [
        write_tile(
            tmp_path / f"{n}.tif",
            values[:, column : column + 8],
            crs=DEGREES,
            transform=from_origin(longitude, 1.0, step, step),
        )
        for n, (longitude, column) in enumerate(starts)
    ]
    for order in itertools.permutations(files):
        assert np.array_equal(composed(*order)[1], values)
    composite, heights = composed(*files, project="EPSG:3832", step=20_000.0)  # PDC Mercator, centred at 150
    x, y = sample_places(composite)
    longitude, latitude = moved("EPSG:3832", DEGREES, x, y)
    u, v = ((longitude - 177.0) % 360.0) / step - 0.5, (1.0 - latitude) / step - 0.5
    inside = (u > 0) & (u < 23) & (v > 0) & (v < 7)
    p, q = np.floor(u[inside]).astype(int), np.floor(v[inside]).astype(int)
    s, t = u[inside] - p, v[inside] - q
    wanted = (values[q, p] * (1 - s) + values[q, p + 1] * s) * (1 - t)
    wanted += (values[q + 1, p] * (1 - s) + values[q + 1, p + 1] * s) * t
    assert inside.sum() > 100 and np.abs(heights[inside] - wanted).max() < 0.01 * 500


@pytest.mark.thorough
@pytest.mark.parametrize("first", [0, 2, 5, 8])
def test_case_81_eight_tiles_cover_the_earth_once(tmp_path, first):
    """Eight tiles of 90 degrees, in any order and beside one of the whole Earth, leave and repeat no sample."""
    values = np.random.default_rng(81).integers(0, 9999, (180, 360)).astype(np.float32)

    def write(name, column, row, columns, rows):
        place = from_origin(column - 180.0, 90.0 - row, 1.0, 1.0)
        part = values[row : row + rows, column : column + columns]
        return write_raster(tmp_path / f"{name}.tif", part, crs=DEGREES, transform=place)

    files = [write(f"{x}-{y}", x, y, 90, 90) for x in range(0, 360, 90) for y in (0, 90)]
    files.append(write("earth", 0, 0, 360, 180))
    for sources in (files[first:] + files[:first], (files[first:] + files[:first])[1:]):
        composite, heights = composed(*sources)
        x, _ = sample_places(composite)
        assert composite.grid.width == 360
        assert np.array_equal(heights, values[:, np.floor(x[0] + 180.0).astype(int) % 360])


def test_case_82_polar_tiles_meet_at_the_pole(tmp_path):
    """Four quarters of a polar cap in degrees become one polar raster, whole over the pole and every meridian."""
    step, files = 0.25, []
    for n in range(4):
        longitude, latitude = np.meshgrid(
            -180 + 90 * n + (np.arange(360) + 0.5) * step, 90 - (np.arange(40) + 0.5) * step
        )
        x, y = moved(DEGREES, "EPSG:3413", longitude, latitude)
        files.append(
            write_tile(
                tmp_path / f"{n}.tif",
                (500 + x / 2000 - y / 3000).astype(np.float32),
                crs=DEGREES,
                transform=from_origin(-180 + 90 * n, 90.0, step, step),
            )
        )
    composite, heights = composed(*files, project="EPSG:3413", step=20_000.0)
    x, y = sample_places(composite)
    _, latitude = moved("EPSG:3413", DEGREES, x, y)
    inside = latitude > 80.5
    assert inside.sum() > 8000 and np.isfinite(heights[inside]).all()
    # Bilinear in degrees over a plane: the arcs between samples are flat within 25 m, and the pole is half a cell wide.
    assert np.abs(heights - (500 + x / 2000 - y / 3000))[inside].max() < 25.0


def test_case_83_each_file_has_its_own_unit_scale_and_type(tmp_path):
    """Metres, feet, US feet and scaled centimetres in four types become metres, each within its own rounding."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 10)
    foot, us_foot = 0.3048, 1200 / 3937
    kinds = [("m", 1.0, np.float64, 1.0, 0.0), ("ft", foot, np.float32, 1.0, 0.0)]
    kinds += [("US survey foot", us_foot, np.int16, 0.5, 1000.0), ("cm", 0.01, np.uint16, 1.0, 50_000.0)]
    rounding, files = [1e-6, 1e-4, 0.25 * us_foot, 0.005], []
    for n, (unit, metres, kind, scale, offset) in enumerate(kinds):
        part = whole.heights[:, 10 * n : 10 * n + 10] / metres
        part = (part - offset) / scale
        part = (np.rint(part) if np.dtype(kind).kind in "iu" else part).astype(kind)
        files.append(write_tile(tmp_path / f"{n}.tif", part, 10 * n))
        with rasterio.open(files[-1], "r+") as opened:
            opened.units, opened.scales, opened.offsets = (unit,), (scale,), (offset,)
    _, heights = composed(*files)
    for n in range(4):
        off = np.abs(heights - whole.heights)[:, 10 * n : 10 * n + 10].max()
        assert off <= rounding[n] * 1.001
    report = run_mosaic_import(settings_of(*files), tmp_path / "store")
    assert max(rounding) * 0.999 <= report["source_step_m"] < max(rounding) * 1.01


def test_case_84_duplicated_files_change_nothing(tmp_path):
    """A file named twice, copied, hard-linked and zipped gives the samples of one, and seams of 0 m."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20)
    file = whole.write(tmp_path / "tiles" / "a.tif")
    (tmp_path / "tiles" / "copy.tif").write_bytes(file.read_bytes())
    os.link(file, tmp_path / "tiles" / "hard.tif")
    with zipfile.ZipFile(tmp_path / "tiles" / "z.zip", "w") as archive:
        archive.write(file, "a.tif")
    report = run_mosaic_import(settings_of(tmp_path / "tiles", file, file), tmp_path / "store")
    assert report["files"] == 4 and report["seams"] == 6 and report["seam_max_m"] == 0.0
    assert np.array_equal(np.asarray(open_store(tmp_path / "store").samples)[::-1], whole.heights.astype(np.float32))


def test_case_86_a_band_that_one_file_lacks_is_named(tmp_path):
    """The second band is read from files that have one, a file without one is named, and colours are no heights."""
    values = np.arange(72, dtype=np.float32).reshape(2, 6, 6)
    for n in range(2):
        with rasterio.open(
            tmp_path / f"{n}.tif",
            "w",
            driver="GTiff",
            count=2 + n,
            width=6,
            height=6,
            dtype="float32",
            crs=UTM32,
            transform=from_origin(EAST + 60 * n, NORTH, 10, 10),
        ) as file:
            file.write(np.stack([values[n], values[n] + 100, values[n]][: 2 + n]))
    _, heights = composed(tmp_path / "0.tif", tmp_path / "1.tif", band=2)
    assert np.array_equal(heights, np.concatenate(values + 100, axis=1))
    said = refusal(tmp_path / "0.tif", tmp_path / "1.tif", folder=tmp_path, band=3)
    assert "0.tif has 2 band(s), but not band 3" in said


def test_case_87_a_huge_gap_is_refused_or_filled_in_time(tmp_path):
    """Two small files 3,000 km apart need a coarse step, which the error names; then both are there, and a gap."""
    near = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 400, 400)
    far = sheet(UTM32, EAST + 4e5, NORTH - 3e6, 10.0, 10.0, 400, 400, shift=1000.0)
    files = near.write(tmp_path / "a.tif"), far.write(tmp_path / "b.tif")
    said = refusal(*files, folder=tmp_path, step=0.0025)
    assert "The mosaic would have 161,596,001 x 1,201,596,001 samples" in said
    step = float(said.partition("--step ")[2].partition(")")[0])
    assert 0.00275 < step < 0.00325
    report = run_mosaic_import(settings_of(*files, step=1000.0, holes=True), tmp_path / "store")
    heights = np.asarray(open_store(tmp_path / "store").samples)
    assert report["gap_percent"] > 99.0 and report["cut_out"] == heights.size - 32
    assert np.array_equal(heights[-4:, :4][::-1], near.heights[::100, ::100].astype(np.float32))
    assert np.array_equal(heights[:4, -4:][::-1], far.heights[::100, ::100].astype(np.float32))


def damage(kind, file):
    """Damage a file."""
    content = file.read_bytes()
    if kind == "garbage":
        file.write_bytes(b"no raster at all")
    elif kind == "cut":
        file.write_bytes(content[: len(content) - 300])
    elif kind == "empty":
        file.write_bytes(b"")
    elif kind == "pipe beside":
        os.mkfifo(file.with_suffix(".tfw"))
    elif kind == "no system":
        file.write_bytes(content[:280])


@pytest.mark.parametrize("kind", ["garbage", "cut", "empty", "pipe beside", "no system"])
def test_case_88_a_bad_file_in_a_folder_is_named(tmp_path, kind):
    """One unreadable, truncated or empty file in a folder ends the import with a sentence that begins with its name."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 10)
    for n in range(3):
        whole.write(tmp_path / "tiles" / f"{n}.tif", first_column=20 * n, columns=20)
    damage(kind, tmp_path / "tiles" / "1.tif")
    said = refusal(tmp_path / "tiles", folder=tmp_path)
    assert said.startswith(str(tmp_path / "tiles" / "1.t")) and "Traceback" not in said


def test_case_88_a_folder_without_rights_is_named(tmp_path, monkeypatch):
    """A folder that this user may list, but whose files it may not open, is no empty folder, also in a pattern."""
    folder = tmp_path / "tiles"
    sheet(UTM32, EAST, NORTH, 10.0, 10.0, 10, 10).write(folder / "a.tif")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != folder and access(path, mode))
    for source in (folder, folder / "*.tif"):
        said = refusal(source, folder=tmp_path)
        assert said == f"The folder {folder} cannot be read (Permission denied): change its permissions."


ODD_NAMES = [
    " a.tif",
    "b b.tif",
    "-c.tif",
    "d'\"$`;&.tif",
    "e%20e.tif",
    "f[1].tif",
    "g*?.tif",
    "h\n.tif",
    "NETCDF:i.tif",
]
ODD_NAMES += ["j.TIF", "k..tif", "ſ☃🏔.tif", "/vsizip".strip("/") + ".tif", "o{x}.tif", "p#1.tif", "q" * 240 + ".tif"]


def test_case_89_names_with_odd_characters_are_names(tmp_path):
    """Spaces, quotes, patterns, line breaks, other letters and long names are read, also from the catalogue."""
    values = np.arange(9 * len(ODD_NAMES), dtype=np.float32).reshape(3, -1)
    for n, name in enumerate(ODD_NAMES):
        plain = write_tile(tmp_path / "plain.tif", values[:, 3 * n : 3 * n + 3], 3 * n)
        (tmp_path / "tiles").mkdir(exist_ok=True)
        plain.replace(tmp_path / "tiles" / name)
    files = [tmp_path / "tiles" / name for name in ODD_NAMES]
    assert np.array_equal(composed(*files)[1], values)
    report = run_mosaic_import(settings_of(tmp_path / "tiles"), tmp_path / "store")
    assert report["files"] == len(ODD_NAMES)
    assert np.array_equal(np.asarray(open_store(tmp_path / "store").samples)[::-1], values)
    assert run_mosaic_import(settings_of(tmp_path / "tiles"), tmp_path / "store")["unchanged"]
    strange = os.fsencode(tmp_path / "tiles") + b"/\xff.tif"
    os.rename(os.fsencode(files[0]), strange)
    said = refusal(tmp_path / "tiles", folder=tmp_path / "other")
    assert "?.tif has the name '?.tif', which is no UTF-8 text" in said and said.endswith(
        "rename the file or the folder."
    )


def test_case_90_an_index_reaches_known_files_alone(tmp_path):
    """An index that names itself, a pipe, a folder, an archive or 10^6 files is refused; links to files count."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 10, 10)
    whole.write(tmp_path / "a.tif")
    (tmp_path / "link.tif").symlink_to("a.tif")
    os.mkfifo(tmp_path / "pipe.tif")
    (tmp_path / "z.zip").write_bytes(b"PK")

    def index(*names):
        path = tmp_path / f"{len(list(tmp_path.glob('*.gpkg')))}.gpkg"
        with sqlite3.connect(path) as base:
            base.execute("CREATE TABLE tiles (location TEXT)")
            base.executemany("INSERT INTO tiles VALUES (?)", [(name,) for name in names])
        base.close()
        return path

    assert np.array_equal(composed(index("link.tif", "./a.tif", "link.tif"))[1], whole.heights)
    for name in ("pipe.tif", ".", "z.zip", "0.gpkg", "../missing.tif", "\0.tif", "http://localhost/a.tif"):
        assert "names the source" in refusal(index("a.tif", name), folder=tmp_path)
    empty = [tmp_path / f"empty{suffix}" for suffix in (".gti", ".gpkg", ".shp")]
    for path in empty:
        path.write_bytes(b"")
    said = [refusal(path, folder=tmp_path) for path in empty]
    assert all("(it is empty)" in text for text in said[:2]) and "its table empty.dbf is not beside it" in said[2]
    assert "names more than 1,000,000 files" in refusal(index(*["a.tif"] * 1_000_001), folder=tmp_path)
