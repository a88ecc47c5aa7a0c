# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged catalogues with a valid checksum, and damaged headers of tiles: a raster or one error, never a crash."""

import json
import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.mosaic import catalogue
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import mosaic_raster, open_composite
from adaptive_terrain.cbt_terrain.mosaic.report import describe_mosaic
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from hostile_files import damaged
from mosaic_files import DEGREES, EAST, NORTH, UTM32, moved, sheet

ROUNDS = max(40, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 10)
ODD = [None, True, -1, 0, 1, 2, 10**6, 2**31, 2**63, 10**30, 1e308, -1e308, 5e-324, 0.5, float("nan"), float("inf"), ""]
ODD += [
    "x" * 5000,
    "\ud800",
    "\0",
    "/etc/passwd",
    "EPSG:99999999",
    "EPSG:4326",
    "EPSG:3031",
    "A[",
    "O",
    "U9",
    "c16",
    "f2",
]
ODD += [[], {}, [[]], [1, 2], {"stored": "x"}, json.loads("[" * 90 + "]" * 90)]
HEADER = ("width", "height", "transform", "transform", "crs", "scale", "offset", "stored", "block_rows")


@pytest.fixture
def tiles(tmp_path):
    """Write three tiles in two systems and import them; return their folder, the store and the whole heights."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 40, 20)
    west, north = map(float, moved(UTM32, DEGREES, EAST, NORTH))
    sheet(DEGREES, west, north, 2e-4, 2e-4, 20, 20).write(tmp_path / "tiles" / "a.tif")
    for n in range(2):
        whole.write(tmp_path / "tiles" / f"t{n}.tif", first_column=20 * n, columns=20)
    run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    return tmp_path / "tiles", tmp_path / "store"


def outcome(folder, store):
    """Return "read", or "error" for one sentence; reads the first rows of the composite, and reports on it."""
    composite = None
    try:
        settings = ImportSettings(str(folder))
        composite = open_composite(settings, store)
        raster = mosaic_raster(composite, settings)
        if composite.grid.width * composite.grid.height < 1 << 20:
            describe_mosaic(composite, settings)
        rows = raster.window(0, min(raster.height, 8), 0, min(raster.width, 2000))
        assert rows.dtype == np.float64 and not np.isinf(rows).any()
        return "read"
    except TerrainError as error:
        assert "\n" not in str(error) and str(error).endswith(".") and len(str(error)) < 1000
        return "error"
    finally:
        if composite is not None:
            composite.close()


def mutate(value, random):
    """Replace, remove or repeat something inside a JSON value."""
    if isinstance(value, dict | list) and value and random.random() < 0.85:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[random.integers(len(keys))]
        if random.random() < 0.05:
            del value[key]
        elif isinstance(value, list) and random.random() < 0.05:
            value.append(value[key])
        else:
            value[key] = mutate(value[key], random)
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and random.random() < 0.8:
        return type(value)(value * float(random.choice([-1.0, 0.0, 0.5, 1.0000001, 2.0, 1e9, 1e-9])))
    return ODD[random.integers(len(ODD))]


@pytest.mark.thorough
def test_a_damaged_catalogue_is_a_raster_or_one_error(tiles):
    """Catalogues with a valid checksum and odd values never crash; a file that they place elsewhere is an error."""
    folder, store = tiles
    file = named_folder(store) / catalogue.FILE_NAME
    content = json.loads(file.read_text())["content"]
    random, ends = np.random.default_rng(7), []
    for _ in range(ROUNDS):
        entries = json.loads(content)
        tile = entries["tiles"][random.integers(3)]
        if random.random() < 0.6:  # one value of its place or its samples
            name = HEADER[random.integers(len(HEADER))]
            tile[name] = mutate(tile[name], random)
        else:
            for _ in range(random.integers(1, 4)):
                mutate(tile if random.random() < 0.8 else entries, random)
        text = json.dumps(entries)
        file.write_text(json.dumps({"sum": catalogue._sum(text), "content": text}))
        ends.append(outcome(folder, store))
    assert ends.count("read") > ROUNDS / 5 and ends.count("error") > ROUNDS / 20, ends


@pytest.mark.thorough
def test_damaged_headers_of_tiles_are_a_raster_or_one_error(tiles):
    folder, store = tiles
    file = folder / "t0.tif"
    content, random, ends = file.read_bytes(), np.random.default_rng(8), []
    for _ in range(ROUNDS):
        file.write_bytes(damaged(content, random))
        ends.append(outcome(folder, store))
    assert ends.count("read") > ROUNDS / 20 and ends.count("error") > ROUNDS / 5
