# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 63: height maps that are attacks. Each layer of the defence is tested alone."""

import http.server
import json
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_info import describe_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import child, stall
from forked_programs import run_program
from hostile_files import PART, damaged, seeds, source, vrt, write_attacks
from rasters import hills, imported, write_raster

pytestmark = pytest.mark.skipif(os.name != "posix", reason="named pipes, signals and limits are those of POSIX")
GUARD_S = 300  # ends a hang
MANY = max(12, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 20)  # damaged files of each kind


@pytest.fixture
def server():
    """Run a local HTTP server; return its port and the list of paths requested from it."""
    paths = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            paths.append(self.path)
            self.send_error(404)

        do_HEAD = do_GET

        def log_message(self, *_):
            pass

    http_server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=http_server.serve_forever, daemon=True).start()
    yield http_server.server_port, paths
    http_server.shutdown()
    http_server.server_close()


def snapshot(folder):
    return {p: (p.stat().st_size, p.stat().st_mtime_ns) for p in folder.rglob("*")}


def test_case_63_no_attack_reaches_gdal(tmp_path, server):
    """Our VRT reader alone refuses each of 35 hostile VRTs in one sentence, before GDAL opens them."""
    expected = write_attacks(tmp_path, server[0])
    before = snapshot(tmp_path)
    assert len(expected) == 35
    for name, cause in expected.items():
        with pytest.raises(TerrainError) as caught:
            open_source(ImportSettings(source=str(tmp_path / name)))
        message = str(caught.value)
        whole = cause in message and "\n" not in message and message.endswith(".") and len(message) < 700
        assert whole, (name, message)
    assert snapshot(tmp_path) == before and server[1] == []


def test_case_63_an_attack_is_one_error_of_import_and_info(tmp_path, server):
    """`import` and `info` refuse an attack in one sentence, write nothing and contact no server."""
    write_attacks(tmp_path, server[0])
    before = snapshot(tmp_path)
    settings = ImportSettings(source=str(tmp_path / "service.vrt"))
    for read in (lambda: import_source(settings, tmp_path / "store"), lambda: describe_source(settings)):
        with pytest.raises(TerrainError, match="service.vrt names the source .* no regular file here; expected.*[.]$"):
            read()
    assert snapshot(tmp_path) == before and server[1] == []


# Try the attacks in the sandboxed child process without our VRT reader.
BARE = """
import json, os, socket, subprocess, sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.sandbox.guard import guard
folder, attacked = Path(sys.argv[1]), sys.argv[2:]
(folder / "store").mkdir()
said = guard([folder / "a.vrt"], folder / "store")
import rasterio

def outcome(do):
    try:
        do()
    except Exception as reason:
        return type(reason).__name__
    return "done"

def read(name):
    with rasterio.open(folder / name, driver="VRT") as dataset:
        dataset.read(1)

with rasterio.Env() as env:
    drivers = sorted(env.drivers())
print(json.dumps({"said": said, "drivers": drivers, "attacks": {name: outcome(lambda: read(name)) for name in attacked},
    "inside": outcome(lambda: (folder / "store" / "a").write_text("a")),
    "outside": outcome(lambda: (folder / "a").write_text("a")),
    "cut": outcome(lambda: os.truncate(folder / "secret.txt", 1)),
    "gone": outcome(lambda: os.remove(folder / "secret.txt")),
    "moved": outcome(lambda: os.rename(folder / "store" / "a", folder / "b")),
    "socket": outcome(socket.socket), "program": outcome(lambda: subprocess.run(["true"])),
    "memory": outcome(lambda: bytearray(1 << 45))}))
"""


def test_case_63_the_reading_process_is_sandboxed(tmp_path, server):
    """Without our reader, GDAL has five drivers and, if the kernel can, no socket, program or write elsewhere."""
    write_attacks(tmp_path, server[0])
    before = snapshot(tmp_path)
    attacks = ["service.vrt", *(f"network{i}.vrt" for i in range(9)), "inline.vrt"]
    command = [sys.executable, "-c", BARE, str(tmp_path), *attacks]
    done = subprocess.run(command, capture_output=True, text=True, timeout=GUARD_S)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["drivers"] == ["AAIGrid", "GTiff", "PNG", "SRTMHGT", "VRT"]
    assert "done" not in found["attacks"].values() and server[1] == [] and not (tmp_path / "out").exists(), found
    assert found["inside"] == "done" and found["memory"] == "MemoryError"
    for what, attempt in {"network": "socket", "programs": "program"}.items():
        assert found[attempt] == ("PermissionError" if found["said"][what] == "dropped" else "done"), found
    if found["said"]["writes"] != "dropped":
        pytest.skip(f"writing elsewhere: {found['output']['writes']}")
    assert {found[name] for name in ("outside", "cut", "gone", "moved")} <= {"PermissionError", "OSError"}, found
    after = snapshot(tmp_path)
    assert all(after[path] == before[path] for path in before if path != tmp_path)


def test_case_63_a_reader_that_hangs_is_stopped(tmp_path, monkeypatch):
    """`import` and `info` stop a reader that never answers, with one sentence."""

    def start(_module, variables, **streams):
        command = [sys.executable, "-c", "import time; time.sleep(600)"]
        return subprocess.Popen(command, stdin=subprocess.PIPE, env=os.environ | variables, **streams)

    monkeypatch.setattr(stall, "STALL_SECONDS", 3.0)
    monkeypatch.setattr(child, "start", start)
    grid = write_raster(tmp_path / "a.asc", hills(9, 9))
    settings = ImportSettings(source=str(grid))
    for read in (lambda: import_source(settings, tmp_path / "store"), lambda: describe_source(settings)):
        with pytest.raises(
            TerrainError,
            match="a.asc made no progress for 3 s and was stopped; expected .*: write it again as a plain GeoTIFF[.]$",
        ):
            read()
    assert not (tmp_path / "store").exists()


def test_case_63_an_honest_mosaic_reads_as_before(tmp_path):
    """Three nested VRTs with windows, a scale, no-data and a mask give the samples that GDAL reads."""
    import rasterio

    heights = hills(65, 33)
    heights[3, 5] = -9999.0
    write_raster(tmp_path / PART, heights)
    windows = (
        '<SourceProperties RasterXSize="65" RasterYSize="33" DataType="Float32" BlockXSize="65" BlockYSize="31"/>'
        '<SrcRect xOff="0" yOff="0" xSize="65" ySize="33"/><DstRect xOff="0" yOff="0" xSize="65" ySize="33"/>'
    )
    scaled = windows + "<ScaleOffset>5</ScaleOffset><ScaleRatio>2</ScaleRatio><NODATA>-9999</NODATA>"
    part = source(PART, kind="ComplexSource", more=scaled)
    (tmp_path / "c.vrt").write_text(
        vrt("<Metadata><MDI key='a'>b</MDI></Metadata><NoDataValue>-1</NoDataValue>" + part)
    )
    (tmp_path / "b.vrt").write_text(vrt("<NoDataValue>-1</NoDataValue>" + source("c.vrt", more=windows)))
    (tmp_path / "a.vrt").write_text(vrt("<NoDataValue>-1</NoDataValue>" + source("b.vrt")))
    field, report = imported(tmp_path, tmp_path / "a.vrt")
    with rasterio.open(tmp_path / "a.vrt") as dataset:
        wanted = dataset.read(1)
    assert report["filled"] == 1 and wanted[3, 5] == -1.0
    wanted[3, 5] = field.heights()[::-1][3, 5]
    assert np.array_equal(field.heights()[::-1], wanted) and wanted[0, 0] == 2.0 * heights[0, 0] + 5.0


@pytest.mark.usefixtures("fork_children")
def test_case_63_a_changed_source_of_a_mosaic_is_noticed(tmp_path):
    """A second import of a mosaic does nothing; a third with other samples runs; the calling process parses nothing."""
    write_raster(tmp_path / PART, hills(65, 33))
    (tmp_path / "inner.vrt").write_text(vrt(source(PART)))
    (tmp_path / "a.vrt").write_text(vrt(source("inner.vrt")))
    settings = ImportSettings(source=str(tmp_path / "a.vrt"))
    first = import_source(settings, tmp_path / "store")
    assert import_source(settings, tmp_path / "store") == first | {"unchanged": True}
    write_raster(tmp_path / PART, 2.0 * hills(65, 33))
    os.utime(tmp_path / PART, (1, 1))
    assert "unchanged" not in import_source(settings, tmp_path / "store")
    assert np.array_equal(open_store(tmp_path / "store").heights(), 2.0 * hills(65, 33)[::-1])
    (tmp_path / "a.vrt").write_text("<SourceFilename" * 30_000)
    assert len(source_digest(settings)) == 64  # parsing this would take minutes


def small_tiff(width, height, samples, strip):
    """Return a TIFF of zeros in one strip, with the given values in its header."""
    tags = {
        256: width,
        257: height,
        258: 32,
        259: 1,
        262: 1,
        273: 8,
        277: samples,
        278: height,
        279: strip,
        284: 1,
        339: 3,
    }
    entries = b"".join(
        tag.to_bytes(2, "little") + b"\4\0\1\0\0\0" + value.to_bytes(4, "little") for tag, value in tags.items()
    )
    return b"II*\0\x08\0\0\0" + len(tags).to_bytes(2, "little") + entries + bytes(4)


def test_case_63_limits_are_asked_of_the_header(tmp_path):
    """Headers with 65,535 bands or pieces of gigabytes, also of a mosaic's source, are refused in one sentence."""
    import rasterio

    (tmp_path / "bands.tif").write_bytes(small_tiff(8, 8, 65_535, 256))
    options = {"count": 1, "dtype": "uint16", "compress": "zstd", "blockysize": 30_000, "SPARSE_OK": True}
    with rasterio.open(tmp_path / "piece.tif", "w", driver="GTiff", width=30_000, height=30_000, **options):
        pass
    (tmp_path / "piece.vrt").write_text(vrt(source("piece.tif")))
    bands = "".join(f'<VRTRasterBand dataType="Byte" band="{i}"/>' for i in range(1, 2000))
    (tmp_path / "bands.vrt").write_text(f'<VRTDataset rasterXSize="9" rasterYSize="9">{bands}</VRTDataset>')
    expected = {"bands.tif": "65535 bands", "piece.tif": "1.8 GB", "piece.vrt": "1.8 GB", "bands.vrt": "1999 bands"}
    for name, cause in expected.items():
        with pytest.raises(TerrainError, match=f"{cause}; expected .*[.]$"):
            open_source(ImportSettings(source=str(tmp_path / name)))


# Import every file of a folder as the child process does, and print the outcome of each.
READER = """
import json, sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.sandbox.guard import guard_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
folder, store = Path(sys.argv[1]), Path(sys.argv[2])
files = sorted(folder.iterdir())
guard_import(ImportSettings(source=str(files[0])), store)
for file in files:
    print(json.dumps({"begun": file.name}), flush=True)
    try:
        run_import(ImportSettings(source=str(file)), store)
        print(json.dumps({"file": file.name, "said": None}), flush=True)
    except TerrainError as error:
        print(json.dumps({"file": file.name, "said": str(error)}), flush=True)
"""


@pytest.mark.parametrize("files", [4, pytest.param(MANY, marks=pytest.mark.thorough)])
def test_case_63_damaged_files_are_terrains_or_one_error(tmp_path, files):
    """Damaged TIFF, PNG, ASCII, EXR, NumPy and VRT files give a terrain or one sentence, and write only the store."""
    random = np.random.default_rng(63)
    (tmp_path / "good").mkdir()
    refused = 0
    for seed in seeds(tmp_path / "good"):
        folder = tmp_path / seed.name.replace(".", "_")
        folder.mkdir()
        for i in range(files):
            text = seed.read_bytes().replace(b"strips.tif", b"../good/strips.tif")
            (folder / f"{i}{seed.suffix}").write_bytes(damaged(text, random))
        before = snapshot(tmp_path)
        store = tmp_path / f"{folder.name}.store"
        done = run_program(READER, folder, store, timeout=GUARD_S + 2 * files)
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        output = {line["file"]: line["said"] for line in lines if "file" in line}
        assert done.returncode == 0 and len(output) == files, (lines[-1:], done.stderr[-2000:])
        for message in filter(None, output.values()):
            assert "\n" not in message and message.endswith(".") and len(message) < 900, message
            refused += 1
        after = snapshot(tmp_path)
        new = [path for path in after if path != store and store not in path.parents and path not in before]
        assert new == [] and all(after[path] == before[path] for path in before if path != tmp_path)
    assert refused > files
