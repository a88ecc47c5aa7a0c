# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of quick imports with some loaded tiles."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.importing import refining, tile_crew
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasters import hills, write_raster

QUICK = 4000


def make_small_tiles(monkeypatch):
    """Make tiles of 64 x 64 cells, and four cells of one of the first picture along each side."""
    monkeypatch.setattr(refining, "BITS", 6)
    monkeypatch.setattr(refining, "FACTOR", 4)
    monkeypatch.setattr(refining, "FEWEST", 1)
    monkeypatch.setattr(tile_crew, "MIN_SAMPLES", 1)


def rough(width, height):
    """Return hills with noise, so that no error is 0."""
    noise = np.random.default_rng(5).normal(0.0, 3.0, (height, width))
    return (hills(width, height) + noise).astype(np.float32)


def loaded_store(folder, heights, place, tiles, run=run_import, holes=False, **options):
    """Return the settings and the store of a raster with some loaded tiles."""
    source = str(write_raster(folder / "a.tif", heights, crs="EPSG:32632", transform=place, tiled=True))
    settings = ImportSettings(source, quick=QUICK, holes=holes)
    run(settings, folder / "store")
    run(replace(settings, loaded_tiles=tiles), folder / "store", **options)
    return settings, folder / "store"
