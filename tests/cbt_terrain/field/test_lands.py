# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in terrains: equal heights at every resolution, and the features in their names."""

import hashlib

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lands import LANDS
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings

FIRST_BYTES = {
    "island": "ad5d7a2b4269cd6f",
    "mountains": "21105061eb982005",
    "dunes": "4898b87ac3a4abbe",
    "canyon": "36a14dfd327ab9d6",
    "archipelago": "fdd57adf909e6f68",
}


def slopes(heights: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Rise to the east and to the north, metres a metre."""
    north, east = np.gradient(heights.astype(np.float64), step)
    return east, north


@pytest.mark.parametrize("name", LANDS)
def test_resolutions_agree_where_their_samples_coincide(name):
    fine, coarse = LANDS[name].heights(193, seed=5), LANDS[name].heights(65, seed=5)
    assert fine[::3, ::3].tobytes() == coarse.tobytes()


@pytest.mark.parametrize("name", LANDS)
def test_rows_and_threads_do_not_matter_and_seeds_do(name):
    land = LANDS[name]
    whole = land.heights(150)
    assert np.isfinite(whole).all()
    for threads in (1, 2, 3):
        rows = np.empty((41, 150), np.float32)
        land.rows(150, 37, rows, 7, threads)
        assert rows.tobytes() == whole[37:78].tobytes()
    assert (land.heights(150, seed=8) != whole).mean() > 0.9


@pytest.mark.parametrize("name", LANDS)
def test_the_same_seed_gives_the_same_bytes(name):
    assert hashlib.sha256(LANDS[name].heights(65, seed=3).tobytes()).hexdigest()[:16] == FIRST_BYTES[name]


@pytest.mark.parametrize("seed", (7, 1, 2))
def test_dunes_are_gentle_to_windward_and_at_rest_to_lee(seed):
    step = 4.0
    size = int(LANDS["dunes"].side / step) + 1
    rows = np.empty((200, size), np.float32)
    LANDS["dunes"].rows(size, 900, rows, seed)
    east, north = slopes(rows, step)
    lee = east < -0.4
    assert 0.08 < lee.mean() < 0.35
    assert 0.55 < np.median(np.hypot(east, north)[lee]) < 0.72  # sand at rest: 32 degrees are 0.62
    assert np.percentile(east, 95) < 0.4  # the wind comes from the west
    assert 40.0 < rows.max() - rows.min() < 200.0


@pytest.mark.parametrize("seed", (7, 1, 2))
def test_the_canyon_has_a_level_plateau_and_level_cliffs(seed):
    land = LANDS["canyon"]
    heights = land.heights(513, seed)
    assert heights[0].min() > 1500.0 and heights[-1].min() > 1500.0
    assert heights.min() < 800.0 and (heights.min(axis=0) < 860.0).all()  # the river passes every column
    steep = np.hypot(*slopes(heights, land.side / 512)) > 1.2
    part = (heights - heights.min()) / (heights.max() - heights.min())
    share = np.histogram(part[steep], 20, (0, 1))[0] / np.histogram(part, 20, (0, 1))[0].clip(1)
    assert share.max() > 0.9 and np.median(share) < 0.35  # some heights are cliffs, most are mostly not
    assert 0.3 < (part > 0.8).mean() < 0.9


@pytest.mark.parametrize("seed", (7, 1, 2))
def test_mountains_stand_above_their_forelands(seed):
    heights = LANDS["mountains"].heights(257, seed)
    middle, rims = heights[96:161].mean(), np.concatenate([heights[:16], heights[-16:]]).mean()
    assert heights.min() > 0.0 and middle > 3 * rims and 1500.0 < heights.max() < 3300.0


@pytest.mark.parametrize("seed", (7, 1, 2))
def test_an_archipelago_is_islands_in_a_sea(seed):
    heights = LANDS["archipelago"].heights(257, seed)
    border = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    assert border.max() < -20.0
    land = heights > 0.0
    assert 0.06 < land.mean() < 0.5 and 500.0 < heights.max() < 2600.0
    crossings = (np.diff(land.astype(int), axis=1) > 0).sum(1).max()
    assert crossings >= 3  # islands on one line from west to east


def test_a_land_is_imported_by_its_name(tmp_path):
    report = import_source(ImportSettings("dunes", size=130, seed=11), tmp_path / "dunes.store")
    field = open_store(tmp_path / "dunes.store")
    assert report["raster"] == [130, 130]
    assert field.lattice.step_x == pytest.approx(8192 / 129)
    assert np.array_equal(field.heights(slice(None), slice(None)), LANDS["dunes"].heights(130, seed=11))


def test_a_land_of_one_sample_is_refused():
    with pytest.raises(TerrainError, match="The built-in canyon has 1 samples a side; expected 2 to 65536"):
        ImportSettings("canyon", size=1).check()
