# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics of zipped tiles, and of folders of web map tiles."""

import gzip
import zipfile

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.formats import archives
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_list import files_of
from adaptive_terrain.cbt_terrain.mosaic import catalogue
from adaptive_terrain.cbt_terrain.mosaic.catalogue import FILE_NAME
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_info import describe_sources, size_of_heights
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from mosaic_files import EAST, NORTH, UTM32, settings_of, sheet
from rasterio.crs import CRS
from rasters import write_raster


def zipped(path, files):
    """Write an archive whose members all have the date 1980-01-01."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return path


@pytest.fixture
def packed(tmp_path):
    """Write four tiles, plain and packed: three zips with members of one name, and a .tif.gz."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 80, 20)
    for n in range(4):
        content = whole.write(tmp_path / "plain" / f"t{n}.tif", first_column=20 * n, columns=20).read_bytes()
        zipped(tmp_path / "packed" / f"t{n}.zip", {"in/dem.tif": content, "readme.txt": b"a"})
    (tmp_path / "packed" / "t3.zip").unlink()
    (tmp_path / "packed" / "t3.tif.gz").write_bytes(gzip.compress(content))
    return whole


def test_packed_tiles_give_the_store_of_plain_ones(packed, tmp_path, monkeypatch):
    """A folder and a list give the plain tiles' samples; unpacked files are removed, also when few may be kept."""
    run_mosaic_import(ImportSettings(str(tmp_path / "plain")), tmp_path / "one")
    wanted = open_store(tmp_path / "one")
    assert np.abs(np.asarray(wanted.samples)[::-1] - packed.heights).max() == 0.0
    report = import_source(ImportSettings(str(tmp_path / "packed")), tmp_path / "two")
    assert report["files"] == 4 and open_store(tmp_path / "two").raster.digest == wanted.raster.digest
    (folder,) = [entry for entry in (tmp_path / "two").iterdir() if entry.is_dir()]
    assert {entry.suffix for entry in folder.iterdir()} == {".npy", ".json"}
    assert ".partial" not in (folder / FILE_NAME).read_text()
    names = sorted(map(str, (tmp_path / "packed").iterdir()))
    monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 1)
    unpacks, real = [], archives._unpack
    monkeypatch.setattr(archives, "_unpack", lambda path, *more: unpacks.append(path.name) or real(path, *more))
    run_mosaic_import(settings_of(*names), tmp_path / "three")
    assert open_store(tmp_path / "three").raster.digest == wanted.raster.digest
    assert len(unpacks) > 4, "files that were removed are unpacked again"
    assert len(list((tmp_path / "three").iterdir())) == 2
    unpacks.clear()
    again = run_mosaic_import(settings_of(*names), tmp_path / "three")
    assert again["unchanged"] and not unpacks, "the kept catalogue has the headers"


def test_info_reads_packed_tiles(packed, tmp_path):
    report = describe_sources(ImportSettings(str(tmp_path / "packed")))
    plain = describe_sources(ImportSettings(str(tmp_path / "plain")))
    assert report["raster"] == [80, 20] and report["west_south_east_north"] == plain["west_south_east_north"]
    assert size_of_heights(ImportSettings(str(tmp_path / "packed"))) == (80, 20)
    more_mb = report["expected_disk_mb"] - plain["expected_disk_mb"]
    assert more_mb == pytest.approx(4 * 20 * 20 * 4 / 1e6, abs=0.11)


def test_an_archive_beside_its_content_is_left_out(packed, tmp_path):
    folder = tmp_path / "packed"
    for name in ("t0.tif", "t3.tif"):
        (folder / name).write_bytes((tmp_path / "plain" / name).read_bytes())
    (folder / "notes.txt.gz").write_bytes(gzip.compress(b"a"))
    assert [path.name for path in files_of(ImportSettings(str(folder)))] == ["t0.tif", "t1.zip", "t2.zip", "t3.tif"]


def test_an_archive_of_other_files_among_tiles_is_left_out(packed, tmp_path):
    """An archive that is named, or that is all there is, is refused; so is one of archives, which may hold heights."""
    run_mosaic_import(ImportSettings(str(tmp_path / "plain")), tmp_path / "one")
    other = zipped(tmp_path / "packed" / "a.zip", {"licence.txt": b"free", "in/": b""})
    for source in (tmp_path / "packed", tmp_path / "packed" / "*"):
        assert describe_sources(ImportSettings(str(source)))["files"] == 4
        report = import_source(ImportSettings(str(source)), tmp_path / "two")
        assert report["files"] == 4 and digest_of(tmp_path / "two") == digest_of(tmp_path / "one")
    lone = zipped(tmp_path / "lone" / "b.zip", {"licence.txt": b"free"})
    for settings, name in (
        (settings_of(other), "a"),
        (settings_of(tmp_path / "packed", other), "a"),
        (settings_of(lone.parent), "b"),
    ):
        with pytest.raises(TerrainError, match=f"{name}.zip holds no height map; .*: name a file of heights, such as"):
            import_source(settings, tmp_path / "three")
    zipped(other, {"inner.zip": lone.read_bytes()})
    with pytest.raises(TerrainError, match="a.zip holds no height map, but inner.zip; .*: unpack it, and import that"):
        import_source(ImportSettings(str(tmp_path / "packed")), tmp_path / "three")
    assert not (tmp_path / "three").exists()


def test_a_bad_archive_among_tiles_is_one_error_about_it(packed, tmp_path, monkeypatch):
    tif = (tmp_path / "plain" / "t1.tif").read_bytes()
    bad = tmp_path / "packed" / "t1.zip"
    for files, said in (
        ({"a.npy": b"", "b.npy": b""}, "t1.zip holds 2 height maps .a.npy, b.npy.; expected one .* or tiles"),
        ({"a.tif": tif, "b.tif": tif[:-500]}, "t1.zip/b.tif is damaged or incomplete"),
        ({"../a.tif": tif}, "whose name leads out"),
        ({"a.tif": tif, "b.tif": tif, "../c.txt": b""}, "whose name leads out"),
        ({"a.tif": tif[:-500]}, "t1.zip/a.tif is damaged or incomplete"),
        ({"a.npy": b"\x93NUMPY"}, "t1.zip/a.npy is not a whole .npy"),
    ):
        zipped(bad, files)
        with pytest.raises(TerrainError, match=said) as caught:
            run_mosaic_import(ImportSettings(str(tmp_path / "packed")), tmp_path / "store")
        assert "\n" not in str(caught.value) and ".partial" not in str(caught.value)
    zipped(bad, {"a.tif": tif})
    monkeypatch.setattr(archives, "MAX_BYTES", 1000)
    with pytest.raises(TerrainError, match="unpacks '.*' to more than 0 MB"):
        run_mosaic_import(ImportSettings(str(tmp_path / "packed")), tmp_path / "store")
    assert not (tmp_path / "store").exists()


@pytest.fixture
def archive(tmp_path):
    """Write four tiles plain and as one archive, in two folders of it, with a preview and a sidecar; return its files.

    The last tile has its coordinate system in the sidecar alone.
    """
    whole, files = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 80, 20), {"readme.txt": b"a", "view.png": b"no picture"}
    for n in range(4):
        path = tmp_path / "plain" / f"t{n}.tif"
        whole.write(path, first_column=20 * n, columns=20, **({"crs": None} if n == 3 else {}))
        files[f"{'north' if n < 2 else 'south'}/t{n}.tif"] = path.read_bytes()
    files["south/t3.prj"] = CRS.from_string(UTM32).to_wkt().encode()
    (tmp_path / "plain" / "t3.prj").write_bytes(files["south/t3.prj"])
    zipped(tmp_path / "all" / "a.zip", files)
    return files


def digest_of(store):
    return open_store(store).raster.digest


def test_an_archive_of_several_tiles_is_imported_as_its_folder(archive, tmp_path, monkeypatch):
    plain, packed = ImportSettings(str(tmp_path / "plain")), ImportSettings(str(tmp_path / "all" / "a.zip"))
    run_mosaic_import(plain, tmp_path / "one")
    report = import_source(packed, tmp_path / "two")
    assert report["files"] == 4 and digest_of(tmp_path / "two") == digest_of(tmp_path / "one")
    assert import_source(packed, tmp_path / "two")["unchanged"]
    monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 1)
    run_mosaic_import(ImportSettings(str(tmp_path / "all")), tmp_path / "three")
    assert digest_of(tmp_path / "three") == digest_of(tmp_path / "one")
    assert {entry.suffix for entry in (tmp_path / "three").glob("*/*")} == {".npy", ".json"}
    info, alone = describe_sources(packed), describe_sources(plain)
    assert {key for key in info if info[key] != alone.get(key)} <= {"expected_disk_mb", "expected_seconds"}


def test_the_directory_of_an_archive_is_read_once(archive, tmp_path, monkeypatch):
    """Unpacking, also of a tile that was removed, does not read it again: 2,000 tiles would have 4 million entries."""
    monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 1)
    read, real = [], zipfile.ZipInfo._decodeExtra  # once an entry
    monkeypatch.setattr(zipfile.ZipInfo, "_decodeExtra", lambda info, *more: read.append(info) or real(info, *more))
    run_mosaic_import(ImportSettings(str(tmp_path / "all" / "a.zip")), tmp_path / "store")
    assert [info.filename for info in read] == list(archive)


def test_options_of_several_files_hold_for_one_archive(archive, tmp_path):
    packed = ImportSettings(str(tmp_path / "all" / "a.zip"), step=20.0, priority="newest")
    assert import_source(packed, tmp_path / "store")["step_m"] == [20.0, 20.0]
    assert describe_sources(packed)["step_m"] == [20.0, 20.0]
    one = zipped(tmp_path / "one.zip", {"t0.tif": archive["north/t0.tif"], "view.png": b"no picture"})
    assert import_source(ImportSettings(str(one)), tmp_path / "store")["raster"] == [20, 20]
    assert describe_sources(ImportSettings(str(one)))["raster"] == [20, 20]
    assert size_of_heights(ImportSettings(str(one))) == (20, 20)
    with pytest.raises(TerrainError, match="A step and a priority are of several files"):
        import_source(ImportSettings(str(one), step=20.0), tmp_path / "store")


def test_a_path_into_an_archive_names_the_archive(archive, tmp_path):
    path = tmp_path / "all" / "a.zip"
    for settings in (ImportSettings(f"{path}/north/t0.tif"), settings_of(f"{path}/north/t0.tif", path)):
        with pytest.raises(TerrainError, match=r"t0.tif does not exist.*: name the archive \(.*/a.zip\), or unpack it"):
            import_source(settings, tmp_path / "store")
    assert import_source(ImportSettings(f"{path}/"), tmp_path / "store")["files"] == 4


def test_a_file_that_replaces_another_whole_is_warned_about(archive, tmp_path):
    """Archives of public elevation models hold masks and counts on the grid of the heights."""
    heights, east = archive["north/t0.tif"], archive["north/t1.tif"]
    path = zipped(tmp_path / "aster.zip", {"a_dem.tif": heights, "a_num.tif": heights, "b.tif": east})
    report = import_source(ImportSettings(str(path)), tmp_path / "store")
    [warning] = [text for text in report["warnings"] if "replaces" in text]
    assert warning.startswith("a_num.tif has all its samples at the places of those of a_dem.tif")
    assert describe_sources(ImportSettings(str(path)))["warnings"] == report["warnings"]
    plain = import_source(ImportSettings(str(tmp_path / "all" / "a.zip")), tmp_path / "other")
    assert not any("replaces" in text for text in plain["warnings"])


def test_a_changed_member_changes_its_tile_alone(archive, tmp_path, monkeypatch):
    """The date and the size of the member stay, so that only its checksum differs."""
    settings = ImportSettings(str(tmp_path / "all" / "a.zip"))
    run_mosaic_import(settings, tmp_path / "store")
    read, real = [], catalogue._read_tile
    monkeypatch.setattr(catalogue, "_read_tile", lambda path, *more: read.append(path) or real(path, *more))
    path = tmp_path / "plain" / "t1.tif"
    with rasterio.open(path, "r+") as file:
        file.write(file.read(1) + np.float32(8.0), 1)
    zipped(tmp_path / "all" / "a.zip", archive | {"north/t1.tif": path.read_bytes()})
    report = run_mosaic_import(settings, tmp_path / "store")
    assert "unchanged" not in report and read == [tmp_path / "all" / "a.zip" / "north" / "t1.tif"]
    run_mosaic_import(ImportSettings(str(tmp_path / "plain")), tmp_path / "one")
    assert digest_of(tmp_path / "store") == digest_of(tmp_path / "one")


def test_the_newest_member_is_used_where_tiles_overlap(archive, tmp_path):
    """Dates in the archive count as those of the unpacked files; impossible ones are the oldest."""
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
        for name, height, date in (
            ("a", 5.0, (2024, 5, 1, 0, 0, 0)),
            ("b", 6.0, (2021, 1, 1, 0, 0, 0)),
            ("c", 7.0, None),
        ):
            with rasterio.open(tmp_path / "plain" / "t0.tif", "r+") as file:
                file.write(np.full((20, 20), height, np.float32), 1)
            info = zipfile.ZipInfo(f"{name}.tif", date or (1980, 1, 1, 0, 0, 0))
            info.date_time = date or (1980, 0, 0, 0, 0, 0)
            packed.writestr(info, (tmp_path / "plain" / "t0.tif").read_bytes())
    for priority, height in (("order", 7.0), ("newest", 5.0)):
        run_mosaic_import(ImportSettings(str(tmp_path / "a.zip"), priority=priority), tmp_path / "store")
        assert set(np.asarray(open_store(tmp_path / "store").heights(slice(None), slice(None))).ravel()) == {height}


SIDE = 16


def web_tile(folder, zoom, column, row, height):
    """Write a Terrarium tile of one height, metres."""
    code = round((height + 32768.0) * 256)
    bands = np.empty((3, SIDE, SIDE), np.uint8)
    bands[:] = np.array([code >> 16, code >> 8 & 255, code & 255])[:, None, None]
    path = folder / str(zoom) / str(column) / f"{row}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(path, "w", driver="PNG", width=SIDE, height=SIDE, count=3, dtype="uint8") as file:
        file.write(bands)
    return path


def test_a_folder_of_web_map_tiles_is_a_source(tmp_path):
    """The finest level counts, or the one that a step names; a missing tile is a gap."""
    for column in (2133, 2134):
        for row in (1457, 1458):
            if (column, row) != (2134, 1458):
                web_tile(tmp_path / "tiles", 12, column, row, column - 2000 + row / 100)
    web_tile(tmp_path / "tiles", 11, 1066, 728, 7.0)
    web_tile(tmp_path / "tiles", 11, 1067, 728, 8.0)
    settings = ImportSettings(str(tmp_path / "tiles"), encoding="terrarium", holes=True)
    report = import_source(settings, tmp_path / "store")
    field = open_store(tmp_path / "store")
    heights = np.asarray(field.heights(slice(None), slice(None)))[::-1]
    assert report["files"] == 3 and heights.shape == (2 * SIDE, 2 * SIDE) and report["crs"] == "EPSG:3857"
    wanted = [heights[0, 0], heights[0, -1], heights[-1, 0]]
    assert wanted == pytest.approx([147.57, 148.57, 147.58], abs=1 / 256)
    assert report["cut_out"] == SIDE**2 and report["gap_percent"] == pytest.approx(25.0, abs=1.0)
    size = 2 * np.pi * 6378137.0 / 2**12
    assert field.origin[0] == pytest.approx((2134 - 2**11) * size)
    assert field.lattice.step_x == pytest.approx(size / SIDE)
    # A tile counts as 256 samples wide: zoom 11 has 76 m.
    chosen = {step: files_of(ImportSettings(settings.source, step=step)) for step in (None, 30.0, 80.0, 500.0)}
    assert {step: (len(files), files[0].parts[-3]) for step, files in chosen.items()} == {
        None: (3, "12"),
        30.0: (3, "12"),
        80.0: (2, "11"),
        500.0: (2, "11"),
    }
    inner = files_of(ImportSettings(str(tmp_path / "tiles" / "11")))
    assert [path.parts[-3:] for path in inner] == [("11", "1066", "728.png"), ("11", "1067", "728.png")]


def test_a_picture_among_web_map_tiles_is_refused(tmp_path):
    web_tile(tmp_path / "tiles", 12, 2133, 1457, 300.0)
    picture = tmp_path / "tiles" / "12" / "2133" / "1458.png"
    write_raster(picture, np.random.default_rng(1).integers(0, 255, (SIDE, SIDE), np.uint8))
    with pytest.raises(TerrainError, match=r"1458.png cannot be a part .*name the encoding of its colours"):
        run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    with pytest.raises(TerrainError, match="holds 1 band.* so no heights coded as terrarium"):
        run_mosaic_import(ImportSettings(str(tmp_path / "tiles"), encoding="terrarium"), tmp_path / "store")
    picture.unlink()
    assert run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")["crs"] == "EPSG:3857"
