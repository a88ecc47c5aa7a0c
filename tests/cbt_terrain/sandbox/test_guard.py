# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that reads height maps: loading, dropping rights, and the answers to `info`."""

import json
import os
import struct
import sys
import tempfile
from dataclasses import asdict

import numpy as np
import pytest
from adaptive_terrain import __version__
from adaptive_terrain.cbt_terrain.errors import TerrainError, shown
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_info import describe_source, versions
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import stall
from adaptive_terrain.cbt_terrain.sandbox import store_job
from forked_programs import run_program
from rasters import hills, write_exr, write_raster

# What an import launches must be loaded before: later it could not be compiled.
LOADED = """
import sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.sandbox import guard
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
launch._loaded.clear()  # the forked process has loaded more
settings = ImportSettings(sys.argv[1], **({} if sys.argv[1].endswith(".npy") else {"size": 33}))
guard.guard_import(settings, Path(sys.argv[2]))
before = {kernel.module.name for kernel in launch._loaded}
run_import(settings, sys.argv[2])
print(sorted({kernel.module.name for kernel in launch._loaded} - before))
"""


@pytest.mark.parametrize(
    "source", ["a.npy", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("canyon", "island", "dunes"))]
)
def test_every_kernel_of_an_import_is_loaded_before(source, tmp_path, monkeypatch):
    heights = hills(70, 50)
    heights[3:5, 7] = np.nan  # to be filled; and it fits no lattice
    np.save(tmp_path / "a.npy", heights)
    monkeypatch.chdir(tmp_path)
    done = run_program(LOADED, source, tmp_path / "store")
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stderr


def test_versions_name_everything_and_what_is_given_up(fork_children):
    said = versions()
    assert said["adaptive-terrain"] == __version__ and said["Python"] == sys.version.split()[0]
    assert said["GDAL"].startswith("3.") and said["warp-lang"] and said["numpy"] == np.__version__
    # Those of all formats that can be read, though a process that reads a file keeps only its own.
    drivers = "AAIGrid BT DTED EHdr GRIB GS7BG GSAG GSBG GTiff HFA JP2OpenJPEG PNG SAGA SRTMHGT Terragen USGSDEM VRT"
    assert said["GDAL drivers"] == sorted([*drivers.split(), "WEBP", "XYZ", "netCDF"])
    outcomes = said["reading height maps"]
    assert set(outcomes) == {"network", "programs", "processes", "writes", "memory"}
    assert all(outcomes[name].startswith(("dropped", "kept: ")) for name in outcomes if name != "memory")


def test_info_of_an_exr(tmp_path, fork_children):
    source = write_exr(tmp_path / "a.exr", Y=hills(9, 7))
    assert describe_source(ImportSettings(str(source)))["raster"] == [9, 7]


def bad_names(tmp_path):
    """Yield files that once gave tracebacks, and a part of their errors now."""
    np.savez(tmp_path / "zip.npz", a=np.zeros((3, 3)))
    (tmp_path / "zip.npz").rename(tmp_path / "zip.npy")
    yield str(tmp_path / "zip.npy"), "not a whole .npy file"
    yield str(tmp_path / ("x" * 5000 + ".tif")), "x[.][.][.] (cannot be read|does not exist)"
    yield "a\0b.tif", "cannot be read|does not exist"
    longest = tmp_path / ("y" * 251 + ".tif")  # with the suffix of a sidecar it is too long
    longest.write_bytes(b"II*\0" + bytes(40))
    yield str(longest), "cannot be read as GTiff"


def test_odd_files_and_names_are_one_error(tmp_path, fork_children):
    reads = [describe_source, lambda settings: import_source(settings, tmp_path / "store")]
    for number, (source, said) in enumerate(bad_names(tmp_path)):
        with pytest.raises(TerrainError, match=said) as caught:
            reads[number % 2](ImportSettings(source))
        assert len(str(caught.value)) < 900 and "\n" not in str(caught.value)
    with pytest.raises(TerrainError):
        source_digest(ImportSettings("z" * 5000 + ".vrt"))


def test_gdal_keeps_what_it_has_unpacked(tmp_path):
    """The cache holds megabytes: as bytes it once held nothing, and pieces were unpacked again for every read."""
    from rasterio.env import getenv

    for size, cache in ((64, 256 << 20), (6000, 512 << 20)):
        options = {"compress": "zstd", "blockysize": size, "SPARSE_OK": True}
        heights = np.zeros((size, size), np.float32)
        raster = open_source(ImportSettings(str(write_raster(tmp_path / f"{size}.tif", heights, **options))))
        assert getenv()["GDAL_CACHEMAX"] == cache == gdal_cache()
        raster.close()


def gdal_cache():
    """Return the size of GDAL's cache in bytes, from GDAL itself."""
    import ctypes

    from rasterio import _env

    ask = ctypes.CDLL(_env.__file__).GDALGetCacheMax64
    ask.restype = ctypes.c_int64
    return ask()


def test_an_exr_cannot_claim_more_than_it_can_hold(tmp_path):
    content = bytearray(write_exr(tmp_path / "a.exr", Y=hills(33, 33)).read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    content[at : at + 16] = struct.pack("<4i", 0, 0, 9_999, 9_999)
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(TerrainError, match="0.4 GB; expected .* no more than a file of this size can hold"):
        open_source(ImportSettings(str(tmp_path / "a.exr")))


def test_only_time_in_which_someone_asks_counts_as_a_stall(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(stall.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(stall, "STALL_SECONDS", 5.0)
    watched, over = stall.Stall(), []
    for second in (0.5, 1.0, 500.0, 500.5, 501.0, 502.0, 503.0, 504.0):
        now[0] = second
        over.append(watched.is_over(7))
    assert over == [False] * 7 + [True]
    assert not watched.is_over(8)


def test_names_are_shown_short_and_on_one_line():
    assert shown("a\nb  c") == "a b c" and shown("x" * 300) == "x" * 200 + "..." and os.linesep not in shown("\r\n")


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        (b'{"fraction": 0.5, "message": "a\\u001b[2J"}', {"progress": (0.5, "a?[2J")}),
        (b'{"fraction": NaN, "message": ""}', {}),
        (b'{"fraction": {}, "message": ""}', {}),
        (b'{"fraction": 1}', {}),
        (b'{"error": "a"}', {}),
        (b'{"error": {"fix": "a"}}', {}),
        (b'{"error": {"what": 1}}', {}),
        (b'{"report": {"a": 1}}', {"report": {"a": 1}}),
        (b'{"report": 1}', {}),
        (b"5", {}),
        (b"[]", {}),
        (b"[" * 100_000, {}),
        (b"\xff", {}),
    ],
)
def test_odd_lines_of_a_child_are_harmless(line, kept):
    assert store_job._parse_line(line) == kept


def test_errors_of_a_child_have_short_fields_and_no_code():
    fields = {"what": "a\nopenjd_fail: b", "where": "c" * 5000, "fix": "\x1b[2J", "code": "store.changed", "more": "d"}
    error = store_job._parse_line(json.dumps({"error": fields}).encode())["error"]
    assert error.to_json() == {"what": "a openjd_fail: b", "where": "c" * 4000 + "...", "fix": "?[2J"}


def test_a_job_removes_temporary_files_of_its_child(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    request = {"settings": asdict(ImportSettings("island", size=33)), "target": str(tmp_path / "a.store")}
    job = store_job.ChildJob("cbt_terrain.importing.source_info", request, what="a")
    (folder,) = tmp_path.iterdir()
    (folder / "left by a compiler").write_bytes(b"")
    job.cancel()
    assert list(tmp_path.iterdir()) == []
