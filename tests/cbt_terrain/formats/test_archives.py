# SPDX-License-Identifier: GPL-3.0-or-later
"""Height maps in .zip and .gz files."""

import gzip
import stat
import zipfile

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store_folder
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.formats import archives
from adaptive_terrain.cbt_terrain.importing import build_store
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_info import describe_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from height_files import METRES, heights, write_surfer6
from rasterio.transform import from_origin
from rasters import hills, imported, write_raster

PLACE = {"crs": "EPSG:32612", "transform": from_origin(5e5, 4e6, 30.0, 30.0)}


def zipped(path, files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def same_heights(field, wanted):
    return np.array_equal(field.heights(slice(None), slice(None))[::-1], wanted)


def test_a_zipped_hgt_is_read_by_its_own_name(tmp_path):
    values = np.rint(hills(1201, 1201)).astype(">i2")
    files = {"readme.txt": b"see N46E007.hgt", "__MACOSX/._N46E007.hgt": b"x", "N46E007.hgt": values.tobytes()}
    source = zipped(tmp_path / "N46E007.SRTMGL3.hgt.zip", files)
    report = import_source(ImportSettings(str(source)), tmp_path / "store")
    assert report["format"] == "SRTMHGT" and report["crs"] == "EPSG:4326"
    field = open_store(tmp_path / "store")
    assert same_heights(field, values) and field.provenance["settings"]["source"] == str(source)
    (folder,) = [entry for entry in (tmp_path / "store").iterdir() if entry.is_dir()]
    assert all(entry.suffix == ".npy" for entry in folder.iterdir())
    assert import_source(ImportSettings(str(source)), tmp_path / "store")["unchanged"]


def test_a_gzipped_tiff_and_its_summary_agree_with_the_file(tmp_path):
    plain = write_raster(tmp_path / "a.tif", hills(33, 17), **PLACE)
    (tmp_path / "b.tif.gz").write_bytes(gzip.compress(plain.read_bytes()))
    field, report = imported(tmp_path, tmp_path / "b.tif.gz")
    assert same_heights(field, hills(33, 17)) and report["crs"] == "EPSG:32612" and report["step_m"] == [30.0, 30.0]
    described = describe_source(ImportSettings(str(tmp_path / "b.tif.gz")))
    assert described == describe_source(ImportSettings(str(plain))) | {"path": str(tmp_path / "b.tif.gz")}


def test_files_beside_the_height_map_come_with_it(tmp_path):
    """A header and a .prj in a folder of the archive count. Surfer's first bytes differ from GMT's."""
    values = np.rint(hills(9, 7)).astype("<i2")
    header = "nrows 7\nncols 9\nnbits 16\nbyteorder I\npixeltype SIGNEDINT\n"
    header += "ulxmap 500015\nulymap 4000000\nxdim 30\nydim 30\n"
    system = open_crs(tmp_path)
    files = {"in/a.bil": values.tobytes(), "in/a.hdr": header, "in/a.prj": system, "a.prj": "no system"}
    field, report = imported(tmp_path, zipped(tmp_path / "a.zip", files))
    assert same_heights(field, values) and report["crs"] == "EPSG:32612" and report["step_m"] == [30.0, 30.0]
    grid = write_surfer6(tmp_path / "s.grd", heights(), *METRES).read_bytes()
    report = import_source(ImportSettings(str(zipped(tmp_path / "s.zip", {"s.grd": grid}))), tmp_path / "store")
    assert report["format"] == "GSBG" and report["filled"] == 1


def test_files_beside_a_gzipped_height_map_count(tmp_path):
    """A mask and a coordinate system beside dem.asc.gz count like those beside dem.asc, and a change of them, too."""
    heights = np.rint(hills(9, 7)).astype(int)
    rows = "\n".join(" ".join(map(str, row)) for row in heights)
    text = f"ncols 9\nnrows 7\nxllcorner 500000\nyllcorner 4000000\ncellsize 30\n{rows}\n"
    (tmp_path / "in").mkdir()
    source = tmp_path / "in" / "dem.asc.gz"
    source.write_bytes(gzip.compress(text.encode()))
    (tmp_path / "in" / "dem.prj").write_text(open_crs(tmp_path))
    _, report = imported(tmp_path, source, holes=True)
    assert (report["crs"], report["cut_out"]) == ("EPSG:32612", 0)
    before = source_digest(ImportSettings(str(source)))
    mask = write_raster(tmp_path / "mask.tif", np.where(heights > np.median(heights), 255, 0).astype(np.uint8))
    with rasterio.open(mask, "r+") as file:
        file.update_tags(INTERNAL_MASK_FLAGS_1="2")
    mask.rename(tmp_path / "in" / "dem.asc.msk")
    (tmp_path / "in" / "dem.asc.ovr").write_bytes(bytes((1 << 24) + 1))  # is left out
    assert source_digest(ImportSettings(str(source))) != before
    report = import_source(ImportSettings(str(source), holes=True), tmp_path / "store")
    assert (report["crs"], report["cut_out"]) == ("EPSG:32612", (heights <= np.median(heights)).sum())


def test_a_large_mask_in_an_archive_counts(tmp_path):
    """Other files beside a height map may have 16 MB. Samples of a mask or of an Erdas Imagine may have more."""
    heights, side = np.rint(hills(40, 30)).astype(np.int16), 4200
    large = {"height": side, "width": side, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "a.tif.msk", "w", driver="GTiff", **large) as mask:
        mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
        mask.write(np.full((30, 25), 255, np.uint8), 1, window=((0, 30), (0, 25)))
    assert (tmp_path / "a.tif.msk").stat().st_size > 1 << 24
    files = {"a.tif": write_raster(tmp_path / "a.tif", heights, **PLACE).read_bytes()}
    source = zipped(tmp_path / "a.zip", files | {"a.tif.msk": (tmp_path / "a.tif.msk").read_bytes()})
    assert imported(tmp_path, source, holes=True)[1]["cut_out"] == 30 * 15


def open_crs(folder):
    """Return the WKT of UTM zone 12."""
    with rasterio.open(write_raster(folder / "crs.tif", hills(3, 3), **PLACE)) as dataset:
        return dataset.crs.to_wkt()


def test_an_image_in_an_archive_has_the_heights_of_an_image(tmp_path):
    plain = write_raster(tmp_path / "a.png", np.arange(80, dtype=np.uint16).reshape(8, 10))
    field, report = imported(tmp_path, zipped(tmp_path / "a.zip", {"a.png": plain.read_bytes()}))
    assert (field.min_height, field.max_height) == (0.0, 2.25) and "a.png, 0 to 79" in " ".join(report["warnings"])


def linked(path):
    info = zipfile.ZipInfo("a.tif")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(info, "/etc/passwd")


def encrypted(path):
    zipped(path, {"a.tif": b"II*\0"})
    content = bytearray(path.read_bytes())
    content[6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(content)


def understated(path):
    """Write 64 MB of zeros whose directory declares 1,000 bytes."""
    zipped(path, {"a.npy": bytes(64 << 20)})
    content = path.read_bytes()
    path.write_bytes(content.replace((64 << 20).to_bytes(4, "little"), (1000).to_bytes(4, "little")))


def cut(path):
    zipped(path, {"a.tif": bytes(range(256)) * 40})
    path.write_bytes(path.read_bytes()[:-30])


THAT = "expected one height map in an archive, or tiles with a position: unpack it, and import that."
BAD = {
    "two.zip": ({"a.tif": b"", "b.hgt": b""}, "holds 2 height maps .a.tif, b.hgt.; expected one"),
    "none.zip": ({"readme.txt": b"a", ".a.zip": b""}, "holds no height map; .*: name a file of heights, such as .tif"),
    "mosaic.zip": ({"a.vrt": b"<VRTDataset/>"}, "mosaic.zip holds no height map, but a.vrt; .*: unpack it, and import"),
    "nested.zip": ({"in/a.zip": b"PK", "b.gz": b""}, f"nested.zip holds no height map, but in/a.zip, b.gz; {THAT}"),
    "web.zip": ({"12/7/8.png": b"", "12/7/9.png": b""}, "holds 2 .*: unpack it, and import the folder of web map"),
    "above.zip": ({"../a.tif": b"II"}, "holds '../a.tif', whose name leads out"),
    "absolute.zip": ({"/etc/a.tif": b"II"}, "holds '/etc/a.tif', whose name leads out"),
    "drive.zip": ({"C:a.tif": b"II"}, "whose name leads out"),
    "link.zip": (linked, "holds 'a.tif', which is a link"),
    "long.zip": ({f"in/{'a' * 252}.tif": b"II"}, "whose name has more than 255 bytes"),
    "secret.zip": (encrypted, "which is encrypted"),
    "liar.zip": (understated, "cannot be unpacked"),
    "cut.zip": (cut, "cannot be unpacked"),
    "text.zip": (lambda path: path.write_text("no zip"), "cannot be unpacked .File is not a zip file"),
    "bad.zip": ({"bad.tif": b"II*\0"}, "bad.zip/bad.tif cannot be read as GTiff"),
    "a.tar.gz": (lambda path: path.write_bytes(gzip.compress(b"a")), f"holds no height map, but a.tar; {THAT}"),
    "a.txt.gz": (lambda path: path.write_bytes(gzip.compress(b"a")), "holds no height map; .*: name a file of heights"),
    "a.tif.gz": (lambda path: path.write_bytes(gzip.compress(bytes(99))[:-9]), "cannot be unpacked"),
    "b.tif.gz": (lambda path: path.write_bytes(b"no gzip"), "cannot be unpacked .Not a gzipped file"),
    "missing.zip": (lambda path: None, "missing.zip does not exist"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_unusable_archive_is_one_error_and_leaves_nothing(tmp_path, name):
    write, said = BAD[name]
    zipped(tmp_path / name, write) if isinstance(write, dict) else write(tmp_path / name)
    with pytest.raises(TerrainError, match=said) as caught:
        imported(tmp_path, tmp_path / name)
    assert "\n" not in str(caught.value) and ".partial" not in str(caught.value)
    assert not (tmp_path / "store").exists()


def test_a_missing_archive_among_several_sources_does_not_exist(tmp_path):
    named = str(tmp_path / "no.zip")
    for settings in (ImportSettings(named, more_sources=("a.tif",)), ImportSettings("a.tif", more_sources=(named,))):
        with pytest.raises(TerrainError, match="no.zip does not exist; expected the file of a height map"):
            import_source(settings, tmp_path / "store")


@pytest.mark.parametrize("more", [(), ("https://tiles.org/12/7/9.png",)])
def test_a_web_address_is_refused_with_the_way_out(tmp_path, more):
    for name in ("https://tiles.org/12/7/8.png", "http://tiles.org/a.zip")[: 1 if more else 2]:
        settings = ImportSettings(name, more_sources=more)
        with pytest.raises(TerrainError, match="does not exist; expected the file of a height map: download it first"):
            import_source(settings, tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_a_bomb_is_stopped_at_its_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "MAX_BYTES", 1 << 20)
    (tmp_path / "a.npy.gz").write_bytes(gzip.compress(bytes(3 << 20)))
    zipped(tmp_path / "a.zip", {"a.npy": bytes(3 << 20)})
    for name in ("a.npy.gz", "a.zip"):
        with pytest.raises(TerrainError, match=f"{name} unpacks 'a.npy' to more than 1 MB"):
            imported(tmp_path, tmp_path / name)
    assert not (tmp_path / "store").exists()


def test_the_child_of_an_import_refuses_an_archive_in_one_error(tmp_path):
    source = zipped(tmp_path / "a.zip", {"a.tif": b"II*\0" + bytes(90)})
    for read in (describe_source, lambda settings: import_source(settings, tmp_path / "store")):
        with pytest.raises(TerrainError, match="a.zip/a.tif cannot be read as GTiff"):
            read(ImportSettings(str(source)))
    assert not (tmp_path / "store").exists()


def test_a_killed_import_leaves_no_unpacked_file(tmp_path, monkeypatch):
    """The folder of unpacked files is removed with the folder of arrays, and counts as one of this program."""
    folder = store_folder.new_data_name()
    scratch = tmp_path / "store" / store_folder.scratch_name(folder)
    assert scratch.name != folder and scratch.name[:13] == folder[:13] and len(scratch.name) == len(folder)
    source = zipped(tmp_path / "a.zip", {"a.npy": b"\x93NUMPY"})
    monkeypatch.setattr(archives.partial_files, "end_work", lambda *_: None)
    monkeypatch.setattr(archives.store_folder, "remove_arrays", lambda *_: None)
    monkeypatch.setattr(archives.owned_files, "remove_tree", lambda *_, **__: None)
    with pytest.raises(TerrainError):
        build_store.run_import(ImportSettings(str(source)), tmp_path / "store", folder=folder)
    assert [entry.name for entry in scratch.glob("*/*/*")] == ["a.npy"]
    monkeypatch.undo()
    assert store_folder.foreign(tmp_path / "store") == []
    store_folder.discard(tmp_path / "store", folder, [tmp_path / "store"])
    assert not (tmp_path / "store").exists()


def test_raw_float32_needs_no_type(tmp_path):
    """A .r32 holds float32 unless another type of 32 bits is given."""
    values = hills(6, 6).astype("<f4")
    values.tofile(tmp_path / "a.r32")
    assert same_heights(imported(tmp_path, tmp_path / "a.r32")[0], values)
    values.astype("<i4").tofile(tmp_path / "a.r32")
    whole = imported(tmp_path, tmp_path / "a.r32", raw_dtype="int32")[0]
    assert same_heights(whole, values.astype(np.int32))
