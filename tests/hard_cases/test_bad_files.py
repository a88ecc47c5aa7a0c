# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 20: truncated and corrupted files, files with false headers, deleted files, and a full disk."""

import json
import shutil
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.drafts import open_draft
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from invariants import arrays, assert_invariants
from rasters import hills, imported, write_exr, write_raster


def lying_tiff(path):
    """Write a TIFF whose header declares 10^9 x 10^9 samples."""
    content = bytearray(write_raster(path, hills(33, 33)).read_bytes())
    for tag in (256, 257):
        at = content.index(struct.pack("<HHI", tag, 3, 1))
        content[at : at + 12] = struct.pack("<HHII", tag, 4, 1, 10**9)
    path.write_bytes(content)


def lying_png(path):
    content = bytearray(write_raster(path, hills(33, 33).astype(np.uint16)).read_bytes())
    content[16:24] = struct.pack(">II", 10**9, 10**9)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    path.write_bytes(content)


def lying_exr(path):
    content = bytearray(write_exr(path, Y=hills(33, 33)).read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    content[at : at + 16] = struct.pack("<4i", 0, 0, 10**9 - 1, 10**9 - 1)
    path.write_bytes(content)


def lying_npy(path):
    with path.open("wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": (10**9, 10**9)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(1000))


def lying_asc(path):
    path.write_text("ncols 1000000000\nnrows 1000000000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")


def lying_vrt(path):
    path.write_text(
        '<VRTDataset rasterXSize="1000000000" rasterYSize="1000000000">'
        '<VRTRasterBand dataType="Float32" band="1"/></VRTDataset>'
    )


def bomb_tiff(path):
    """Write a file of megabytes that unpacks to 1 TB."""
    import rasterio

    options = {"tiled": True, "blockxsize": 1024, "blockysize": 1024, "compress": "deflate", "SPARSE_OK": "TRUE"}
    with rasterio.open(path, "w", width=500_000, height=500_000, count=1, dtype="float32", **options):
        pass


def bomb_tile(path):
    """Write a TIFF that declares one tile of 34 GB."""
    content = bytearray(write_raster(path, hills(64, 64), tiled=True, blockxsize=64, blockysize=64).read_bytes())
    for tag in (322, 323):
        at = content.index(struct.pack("<HHI", tag, 3, 1))
        content[at : at + 12] = struct.pack("<HHII", tag, 4, 1, 92672)
    path.write_bytes(content)


def bomb_png(path):
    """Write a picture of 30,000 x 60,000 zeros in a few kilobytes that ends after its first rows."""
    header = struct.pack(">IIBBBBB", 60_000, 30_000, 16, 0, 0, 0, 0)
    data = zlib.compress(bytes(1_000_000), 9)
    chunks = [(b"IHDR", header), (b"IDAT", data), (b"IEND", b"")]
    packed = [struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))


def half_of(write):
    def written(path):
        write(path)
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])

    return written


def noise_in(write, first=0.4, last=0.9):
    def written(path):
        write(path)
        content = bytearray(path.read_bytes())
        a, b = int(len(content) * first), int(len(content) * last)
        content[a:b] = np.random.default_rng(3).integers(0, 256, b - a, np.uint8).tobytes()
        path.write_bytes(content)

    return written


def whole_tiff(path):
    write_raster(path, hills(200, 200), compress="deflate")


def whole_png(path):
    write_raster(path, hills(200, 200).astype(np.uint16))


def whole_exr(path):
    write_exr(path, Y=hills(200, 200))


def whole_npy(path):
    np.save(path, hills(200, 200))


def whole_asc(path):
    rows = "\n".join(" ".join(f"{h:.1f}" for h in row) for row in hills(20, 20))
    path.write_text(f"ncols 20\nnrows 20\nxllcorner 0\nyllcorner 0\ncellsize 1\n{rows}\n")


def whole_hgt(path):
    np.zeros((1201, 1201), ">i2").tofile(path)


def broken_vrt(path):
    path.write_text(
        '<VRTDataset rasterXSize="33" rasterYSize="33"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">gone.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


def network_vrt(path):
    broken_vrt(path)
    text = path.read_text().replace(
        'relativeToVRT="1">gone.tif', 'relativeToVRT="0">/vsicurl/http://10.255.255.1/a.tif'
    )
    path.write_text(text)


def pickled_npy(path):
    np.save(path, np.array([[{"a": 1}]], dtype=object), allow_pickle=True)


BAD_FILES = {
    "lying.tif": lying_tiff,
    "lying.png": lying_png,
    "lying.exr": lying_exr,
    "lying.npy": lying_npy,
    "lying.asc": lying_asc,
    "lying.vrt": lying_vrt,
    "bomb.tif": bomb_tiff,
    "tile.tif": bomb_tile,
    "bomb.png": bomb_png,
    "half.tif": half_of(whole_tiff),
    "half.png": half_of(whole_png),
    "half.exr": half_of(whole_exr),
    "half.npy": half_of(whole_npy),
    "half.asc": half_of(whole_asc),
    "N00E000.hgt": half_of(whole_hgt),
    "noise.tif": noise_in(whole_tiff),
    "noise.png": noise_in(whole_png),
    "noise.exr": noise_in(whole_exr),
    "all noise.tif": noise_in(whole_tiff, 0.0, 1.0),
    "all noise.exr": noise_in(whole_exr, 0.0, 1.0),
    "all noise.npy": noise_in(whole_npy, 0.0, 1.0),
    "wrong name.hgt": whole_hgt,
    "not a number.raw": lambda path: path.write_bytes(b"x" * 1001),
    "gone.vrt": broken_vrt,
    "network.vrt": network_vrt,
    "pickle.npy": pickled_npy,
    "empty.tif": lambda path: path.write_bytes(b""),
    "folder.tif": lambda path: path.mkdir(),
    "missing.tif": lambda path: None,
    "picture.jpg": lambda path: path.write_bytes(b"\xff\xd8\xff\xe0"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_case_20_a_bad_file_is_one_error_and_the_store_stays(tmp_path, name):
    """Each truncated, corrupted or falsified file gives one sentence with its name, and the store keeps its key."""
    imported(tmp_path, "island", size=17)
    key = open_store(tmp_path / "store").key
    path = tmp_path / name
    BAD_FILES[name](path)
    with pytest.raises(TerrainError) as caught:
        imported(tmp_path, path)
    message = str(caught.value)
    assert name in message and message.endswith(".") and "\n" not in message and len(message) < 500
    assert open_store(tmp_path / "store").key == key and len(list((tmp_path / "store").glob("data-*"))) == 1


# Import every file given as an argument and print how much memory the process has gained after each.
HUNGER = """
import json, resource, sys
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
run_import(ImportSettings(source="island", size=17), sys.argv[1] + "/warm")
usage = lambda: resource.getrusage(resource.RUSAGE_SELF)
before, added = usage().ru_maxrss, {}
for source in sys.argv[2:]:
    try:
        run_import(ImportSettings(source=source), sys.argv[1] + "/store")
    except TerrainError:
        added[source] = usage().ru_maxrss - before
print(json.dumps(added))
"""


def test_case_20_bad_files_cost_no_memory(tmp_path):
    """Reading all bad files in one process raises its peak memory by less than 256 MB."""
    paths = [tmp_path / name for name in BAD_FILES]
    for path in paths:
        BAD_FILES[path.name](path)
    command = [sys.executable, "-c", HUNGER, str(tmp_path), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)  # only so that a hang ends
    added = json.loads(done.stdout.splitlines()[-1])
    assert sorted(added) == sorted(map(str, paths)), done.stderr
    assert max(added.values()) < 256 * 1024, added  # kilobytes
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(
    "name", ["lying.tif", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("lying.exr", "bomb.tif"))]
)
def test_case_20_a_bad_file_in_the_child_process(tmp_path, name):
    """The caller receives the error of the import's child process, and no folder is left."""
    BAD_FILES[name](tmp_path / name)
    with pytest.raises(TerrainError, match=name):
        import_source(ImportSettings(source=str(tmp_path / name)), tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_case_20_a_full_disk(tmp_path, monkeypatch):
    """A disk full before, during or after writing the arrays gives one sentence, and the store stays."""
    imported(tmp_path, "island", size=17)
    key = open_store(tmp_path / "store").key

    def is_kept(message):
        with pytest.raises(TerrainError, match=message):
            imported(tmp_path, "island", size=257)
        assert open_store(tmp_path / "store").key == key and len(list((tmp_path / "store").glob("data-*"))) == 1

    def full(*_args, **_folders):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _path: shutil._ntuple_diskusage(10**9, 10**9, 10**5))
        is_kept("MB are free: make room or choose another folder, or import island with fewer samples .--size..$")
        np.save(tmp_path / "dem.npy", np.zeros((200, 200), np.float32))
        with pytest.raises(TerrainError, match="or check that the header of .*dem.npy has its true size"):
            imported(tmp_path, tmp_path / "dem.npy")
    with monkeypatch.context() as patch:
        patch.setattr(stores.os, "posix_fallocate", full)
        is_kept("No space left on device.: make room")
    with monkeypatch.context() as patch:
        patch.setattr(stores.os, "replace", full)
        is_kept("No space left on device.: make room")


@pytest.mark.parametrize("needed, text", [(2_400_000, "needs 2.4 MB in .* 2.3 MB"), (3 * 10**9, "3.0 GB in .* 2.9 GB")])
def test_case_20_needed_room_differs_from_free_room(tmp_path, monkeypatch, needed, text):
    """The amounts are not rounded to the same number."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: shutil._ntuple_diskusage(0, 0, needed - 1))
    lattice = Lattice(1, 1, 8)
    with pytest.raises(TerrainError, match=text), open_draft(tmp_path / "store", None, lattice, needed):
        pass


def test_case_20_a_folder_that_may_not_be_written(tmp_path):
    """A store inside a file is refused."""
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(TerrainError, match="cannot be written"):
        run_import(ImportSettings(source="island", size=17), tmp_path / "file" / "store")


def test_case_20_a_file_deleted_while_in_use(tmp_path):
    """A raster deleted during its import is imported whole, or the error names it and no store is left."""
    source = write_raster(tmp_path / "a.tif", hills(257, 257), blockysize=1)

    def delete(_fraction, _message):
        source.unlink(missing_ok=True)

    try:
        run_import(ImportSettings(source=str(source)), tmp_path / "store", delete)
    except TerrainError as error:
        assert "a.tif" in str(error)
        assert not (tmp_path / "store").exists()
    else:  # the operating system keeps an open file readable
        assert open_store(tmp_path / "store").max_height == hills(257, 257).max()


def test_case_20_a_store_deleted_while_in_use(tmp_path):
    """A store deleted while open stays readable and gives the same mesh; opening it again is an error."""
    imported(tmp_path, "island", size=65)
    field = open_store(tmp_path / "store")
    peak, criterion = float(field.samples.max()), Criterion(error_px=0.0, error_m=5.0)
    before = arrays(Terrain(field, 1).update(criterion).surface)
    shutil.rmtree(tmp_path / "store")
    assert float(field.samples.max()) == peak and error_for(field, 1).shape == field.error.shape
    surface = Terrain(field, 1).update(criterion).surface
    assert_invariants(surface, field.lattice)
    assert arrays(surface) == before
    assert not (tmp_path / "store").exists()
    with pytest.raises(TerrainError, match="no terrain store"):
        open_store(tmp_path / "store")


def test_case_20_a_report_is_plain_json(tmp_path):
    """The report of an import is JSON without NaN or infinity."""
    json.dumps(imported(tmp_path, "island", size=17)[1], allow_nan=False)
