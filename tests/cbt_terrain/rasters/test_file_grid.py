# SPDX-License-Identifier: GPL-3.0-or-later
"""Geotransforms as files have them: missing, with ground control points, skewed, rotated, mirrored.

The ground is a plane over coordinates, so that the right height of every sample follows from its position alone.
"""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.placing import Placing, is_placed, unit_lengths
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from rasters import hills, imported, write_raster

UTM, X, Y = "EPSG:32632", 600_000.0, 5_200_000.0
WIDTH, HEIGHT = 7, 5
MERCATOR = """PROJCS["own",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],
PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],
PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",10],PARAMETER["scale_factor",1],
PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]]"""


def plane(x, y):
    """Return heights in metres that rise by 3 m to the east and 2 m to the north for each 10 m."""
    return 500.0 + 0.3 * (x - X) + 0.2 * (y - Y)


def sampled_plane(transform, width=WIDTH, height=HEIGHT):
    row, column = np.mgrid[0:height, 0:width] + 0.5
    a, b, c, d, e, f = tuple(transform)[:6]
    return plane(a * column + b * row + c, d * column + e * row + f).astype(np.float32)


def written(tmp_path, transform, crs=UTM, width=WIDTH, height=HEIGHT, **options):
    heights = sampled_plane(transform, width, height)
    return write_raster(tmp_path / "a.tif", heights, crs=crs, transform=transform, **options)


def placing_in(field, tmp_path):
    """Call `placing_of` in this process."""
    if not field.crs or not is_placed(field, tmp_path / "store"):
        return Placing()
    return Placing(*(float(c) for c in field.origin[:2]), *unit_lengths(field), field.crs)


def slopes(field):
    """Return the rise of the ground, metres, over 10 m along x and y in the terrain's middle."""
    low, east, north = ground_at(field, np.array([(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)])).heights
    return east - low, north - low


ALIGNED = {
    "north up": Affine(10.0, 0.0, X, 0.0, -20.0, Y),
    "south up": Affine(10.0, 0.0, X, 0.0, 20.0, Y),
    "east first": Affine(-10.0, 0.0, X, 0.0, -20.0, Y),
    "turned by 180": Affine(-10.0, 0.0, X, 0.0, 20.0, Y),
    "turned by 90": Affine(0.0, 20.0, X, 10.0, 0.0, Y),
    "turned by 270": Affine(0.0, -20.0, X, -10.0, 0.0, Y),
    "transposed": Affine(0.0, 20.0, X, -10.0, 0.0, Y),
    "transposed the other way": Affine(0.0, -20.0, X, 10.0, 0.0, Y),
}


@pytest.mark.parametrize(
    "size, samples_are", [((7, 5), "Area"), ((2, 3), "Point"), pytest.param((1, 4), "Area", marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize("name", ALIGNED)
def test_aligned_rasters_lie_where_their_coordinates_are(tmp_path, name, size, samples_are):
    import rasterio

    transform = ALIGNED[name]
    source = written(tmp_path, transform, width=size[0], height=size[1])
    with rasterio.open(source, "r+") as file:
        file.update_tags(AREA_OR_POINT=samples_are)
    field, report = imported(tmp_path, source)
    assert report["warnings"] == [] and report["raster"] == list(size) and report["rotation_deg"] == 0.0
    turned = transform.a == 0.0
    assert report["step_m"] == ([20.0, 10.0] if turned else [10.0, 20.0])
    placing = placing_in(field, tmp_path)
    assert placing.crs == UTM
    row, column = np.mgrid[0 : size[1], 0 : size[0]].reshape(2, -1) + 0.5
    x, y = transform @ (column, row)
    found = ground_at(field, placing.to_terrain(np.column_stack([x, y]))).heights
    assert found == pytest.approx(plane(x, y), abs=1e-3)


def test_an_extent_is_that_of_x_and_y_of_a_turned_raster(tmp_path):
    _, report = imported(tmp_path, written(tmp_path, ALIGNED["turned by 90"]), extent=(800.0, 1200.0))
    assert report["step_m"] == [200.0, 200.0] and report["samples"] == [HEIGHT, WIDTH]


def test_holes_of_a_turned_raster_lie_at_their_coordinates(tmp_path):
    transform = ALIGNED["turned by 90"]
    heights = sampled_plane(transform)
    heights[1, 2] = -9999.0
    source = write_raster(tmp_path / "a.tif", heights, crs=UTM, transform=transform, nodata=-9999.0)
    field, report = imported(tmp_path, source, holes=True)
    missing = placing_in(field, tmp_path).to_terrain(np.array([transform @ (2.5, 1.5), transform @ (4.5, 3.5)]))
    assert np.isnan(ground_at(field, missing).heights).tolist() == [True, False] and report["cut_out"] == 1


@pytest.mark.parametrize("skew", [1e-17, 1e-13, 1e-9, 9e-6])
def test_skew_that_is_rounding_is_no_rotation(tmp_path, skew):
    for transform in (Affine(10.0, skew, X, skew, -10.0, Y), Affine(skew, 10.0, X, 10.0, -skew, Y)):
        field, report = imported(tmp_path, written(tmp_path, transform))
        placing = placing_in(field, tmp_path)
        assert report["warnings"] == [] and placing.crs == UTM
        x, y = transform @ (2.25, 3.5)
        found = ground_at(field, placing.to_terrain(np.array([(x, y)]))).heights
        assert found == pytest.approx(plane(x, y), abs=1e-3)


@pytest.mark.parametrize("first_row", [-20.0, 20.0], ids=["first row north", "first row south"])
@pytest.mark.parametrize("degrees", [0.001, 30.0, 135.0, -100.0])
def test_rotated_rasters_are_laid_out_unmirrored(tmp_path, degrees, first_row):
    transform = Affine.translation(X, Y) @ Affine.rotation(degrees) @ Affine.scale(10.0, first_row)
    field, report = imported(tmp_path, written(tmp_path, transform))
    assert report["step_m"] == pytest.approx([10.0, 20.0]) and report["rotation_deg"] == pytest.approx(degrees)
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    assert slopes(field) == pytest.approx((3.0 * cosine + 2.0 * sine, -3.0 * sine + 2.0 * cosine), abs=2e-3)
    [warning] = report["warnings"]
    assert f"rotated by {degrees:.6g} degrees" in warning and warning.endswith("import it with --project EPSG:32632.")
    assert placing_in(field, tmp_path) == Placing()


@pytest.mark.parametrize("scale", [(10.0, -10.0), (10.0, 10.0), (10.0, -90.0)], ids=str)
def test_its_own_system_straightens_a_rotated_raster(tmp_path, scale):
    transform = Affine.translation(X, Y) @ Affine.rotation(30.0) @ Affine.scale(*scale)
    field, report = imported(tmp_path, written(tmp_path, transform, width=31, height=20), project=UTM, holes=True)
    placing = placing_in(field, tmp_path)
    assert report["warnings"] == [] and report["rotation_deg"] == 0.0 and placing.crs == UTM
    x, y = transform @ (np.array([3.0, 15.0, 26.0]), np.array([4.0, 11.0, 17.0]))
    found = ground_at(field, placing.to_terrain(np.column_stack([x, y]))).heights
    assert found == pytest.approx(plane(x, y), abs=2e-3)


def test_systems_without_a_code_are_straightened_by_utm(tmp_path):
    transform = Affine.translation(X, Y) @ Affine.rotation(30.0) @ Affine.scale(10.0, -10.0)
    source = written(tmp_path, transform, crs=MERCATOR)
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert warning.endswith("To straighten it, import it with --project utm.")
    _, report = imported(tmp_path, source, project="utm")
    assert report["warnings"] == [] and report["crs"] == UTM and report["rotation_deg"] == 0.0
    [warning] = imported(tmp_path, written(tmp_path, transform, crs=None))[1]["warnings"]
    assert "an unnamed coordinate system" in warning and "write its coordinate system into the file" in warning


@pytest.mark.parametrize("crs", [UTM, MERCATOR, None], ids=["UTM", "no code", "none"])
def test_sheared_rasters_are_resampled_onto_a_straight_grid(tmp_path, crs):
    transform = Affine(30.0, 5.0, X, 0.0, -30.0, Y)
    field, report = imported(tmp_path, written(tmp_path, transform, crs=crs, width=37, height=29))
    [warning] = report["warnings"]
    assert "not perpendicular" in warning and report["step_m"] == pytest.approx([30.0, 30.0])
    assert slopes(field) == pytest.approx((3.0, 2.0), abs=1e-3)
    assert report["bounds_against"].startswith("the raster as reprojected from a sheared grid to ")
    x, y = transform @ (np.array([5.0, 20.0]), np.array([3.0, 22.0]))
    found = ground_at(field, np.column_stack([x, y]) - field.origin[:2]).heights
    assert found == pytest.approx(plane(x, y), abs=1e-3)


def test_a_rotation_in_degrees_is_a_shear_on_the_ground(tmp_path):
    transform = Affine.translation(10.0, 60.0) @ Affine.rotation(30.0) @ Affine.scale(0.001, -0.001)
    row, column = np.mgrid[0:30, 0:40] + 0.5
    longitude, latitude = transform @ (column, row)
    heights = (1000.0 * (longitude - 10.0) + 3000.0 * (latitude - 60.0)).astype(np.float32)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:4326", transform=transform)
    field, report = imported(tmp_path, source)
    placing = placing_in(field, tmp_path)
    assert len(report["warnings"]) == 1 and "not perpendicular" in report["warnings"][0]
    places = np.array([transform @ (10.0, 9.0), transform @ (30.0, 20.0)])
    found = ground_at(field, placing.to_terrain(places)).heights
    assert found == pytest.approx(1000.0 * (places[:, 0] - 10.0) + 3000.0 * (places[:, 1] - 60.0), abs=1e-2)


def control_points(tmp_path, transform, places, off=0.0, crs=UTM):
    """Write a raster with only ground control points, the last of which is off by `off` metres."""
    import rasterio

    points = [GroundControlPoint(row, column, *(transform @ (column, row))) for row, column in places]
    if off:
        points[-1].x += off
    shape = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 1, "dtype": "float32"}
    with rasterio.open(tmp_path / "a.tif", "w", **shape, gcps=points, crs=crs) as file:
        file.write(sampled_plane(transform), 1)
    return tmp_path / "a.tif"


CORNERS = ((0, 0), (0, WIDTH), (HEIGHT, 0), (HEIGHT, WIDTH))


@pytest.mark.parametrize("places", [CORNERS, CORNERS[:3], ((1, 1), (4, 2), (2, 6), (3, 3), (0, 5))], ids=len)
@pytest.mark.parametrize("name", ["north up", "south up", "turned by 90"])
def test_control_points_of_a_straight_grid_are_used(tmp_path, name, places):
    transform = ALIGNED[name]
    source = control_points(tmp_path, transform, places)
    field, report = imported(tmp_path, source)
    assert report["warnings"] == [] and sorted(report["step_m"]) == [10.0, 20.0] and report["crs"] == UTM
    x, y = transform @ (2.25, 3.5)
    found = ground_at(field, placing_in(field, tmp_path).to_terrain(np.array([(x, y)]))).heights
    assert found == pytest.approx(plane(x, y), abs=1e-3)
    _, report = imported(tmp_path, source, project=UTM)
    assert sorted(report["step_m"]) == pytest.approx([10.0, 20.0])


def without_relief(warnings):
    """Return the warnings less the one about heights that are large for a raster of 1 m a sample."""
    return [warning for warning in warnings if not warning.startswith("The relief, ")]


@pytest.mark.parametrize("places, off", [(CORNERS, 5.0), (CORNERS[:1], 0.0), (((0, 0), (1, 1), (2, 2)), 0.0)])
def test_other_control_points_are_warned_about(tmp_path, places, off):
    source = control_points(tmp_path, ALIGNED["north up"], places, off)
    field, report = imported(tmp_path, source)
    [warning] = without_relief(report["warnings"])
    assert "ground control point" in warning and "--extent" in warning and "gdalwarp -tps" in warning
    assert report["step_m"] == [1.0, 1.0] and report["crs"] == "" and slopes_sign(field) == (1, 1)
    assert imported(tmp_path, source, extent=(60.0, 80.0))[1]["warnings"] == []
    with pytest.raises(TerrainError, match="cannot be reprojected, because it places .*gdalwarp -tps"):
        open_source(ImportSettings(str(source), project=UTM))


def slopes_sign(field):
    low, east, north = ground_at(field, np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])).heights
    return np.sign(east - low), np.sign(north - low)


def test_a_system_without_a_geotransform_has_no_size(tmp_path):
    """The first row is north, as of a picture."""
    import rasterio

    shape = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 1, "dtype": "float32"}
    with rasterio.open(tmp_path / "a.tif", "w", **shape, crs=UTM) as file:
        file.write(sampled_plane(ALIGNED["north up"]), 1)
    field, report = imported(tmp_path, tmp_path / "a.tif")
    [warning] = without_relief(report["warnings"])
    assert "EPSG:32632, but not the position of its samples" in warning and "--extent" in warning
    assert report["crs"] == "" and slopes_sign(field) == (1, 1) and placing_in(field, tmp_path) == Placing()
    assert imported(tmp_path, tmp_path / "a.tif", extent=(60.0, 80.0))[1]["warnings"] == []
    with pytest.raises(TerrainError, match="cannot be reprojected, because it names .*gdal_edit.py -a_ullr"):
        open_source(ImportSettings(str(tmp_path / "a.tif"), project="utm"))


def test_rational_polynomials_are_warned_about(tmp_path):
    import rasterio

    source = write_raster(tmp_path / "a.tif", hills(9, 9))
    names = ("LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF")
    names += ("LINE_SCALE", "SAMP_SCALE", "LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE")
    polynomials = dict.fromkeys(names, "1")
    for name in ("LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF"):
        polynomials[name] = " ".join(["1", *["0"] * 19])
    with rasterio.open(source, "r+") as file:
        file.update_tags(ns="RPC", **polynomials)
    [warning] = without_relief(imported(tmp_path, source)[1]["warnings"])
    assert "rational polynomials" in warning and "gdalwarp -rpc" in warning


def test_control_points_of_a_vrt_are_used(tmp_path):
    write_raster(tmp_path / "part.tif", sampled_plane(ALIGNED["north up"]))
    points = "".join(
        f'<GCP Id="{number}" Pixel="{column}" Line="{row}" X="{X + 10 * column}" Y="{Y - 20 * row}" Z="0"/>'
        for number, (row, column) in enumerate(CORNERS)
    )
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="{WIDTH}" rasterYSize="{HEIGHT}"><GCPList Projection="EPSG:32632">{points}</GCPList>'
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="1">part.tif'
        "</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    _, report = imported(tmp_path, tmp_path / "a.vrt")
    assert (report["step_m"], report["crs"], report["warnings"]) == ([10.0, 20.0], UTM, [])


def test_cells_without_an_area_need_an_extent(tmp_path):
    collinear = Affine(10.0, 10.0, X, 10.0, 10.0, Y)
    source = write_raster(tmp_path / "a.tif", hills(9, 9), crs=UTM, transform=collinear)
    with pytest.raises(TerrainError, match="no size: give the extent in metres"):
        open_source(ImportSettings(str(source)))
    assert imported(tmp_path, source, extent=(80.0, 80.0))[1]["step_m"] == [10.0, 10.0]
