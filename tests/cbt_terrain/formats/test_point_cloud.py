# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground points of LAS and LAZ files. Skipped without laspy and lazrs: `pip install "laspy[lazrs]"`."""

import base64
import struct
import sys
import zlib

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats import point_cloud
from adaptive_terrain.cbt_terrain.rasters import source_formats
from rasters import imported

UTM = 32632
# 30 ground points, 2 x + 3 y high, and two of vegetation in three nodes of a COPC file that copclib 2.6.3 has written.
COPC = (
    "c-r%E40dB+5MV$Dj4TXP0OgDanHd;>h@nl6K>@GQ2lm)$TtLhLRh<wj|3Czk&*A{n;mr#58W1Zm3^Yj2FGxlSaE1j8&i(<;3YmFn"
    "`3hk^L1df!!M+{p(}V%{m4NyKh_6yBN>cMmiU&N{2L$9K7FT5!D5T~k=clBmFfi;1(*TN96{HrWDU>A^WhUm8VCVs58fF$|F#A6i"
    "z{tSGAO}=siIl2A7|LZ}LNSdSh~<EoABg$zIn_cZK4%g?drL~r%bJj-2fj5eczkPGp#`UkD^OA;?IhcM(R1bt`DcFyS;52z0nGoQ"
    "4hA`ZlO_&e(>;Rf01FHUutFWci`4;KKrD?UOQHiTQEW$wBjtbB!UAu~V@>@pm|;0k!$3y?iZroV3X44$I1Md+^PnzgL{sktm2ZRw"
    "Ejl>Kj4BTRhAMp%"
)


def plane(x, y):
    return 400.0 + 0.25 * (x - 500_000.0) - 0.5 * (y - 5_200_000.0)


def scattered(count=40_000, side=100.0, seed=2):
    """Return x, y, z of random points on a plane, and their classes: 3 of 4 are ground, others are 30 m above it."""
    random = np.random.default_rng(seed)
    steps = random.integers(1, 2000, (2, count)) / 1000 + 2.0 * random.integers(0, side / 2, (2, count))
    x, y = 500_000.0 + steps[0], 5_200_000.0 + steps[1]  # whole millimetres, none between two cells of 2 m
    classes = np.where(np.arange(count) % 4 == 3, 5, 2)
    return x, y, plane(x, y) + np.where(classes == 5, 30.0, 0.0), classes


def write_las(path, x, y, z, classes, crs=UTM, scale=0.001):
    """Write LAS 1.2, point format 0, byte by byte, with the code of a coordinate system in GeoTIFF keys."""
    offset = np.floor([x.min(), y.min(), z.min()])
    keys = struct.pack("<4H", 1, 1, 0, 1) + struct.pack("<4H", 3072, 0, 1, crs)
    record = struct.pack("<H16sHH32s", 0, b"LASF_Projection", 34735, len(keys), b"") + keys
    head = struct.pack("<4sHHIHH8sBB32s32sHHH", b"LASF", 0, 0, 0, 0, 0, b"", 1, 2, b"", b"", 1, 2026, 227)
    head += struct.pack("<IIBHI5I", 227 + len(record), 1, 0, 20, len(x), len(x), 0, 0, 0, 0)
    bounds = [value for axis in (x, y, z) for value in (axis.max(), axis.min())]
    head += struct.pack("<12d", scale, scale, scale, *offset, *bounds)
    points = np.zeros(
        len(x), [("at", "<i4", 3), ("intensity", "<u2"), ("returns", "u1"), ("class", "u1"), ("rest", "u1", 4)]
    )
    points["at"] = np.rint((np.stack([x, y, z], axis=1) - offset) / scale)
    points["class"] = classes
    path.write_bytes(head + record + points.tobytes())
    return path


def write_laz(path, *points):
    """Compress what `write_las` wrote."""
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    laspy.read(write_las(path.with_suffix(".las"), *points)).write(path)
    return path


def test_a_missing_package_is_one_error_with_a_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(
        TerrainError, match='package laspy, which is not installed: run: ".*" -m pip install "laspy.lazrs."'
    ):
        source_formats.FORMATS[".laz"].load()


def test_gaps_are_filled_up_to_their_limit():
    """Gaps of up to twice the reach are filled, on a plane exactly to its range; wider ones and the outside stay."""
    y, x = np.mgrid[:40, :60].astype(np.float32)
    land = 3.0 * x + y
    holed = land.copy()
    holed[5:9, 5:9], holed[20:29, 20:29], holed[:, 50:] = np.nan, np.nan, np.nan
    filled = point_cloud.fill_gaps(holed, 2)
    assert np.isnan(filled[20:29, 20:29]).all() and np.isnan(filled[:, 50:]).all()
    assert np.isfinite(filled[5:9, 5:9]).all() and np.abs(filled - land)[5:9, 5:9].max() < 4.0
    known = np.isfinite(holed)
    assert np.array_equal(filled[known], holed[known])
    assert np.isfinite(point_cloud.fill_gaps(holed, 5)[20:29, 20:29]).all()


@pytest.mark.parametrize("write,name", [(write_las, "a.las"), (write_laz, "a.laz")])
def test_ground_points_become_their_cells_means(tmp_path, write, name):
    """A plane's ground points give the plane at the cells' middles; vegetation above it counts nothing."""
    pytest.importorskip("lazrs")
    points = scattered()
    field, report = imported(tmp_path, write(tmp_path / name, *points), cell=2.0)
    assert report["crs"] == "EPSG:32632" and report["step_m"] == [2.0, 2.0] and report["samples"] == [50, 50]
    x, y, z, classes = points
    ground = classes == 2
    column, row = ((x[ground] - 500_000) // 2).astype(int), ((y[ground] - 5_200_000) // 2).astype(int)
    total, count = np.zeros((50, 50)), np.zeros((50, 50))
    np.add.at(total, (row, column), z[ground])
    np.add.at(count, (row, column), 1)
    assert np.abs(field.heights(slice(None), slice(None)) - total / count).max() < 2e-3
    assert field.origin[:2].tolist() == [500_050.0, 5_200_050.0]
    assert 0.0005 <= report["source_step_m"] < 0.0006


def test_a_copc_file_gives_the_points_of_all_its_nodes(tmp_path):
    pytest.importorskip("lazrs")
    (tmp_path / "a.copc.laz").write_bytes(zlib.decompress(base64.b85decode(COPC)))
    field, report = imported(tmp_path, tmp_path / "a.copc.laz", cell=1.0)
    y, x = np.mgrid[:5, :6] + 0.5
    assert np.array_equal(np.asarray(field.samples), 2 * x + 3 * y)
    assert report["warnings"][0].startswith("30 ground points became 6 x 5 cells of 1 m. 0 cells in gaps")


def test_the_default_cell_holds_four_points_in_the_mean(tmp_path):
    pytest.importorskip("lazrs")
    report = imported(tmp_path, write_las(tmp_path / "a.las", *scattered()))[1]
    assert report["step_m"] == [2.0, 2.0]  # 3 points a square metre: 1.15 m, and the next of 1, 2 and 5
    assert report["warnings"][0].startswith("30,000 ground points became 50 x 50 cells of 2 m. 0 cells in gaps")


def test_a_lake_stays_without_data_and_a_house_is_filled(tmp_path, monkeypatch):
    pytest.importorskip("lazrs")
    monkeypatch.setattr(point_cloud, "REACH", 3)
    x, y, z, classes = scattered()
    lake = np.hypot(x - 500_070, y - 5_200_070) < 20
    house = (abs(x - 500_020) < 4) & (abs(y - 5_200_020) < 4)
    left = ~(lake | house)
    source = write_las(tmp_path / "a.las", x[left], y[left], z[left], classes[left])
    field, report = imported(tmp_path, source, cell=2.0, holes=True)
    assert report["cut_out"] == pytest.approx(np.pi * 10**2, rel=0.15)
    heights = field.heights(slice(None), slice(None))
    assert abs(heights[10, 10] - plane(500_021, 5_200_021)) < 1.0


def test_points_in_feet_become_metres(tmp_path):
    """A cell of a state plane in feet is stated in metres, and its heights are converted."""
    pytest.importorskip("lazrs")
    x, y, z, classes = scattered()
    source = write_las(tmp_path / "a.las", x, y, z, classes, crs=2263)  # New York Long Island, US feet
    report = imported(tmp_path, source, cell=2.0)[1]
    assert report["step_m"] == pytest.approx([2.0, 2.0]) and "US survey foot" in " ".join(report["warnings"])


def test_bad_point_clouds_are_one_error(tmp_path):
    pytest.importorskip("lazrs")
    x, y, z, classes = scattered(1000)
    write_las(tmp_path / "class.las", x, y, z, np.ones(1000))
    write_las(tmp_path / "degrees.las", x, y, z, classes, crs=4326)
    write_las(tmp_path / "fine.las", x, y, z, classes)
    content = (tmp_path / "fine.las").read_bytes()
    (tmp_path / "cut.laz").write_bytes(write_laz(tmp_path / "b.laz", x, y, z, classes).read_bytes()[:-2000])
    (tmp_path / "noise.las").write_bytes(bytes(100) + content[100:])
    (tmp_path / "short.las").write_bytes(content[:-20])
    packed = bytearray((tmp_path / "b.laz").read_bytes())
    table = struct.unpack_from("<q", packed, struct.unpack_from("<I", packed, 96)[0])[0]
    packed[table + 4 : table + 8] = b"\xff" * 4  # the library would reserve 64 GB
    (tmp_path / "chunks.laz").write_bytes(packed)
    wanted = {
        "class.las": ({}, "has no points of class 2"),
        "degrees.las": ({}, "points in degrees|no points of class"),
        "fine.las": ({"cell": 1e-3}, "cells of 0.001 units"),
        "cut.laz": ({}, "is damaged|cannot be read as LAS"),
        "noise.las": ({}, "is damaged .it cannot hold 0 records|is damaged"),
        "short.las": ({}, "is damaged .it cannot hold 1,000 points of 20 bytes"),
        "chunks.laz": ({}, "is damaged .it cannot hold 4,294,967,295 pieces"),
    }
    for name, (options, said) in wanted.items():
        with pytest.raises(TerrainError, match=said) as caught:
            imported(tmp_path, tmp_path / name, **options)
        assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    with pytest.raises(TerrainError, match="cell size is -1.0 m"):
        imported(tmp_path, tmp_path / "fine.las", cell=-1.0)
