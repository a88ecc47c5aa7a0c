# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice between land in one piece and in tiles, and the estimate of seconds."""

import time
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.height_operators import shaping_cost
from adaptive_terrain.cbt_terrain.height_operators.derived_store import Land
from adaptive_terrain.cbt_terrain.height_operators.preview import preview
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.height_operators.tiles import all_tiles
from finer_fields import KNOWN, finer_store
from land_effects import bumpy
from rasters import store_heights

FACTOR = 4.0  # between estimate and measurement
RIVERS, RELIEF = Stack((Entry("rivers"), Entry("scree"))), Stack((Entry("relief"),))


@pytest.fixture(autouse=True)
def processor_time(monkeypatch):
    """Measure the time of the processor, since other programs on the same cores change all other times."""
    for clock in ("monotonic", "perf_counter"):
        monkeypatch.setattr(time, clock, time.process_time)


@pytest.mark.parametrize(
    "side, stack, whole",
    [
        (1800, RIVERS, True),
        (1800, RELIEF, False),  # its tiles have no margins
        (4097, RIVERS, True),
        (4098, RIVERS, False),  # it is made of tiles in any case
        (500, RIVERS, False),  # there are no tiles
    ],
)
def test_land_in_one_piece_is_chosen_where_it_costs_less(side, stack, whole):
    assert shaping_cost.costs_less_whole(fit(side, side, 10.0, 10.0), stack) == whole


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Build a store of 700 x 700 samples, 16 m apart; return its folder."""
    return str(store_heights(tmp_path_factory.mktemp("stores") / "bumpy", 20.0 * bumpy(700, 700), 16.0))


def shape(source: str, stack: Stack) -> tuple[str, float]:
    """Shape land as Blender does; return its folder and the seconds."""
    land = Land.of(source, stack, True)
    start = time.monotonic()
    run_shape(source, stack, land.folder, tiles=land.tiles)
    return land.folder, time.monotonic() - start


def estimated_by_preview(source: str, stack: Stack) -> float:
    """Return the seconds that shaping should take after a preview, of three that other programs may disturb."""
    previews = [preview(open_store(source), stack) for _ in range(3)]
    return min(shaping_cost.estimate_seconds(source, stack, shown, in_tiles=False) for shown in previews)


def assert_estimated(estimate: float, source: str, stack: Stack) -> None:
    """Assert that shaping takes about as long as was estimated."""
    _, seconds = shape(source, stack)
    print(f"estimated {estimate:.1f} s, took {seconds:.1f} s")
    assert seconds / FACTOR < estimate < seconds * FACTOR


def test_the_preview_is_the_first_calibration(source):
    stack = Stack((Entry("scree"), Entry("relief")))
    assert_estimated(estimated_by_preview(source, stack), source, stack)


def test_finer_tiles_are_part_of_the_estimate(tmp_path):
    """Their errors take most of the time."""
    source, stack = str(finer_store(tmp_path / "city", 97, 130, 4, KNOWN)), Stack((Entry("scree"),))
    assert_estimated(estimated_by_preview(source, stack), source, stack)


def test_earlier_land_is_the_better_calibration(source):
    """It needs no preview, and effects count by their own times."""
    folder, seconds = shape(source, Stack((Entry("scree"), Entry("relief"))))
    twice = Stack((Entry("scree"), Entry("scree", seed=1), Entry("relief")))
    estimate = shaping_cost.estimate_seconds(source, twice, None, in_tiles=False)
    content = read_json(Path(folder))
    spent = {name: 0.0 for name in ("scree", "relief")}
    for one in content["provenance"]["shaped"]["added"]:
        spent[one["effect"]] += one["ms"] / 1e3
    expected = content["report"]["seconds"] + spent["scree"]
    assert estimate == pytest.approx(expected, rel=1e-6)
    assert_estimated(estimate, source, twice)


def test_nothing_is_estimated_without_measurement(source, tmp_path):
    lonely = tmp_path / "lonely"
    lonely.mkdir()
    (lonely / "store.json").write_bytes((Path(source) / "store.json").read_bytes())
    assert shaping_cost.estimate_seconds(str(lonely), RELIEF, None, in_tiles=False) is None


def test_a_raster_of_one_tile_is_made_whole(tmp_path):
    """The tile costs the same, and exports need the whole land."""
    lattice = fit(257, 257, 24.0, 24.0)
    folder = str(tmp_path / "land")
    assert shaping_cost.costs_less_whole_than(lattice, RELIEF, folder, all_tiles(lattice))
