# SPDX-License-Identifier: GPL-3.0-or-later
"""The shipped presets: each can be read, and shapes its land as its name says."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.lands import LANDS
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import read_stack
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.land.presets import FOLDER, SHIPPED

NAMES = ("alpine", "desert", "great_range", "old_hills", "volcanic_island", "light_weathering", "water_and_snow")
ON = ("island", "canyon", "mountains", "mountains", "island", "canyon", "mountains")  # the land of each
KEEPING, BUILDING = "Keep the Land", "Build Different Mountains"
SIZE = 201
pytestmark = pytest.mark.thorough  # 11 s of CPU


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stacks")


@pytest.fixture(scope="module")
def layer_of(shaped, folder):
    """Return a function that reads a by-product of a preset: float32 [rows, columns]."""
    return lambda name, layer: open_store(folder / name).layers[layer]


@pytest.fixture(scope="module")
def shaped(folder):
    """Shape every preset; return heights before and after, the spacing in metres and the report, by name."""
    made = {}
    for name, land in zip(NAMES, ON, strict=True):
        if not (folder / land).exists():
            import_source(ImportSettings(land, size=SIZE), folder / land)
        report = run_shape(folder / land, read_stack(FOLDER / f"{name}.json"), folder / name)
        before, after = (open_store(folder / n).heights(slice(None), slice(None)) for n in (land, name))
        made[name] = before, after, LANDS[land].side / (SIZE - 1), report
    return made


def steepness(heights: np.ndarray, step: float) -> float:
    """Median slope of the steeper half, metres a metre."""
    north, east = np.gradient(heights.astype(np.float64), step)
    return float(np.percentile(np.hypot(north, east), 75))


def test_all_of_them_are_tested():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(NAMES)
    assert {name for group in SHIPPED.values() for name in group} == set(NAMES)
    assert {land.preset for land in LANDS.values()} <= {"", *NAMES}


def test_entries_of_a_preset_have_different_names_and_seeds():
    for name in NAMES:
        entries = read_stack(FOLDER / f"{name}.json").entries
        assert all(entry.name and entry.on for entry in entries)
        assert len({entry.seed for entry in entries}) == len(entries)


@pytest.mark.parametrize("name", NAMES)
def test_heights_stay_finite_and_within_reason(shaped, name):
    before, after, _, _ = shaped[name]
    assert np.isfinite(after).all()
    assert after.max() < before.max() + 600.0
    assert name in SHIPPED[KEEPING] or np.abs(after - before).max() > 20.0


@pytest.mark.parametrize("name", SHIPPED[KEEPING])
def test_presets_that_keep_the_land_change_it_little(shaped, name):
    """The summit and the mean stay within metres, and 99 % of the heights within 1 % of the relief."""
    before, after, _, _ = (a if i > 1 else a.astype(np.float64) for i, a in enumerate(shaped[name]))
    change, relief = after - before, np.ptp(before)
    assert 0.0 < np.percentile(abs(change), 99) < 0.01 * relief and abs(change.mean()) < 1.0
    assert abs(after.max() - before.max()) < 6.0
    assert np.corrcoef(before.ravel(), after.ravel())[0, 1] > 0.9999


def test_presets_with_uplift_are_in_the_group_that_says_so():
    stacks = {name: read_stack(FOLDER / f"{name}.json") for name in NAMES}
    uplifted = {name for name, stack in stacks.items() if any(e.values.get("rise", 0.0) > 0.0 for e in stack.entries)}
    assert uplifted == set(SHIPPED[BUILDING])
    assert all("different mountains" in tooltip for _, tooltip in SHIPPED[BUILDING].values())
    assert list(SHIPPED)[0] == KEEPING and list(SHIPPED)[-1] == BUILDING


def test_the_alps_grow_steep_and_old_hills_gentle(shaped):
    before, alps, step, _ = shaped["great_range"]
    _, hills, _, _ = shaped["old_hills"]
    assert steepness(alps, step) > 1.3 * steepness(before, step)
    assert steepness(hills, step) < 0.9 * steepness(alps, step)
    assert hills.max() < alps.max() - 200.0


@pytest.mark.parametrize("name", ["alpine", "volcanic_island"])
def test_the_island_keeps_its_sea_and_a_mountain(shaped, name):
    before, after, _, _ = shaped[name]
    sea = before <= -1.0
    assert np.abs(after - before)[sea].max() < 2.0
    assert after.max() > 500.0


def test_snow_lies_on_the_mountain_and_not_on_the_shore(shaped, layer_of):
    for name, line in (("alpine", 600.0), ("great_range", 1500.0)):
        snow, heights = layer_of(name, "snow"), shaped[name][1]
        assert 0.01 < (snow > 0.1).mean() < 0.5
        low, high = snow[heights < line - 500.0], snow[heights > line + 100.0]
        assert np.percentile(low, 99) < 0.1 < np.median(high)  # slides bring some further down
