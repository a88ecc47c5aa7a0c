# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers with separate displacement: their masks are the layers' weights, and the mesh keeps its bound."""

import math
import os

import numpy as np
from adaptive_terrain.cbt_terrain.attributes import evaluate, layered_detail
from adaptive_terrain.cbt_terrain.attributes.layered_detail import LayeredDetail, displaced
from adaptive_terrain.cbt_terrain.attributes.splat_rules import HEIGHT, SLOPE, Layer, Rule
from adaptive_terrain.cbt_terrain.field import blocks, derived_arrays
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.displacement_layers import max_of_masks
from adaptive_terrain.cbt_terrain.field.store import is_intact, open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from detail_scenes import check, ground_view
from fields import rough
from rasters import store_heights

HIGH = Layer("High", (Rule(HEIGHT, low=60.0, edge=20.0),), on_top=True)
STEEP = Layer("Steep", (Rule(SLOPE, low=math.radians(30), edge=math.radians(10)),), on_top=True)


def test_a_mask_is_the_weight_of_its_layer():
    """Of heights that rise from 0 to 100 m: half covered at 60 m, all of it from 70 m on, and upside down with -1."""
    heights = np.tile(np.arange(21, dtype=np.float32) * 5.0, (13, 1))
    field = from_array(heights, 10.0, 7.0)
    ground = LayeredDetail(None, (Layer("Grass"), HIGH), ((1, Detail(0.3)),))
    (coat,) = displaced(field, ground, 1.0, 0.0, 2).detail.layers
    wanted = np.clip((heights - 50.0) / 20.0, 0.0, 1.0)
    wanted = wanted * wanted * (3.0 - 2.0 * wanted)
    linear = np.clip((heights - 50.0) / 20.0, 0.0, 1.0)
    assert min(np.abs(coat.mask.values / 255 - w).max() for w in (wanted, linear)) < 3e-3
    (turned,) = displaced(field, ground, -1.0, 100.0, 1).detail.layers
    assert np.abs(turned.mask.values.astype(int) - coat.mask.values[:, ::-1]).max() <= 1


def test_masks_are_cached_and_independent_of_threads(monkeypatch):
    heights = rough(50, 37, relief=80.0).heights()
    ground = LayeredDetail(Detail(0.05), (Layer("Grass"), STEEP, HIGH), ((1, Detail(0.3)), (2, Detail(0.1, 9.0))))
    field = from_array(heights, 10.0)
    first = displaced(field, ground, 1.0, 0.0, 1)
    assert displaced(field, ground, 1.0, 0.0, 1) is first
    assert [coat.mask is None for coat in first.detail.layers] == [True, False, False]
    monkeypatch.setattr(evaluate, "BAND", 100)
    second = displaced(from_array(heights, 10.0), ground, 1.0, 0.0, 3)
    assert second.key == first.key


def test_the_bound_holds_on_layers_with_detail():
    ground = LayeredDetail(Detail(0.05), (Layer("Grass"), STEEP, HIGH), ((1, Detail(0.5)), (2, Detail(0.2, 9.0))))
    field = displaced(rough(50, 37, relief=80.0), ground, 1.0, 0.0, 2)
    view = ground_view(field, above=3.0)
    found = Terrain(field, 2).update(Criterion(error_px=1.0, max_triangles=4000), [view])
    assert 0.05 < check(found, field, [view])


def stored(path, field):
    """Write a store of a field's samples and open it."""
    return open_store(store_heights(path, field.samples, 10.0))


def test_masks_of_a_large_raster_are_in_its_store(tmp_path, monkeypatch):
    field = rough(50, 37, relief=80.0)
    ground = LayeredDetail(None, (Layer("Grass"), STEEP, HIGH), ((1, Detail(0.3)), (2, Detail(0.1, 9.0))))
    expected = displaced(field, ground, 1.0, 0.0, 1)
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    monkeypatch.setattr(blocks, "ROWS", 4)
    assert displaced(stored(tmp_path, field), ground, 1.0, 0.0, 1).key == expected.key
    with monkeypatch.context() as nothing:  # is computed again
        nothing.setattr("adaptive_terrain.cbt_terrain.attributes.evaluate.on_samples", None)
        again = displaced(open_store(tmp_path), ground, 1.0, 0.0, 1)
    view = ground_view(field, above=3.0)
    for one, two in zip(again.detail.layers, expected.detail.layers, strict=True):
        assert one.mask.values.tobytes() == two.mask.values.tobytes()
        assert one.mask.max_cells.tobytes() == two.mask.max_cells.tobytes()
    made = [Terrain(found, 2).update(Criterion(error_px=1.0), [view]).surface for found in (again, expected)]
    assert made[0].positions.tobytes() == made[1].positions.tobytes()
    assert len(verify(tmp_path)) == 6 and is_intact(again)
    os.truncate(next(tmp_path.glob("data-*/masks_*.npy")), 5000)
    assert not is_intact(again)


def test_masks_of_one_store_share_its_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    ground = LayeredDetail(None, (Layer("Grass"), STEEP, HIGH), ((1, Detail(0.3)), (2, Detail(0.1, 9.0))))
    found = displaced(stored(tmp_path, rough(50, 37)), ground, 1.0, 0.0, 1).detail
    assert np.shares_memory(max_of_masks(found), found.layers[1].mask.max_cells)


def test_the_last_masks_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    field = stored(tmp_path, rough(50, 37))
    for scale in range(1, 8):
        displaced(field, LayeredDetail(None, (Layer("Grass"), HIGH), ((1, Detail(0.3)),)), float(scale), 0.0, 1)
    assert len(list(tmp_path.glob("data-*/mask*.npy"))) == 2 * layered_detail.MAX_CACHED
