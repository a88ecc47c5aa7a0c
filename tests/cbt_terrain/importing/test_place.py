# SPDX-License-Identifier: GPL-3.0-or-later
"""The place in store.json: coordinates of positions in the terrain's space, compared with the file's geotransform."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as stores
from adaptive_terrain.cbt_terrain.field.georeference import from_crs, to_crs
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.importing.placing import _reprojected
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from rasterio.transform import Affine
from rasters import hills, imported, write_raster

TURN = 0.3
KINDS = {
    "metres": ("EPSG:32632", Affine(10.0, 0.0, 6e5, 0.0, -10.0, 5.2e6), {}),
    "degrees": ("EPSG:4326", Affine(1 / 1200, 0.0, 10.0, 0.0, -1 / 1800, 47.0), {}),
    "feet": ("EPSG:2263", Affine(30.0, 0.0, 9.8e5, 0.0, -20.0, 2e5), {}),
    "columns from the east": ("EPSG:32632", Affine(-10.0, 0.0, 6e5, 0.0, -10.0, 5.2e6), {}),
    "first row in the south": ("EPSG:32632", Affine(10.0, 0.0, 6e5, 0.0, 12.0, 5.2e6), {}),
    "transposed": ("EPSG:32632", Affine(0.0, 10.0, 6e5, -12.0, 0.0, 5.2e6), {}),
    "transposed from the east": ("EPSG:32632", Affine(0.0, -10.0, 6e5, 12.0, 0.0, 5.2e6), {}),
    "rotated": (
        "EPSG:32632",
        Affine.translation(6e5, 5.2e6) @ Affine.rotation(math.degrees(TURN)) @ Affine.scale(10.0, -12.0),
        {},
    ),
    "sized": ("EPSG:32632", Affine(10.0, 0.0, 6e5, 0.0, -10.0, 5.2e6), {"extent": (5000.0, 900.0)}),
    "unnamed": (None, Affine(10.0, 0.0, 6e5, 0.0, -10.0, 5.2e6), {}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_place_gives_the_coordinates_of_samples(tmp_path, kind):
    crs, transform, settings = KINDS[kind]
    heights = hills(23, 17)
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", heights, crs=crs, transform=transform), **settings)
    rows, columns = np.indices(heights.shape).reshape(2, -1)
    x, y = transform @ (columns + 0.5, rows + 0.5)
    places = from_crs(field.raster.place, np.stack([x, y], axis=1))
    found = ground_at(field, places)
    assert found.inside.all()
    assert np.abs(found.heights - heights.reshape(-1)).max() < 1e-3
    back = to_crs(field.raster.place, places)
    assert np.abs(back - np.stack([x, y], axis=1)).max() < 1e-6
    assert field.raster.known_place == field.raster.place


@pytest.mark.parametrize("kind", KINDS)
def test_info_names_the_coordinates_of_the_border(tmp_path, kind):
    crs, transform, settings = KINDS[kind]
    heights = hills(23, 17)
    imported(tmp_path, write_raster(tmp_path / "a.tif", heights, crs=crs, transform=transform), **settings)
    about = describe(tmp_path / "store")
    if kind in ("rotated", "unnamed"):
        assert "west_south_east_north" not in about
        return
    rows, columns = np.indices(heights.shape).reshape(2, -1)
    x, y = transform @ (columns + 0.5, rows + 0.5)
    assert about["west_south_east_north"] == pytest.approx([x.min(), y.min(), x.max(), y.max()], rel=0.0, abs=1e-6)


def test_a_file_without_a_place_has_metres_from_its_middle(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.png", (hills() * 50).astype("uint16")))
    assert field.raster.place is None and field.raster.known_place == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    assert "place" not in json.loads((tmp_path / "store" / "store.json").read_text())


def test_an_older_store_opens_and_its_unit_is_unknown(tmp_path):
    crs, transform, _ = KINDS["feet"]
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", hills(), crs=crs, transform=transform))
    change_json(tmp_path / "store", lambda content: content.pop("place"))
    older = stores.open_store(tmp_path / "store")
    assert older.raster.known_place is None and older.raster.digest == field.raster.digest


@pytest.mark.parametrize("place", [[1.0] * 6, [1, 0, 0, 0, 1], [1, 0, 0, 0, math.inf, 0], "metres", [1e-200] * 6])
def test_a_damaged_place_is_refused(tmp_path, place):
    crs, transform, _ = KINDS["metres"]
    imported(tmp_path, write_raster(tmp_path / "a.tif", hills(), crs=crs, transform=transform))
    change_json(tmp_path / "store", lambda content: content.update(place=place))
    with pytest.raises(TerrainError, match="place"):
        stores.open_store(tmp_path / "store")


def change_json(store: Path, change) -> None:
    """Change the entries of a store's JSON file and its checksum."""
    file = store / "store.json"
    content = json.loads(file.read_text())
    change(content)
    content["sum"] = stores._sum_of(content)
    file.write_text(json.dumps(content))


def test_points_are_brought_into_another_system():
    """EPSG's example of UTM: 9 degrees east is the middle of zone 32."""
    assert _reprojected(500_000.0, 0.0, "EPSG:32632", "EPSG:4326") == pytest.approx((9.0, 0.0), abs=1e-9)
    east, north = _reprojected(9.0, 46.0, "EPSG:4326", "EPSG:32632")
    assert east == pytest.approx(500_000.0, abs=1e-3) and 5_090_000 < north < 5_100_000
    for source in ("EPSG:1", "nowhere", ""):
        with pytest.raises(TerrainError, match="cannot be converted"):
            _reprojected(0.0, 0.0, source, "EPSG:4326")
