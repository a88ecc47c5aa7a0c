# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews of a stack: the coarsest level, at the position and in the size of the terrain."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators import preview as previews
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.preview import preview
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.height_operators.tiles import whole_land
from land_effects import bumpy

STEPS = 8.0, 11.0


def hill(**more) -> Entry:
    return Entry("hill", {"height": 300.0, "radius": 900.0, "east": 2400.0, "north": 1700.0}, **more)


def test_a_preview_of_a_small_raster_is_the_whole_result():
    land = from_array(bumpy(180, 251), *STEPS)
    mask = HeightMask("", (GroundRule("height", low=0.0, edge=40.0),), 0.7)
    stack = Stack((Entry("smooth", mask=mask), hill(), Entry("level", on=False)))
    made, found = shape(land, stack, whole_land(land.lattice)), preview(land, stack)
    assert abs(found.field.heights() - land.heights() - made.change).max() < 1e-3
    assert set(found.field.layers) == {"worn", "fresh", "mark"}
    assert abs(found.field.layers["worn"] - made.layers["worn"]).max() < 1e-5
    assert len(found.ms) == 2 and found.step_m == 11.0 and found.left_out_entry == ""


@pytest.mark.parametrize("shape_", [(700, 1000), (1026, 515), (2, 1300)])
def test_a_preview_is_at_the_position_of_the_terrain(shape_):
    """A cone has linear flanks, which every level samples exactly; rows and columns are no powers of two."""
    land = from_array(np.zeros(shape_, np.float32), *STEPS)
    made = preview(land, Stack((hill(),)))
    found = made.field
    lattice, own = found.lattice, land.lattice
    assert lattice.step_x * lattice.cells_x == pytest.approx(own.step_x * own.cells_x, rel=1e-12)
    assert lattice.step_y * lattice.cells_y == pytest.approx(own.step_y * own.cells_y, rel=1e-12)
    assert max(found.samples.shape) <= 1025
    y, x = (np.arange(n) * step for n, step in zip(found.samples.shape, (lattice.step_y, lattice.step_x), strict=True))
    away = np.hypot(x[None, :] - 2400.0, y[:, None] - 1700.0)
    assert abs(found.heights() - np.maximum(300.0 * (1 - away / 900.0), 0)).max() < 300.0 / 900.0 * made.step_m


@pytest.fixture
def made(monkeypatch):
    """Record the names of the applied operators in order."""
    names, after = [], previews._apply_entry
    monkeypatch.setattr(previews, "_apply_entry", lambda *given: names.append(given[2].effect) or after(*given))
    return names


def contents(found: previews.Preview) -> list[bytes]:
    field = found.field
    return [
        str(field.key).encode(),
        field.heights().tobytes(),
        *(field.layers[n].tobytes() for n in sorted(field.layers)),
    ]


def test_only_changed_entries_and_later_ones_are_applied_again(made):
    """The bytes are those of a preview without a cache."""
    samples = bumpy(300, 400)
    land = from_array(samples, *STEPS)
    low, high = (
        HeightMask("", (GroundRule("height", low=h, edge=40.0), GroundRule("sky", low=0.9))) for h in (0.0, 50.0)
    )
    first = smooth, masked_hill, level = Entry("smooth"), hill(mask=low), Entry("level")
    steps = [
        (first, ["smooth", "hill", "level"]),
        ((smooth, masked_hill, Entry("level", {"part": 0.5})), ["level"]),
        ((smooth, hill(mask=high), level), ["hill", "level"]),
        ((Entry("smooth", {"sweeps": 5}), masked_hill, level), ["smooth", "hill", "level"]),
        ((masked_hill, smooth, level), ["hill", "smooth", "level"]),
        ((smooth, hill(mask=low, on=False), level), ["level"]),
        (first, []),
        ((smooth, hill(mask=low, seed=1), level), ["hill", "level"]),
    ]
    for entries, again in steps:
        made.clear()
        found = preview(land, Stack(entries), threads=2)
        assert made == again
        assert contents(found) == contents(preview(from_array(samples, *STEPS), Stack(entries)))
    other = from_array(samples + np.float32(1.0), *STEPS)
    made.clear()
    assert contents(preview(other, Stack(first))) != contents(preview(land, Stack(first))) and len(made) == 3


def test_a_moving_slider_keeps_the_entries_above_it_cached(made):
    land = from_array(bumpy(90, 70), *STEPS)
    for part in np.linspace(0.0, 1.0, 2 * previews.MAX_CACHED):
        preview(land, Stack((hill(), Entry("level", {"part": float(part)}))))
    assert made.count("hill") == 1 and len(land.cache.results[("land preview",)]) == previews.MAX_CACHED


def test_holes_stay_holes_and_the_source_is_not_written():
    samples = bumpy(90, 70)
    samples[20:30, 40:45] = np.nan
    land = from_array(samples.copy(), *STEPS, holes=True)
    before = land.heights().tobytes()
    found = preview(land, Stack((hill(),)), threads=3).field
    assert (found.valid == land.valid).all() and land.heights().tobytes() == before


def test_a_preview_leaves_out_slow_operators():
    land = from_array(bumpy(90, 70), *STEPS)
    found = preview(land, Stack((Entry("smooth", name="First"), hill())), seconds=-1.0)
    assert found.left_out_entry == "First" and found.ms == []
    assert abs(found.field.heights() - land.heights()).max() == 0.0
    assert preview(land, Stack((Entry("smooth"), hill()))).left_out_entry == ""


def test_an_operator_reads_the_layers_of_earlier_ones():
    land = from_array(bumpy(120, 130), *STEPS)
    found = preview(land, Stack((Entry("smooth"), Entry("level"))))
    assert found.field.layers["twice"].shape == (120, 130)
