# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack at a glance: the coarsest level for the whole, in the place and the size of the terrain."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.land import preview as previews
from adaptive_terrain.cbt_terrain.land.mask import GroundRule, Mask
from adaptive_terrain.cbt_terrain.land.preview import preview
from adaptive_terrain.cbt_terrain.land.shape import shape
from adaptive_terrain.cbt_terrain.land.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.land.tiles import all_tiles
from land_effects import OWN, bumpy

STEPS = 8.0, 11.0


@pytest.fixture(autouse=True)
def _own(own_effects):
    pass


def hill(**more) -> Entry:
    return Entry("hill", {"height": 300.0, "radius": 900.0, "east": 2400.0, "north": 1700.0}, **more)


def test_of_a_small_raster_it_is_all_there_is():
    land = from_array(bumpy(180, 251), *STEPS)
    mask = Mask("", (GroundRule("height", low=0.0, edge=40.0),), 0.7)
    stack = Stack((Entry("smooth", mask=mask), hill(), Entry("level", on=False)))
    made, found = shape(land, stack, all_tiles(land.lattice)), preview(land, stack)
    assert abs(found.field.heights() - land.heights() - made.change).max() < 1e-3
    assert set(found.field.layers) == {"worn", "fresh", "mark"}
    assert abs(found.field.layers["worn"] - made.layers["worn"]).max() < 1e-5
    assert len(found.ms) == 2 and found.step_m == 11.0 and found.without == ""


@pytest.mark.parametrize("shape_", [(700, 1000), (1026, 515), (2, 1300)])
def test_it_lies_where_the_terrain_lies(shape_):
    """A cone that is linear over its flank, so that no level moves it; rows and columns of no power of two."""
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


def test_what_has_not_changed_is_not_made_again(monkeypatch):
    land, made = from_array(bumpy(300, 400), *STEPS), []
    after = previews._after
    monkeypatch.setattr(previews, "_after", lambda *given: made.append(given[2].effect) or after(*given))
    stack = Stack((Entry("smooth"), hill(), Entry("level")))
    preview(land, stack)
    assert made == ["smooth", "hill", "level"]
    preview(land, Stack((*stack.entries[:2], Entry("level", {"part": 0.5}))))
    assert made[3:] == ["level"]
    preview(land, Stack((hill(), *stack.entries[1:])))
    assert made[4:] == ["hill", "hill", "level"]
    first = preview(land, stack).field
    del land.found[("land preview",)]
    assert preview(land, stack).field.heights().tobytes() == first.heights().tobytes()


def test_holes_stay_holes_and_the_source_is_not_written():
    samples = bumpy(90, 70)
    samples[20:30, 40:45] = np.nan
    land = from_array(samples.copy(), *STEPS, holes=True)
    before = land.heights().tobytes()
    found = preview(land, Stack((hill(),)), threads=3).field
    assert (found.valid == land.valid).all() and land.heights().tobytes() == before


def test_a_preview_does_without_what_is_too_slow():
    land = from_array(bumpy(90, 70), *STEPS)
    found = preview(land, Stack((Entry("smooth", name="First"), hill())), seconds=-1.0)
    assert found.without == "First" and found.ms == []
    assert abs(found.field.heights() - land.heights()).max() == 0.0
    assert preview(land, Stack((Entry("smooth"), hill()))).without == ""


def test_an_effect_finds_what_those_before_it_have_left():
    land = from_array(bumpy(120, 130), *STEPS)
    found = preview(land, Stack((Entry("smooth"), Entry("level"))))
    assert found.field.layers["twice"].shape == (120, 130)
    assert set(OWN) >= {"smooth", "level"}
