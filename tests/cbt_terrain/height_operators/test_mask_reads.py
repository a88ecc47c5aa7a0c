# SPDX-License-Identifier: GPL-3.0-or-later
"""Mask rules about attributes: values at a level, in tiles and of by-products, and refused rules."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.routing import route
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask, compute_mask
from adaptive_terrain.cbt_terrain.height_operators.mask_reads import MASK_ATTRIBUTES, SHAPES, values_of
from adaptive_terrain.cbt_terrain.height_operators.preview import preview
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import (
    Entry,
    Stack,
    check_by_products,
    stack_content,
    stack_from,
)
from adaptive_terrain.cbt_terrain.height_operators.tiles import Level, whole_land
from land_effects import bumpy

LEVEL = Level(1, 331, 201, 10.0, 20.0)


def read(heights, *names, missing=None, threads=1):
    return values_of(names, LEVEL, heights.__getitem__, missing, {}, threads)


def test_curvatures_of_a_bowl_and_a_ridge():
    """z = x^2 / 2a + y^2 / 2b has the second derivatives 1 / a and 1 / b. The mean curvature of its lowest point is
    minus their mean; a ridge along x that falls to the east has 1 / b times its slope's inverse in plan."""
    y, x = np.mgrid[0:331, 0:201].astype(np.float64)
    x, y = (x - 100) * 10.0, (y - 165) * 20.0
    bowl = (x**2 / 8000.0 + y**2 / 20000.0).astype(np.float32)
    found = read(bowl, "mean_curvature")["mean_curvature"]
    assert found.shape == LEVEL.shape
    assert found[165, 100] == pytest.approx(-(1 / 4000.0 + 1 / 10000.0) / 2, rel=1e-3)
    ridge = (-0.5 * x - y**2 / 20000.0).astype(np.float32)
    plan = read(ridge, "plan_curvature", "profile_curvature")
    assert plan["plan_curvature"][165, 60] == pytest.approx((1 / 10000.0) / 0.5, rel=1e-3)
    assert abs(plan["profile_curvature"][165, 60]) < 1e-6


def test_flow_is_in_square_metres_and_its_edge_in_powers_of_ten():
    """Flow equals the routing of the level's samples; a weight is 0.5 at the limit, 0 and 1 half an edge away."""
    heights = bumpy(331, 201, 3)
    flow = read(heights, "flow", threads=2)["flow"]
    drainage = route(heights, 10.0, 20.0)
    filled = drainage.filled()
    areas = drainage.areas(filled)
    drainage.level_lakes(filled, areas)
    assert np.allclose(flow, areas.reshape(331, 201) * 200.0, rtol=1e-3)
    assert flow.tobytes() == read(heights, "flow")["flow"].tobytes()
    found = compute_mask(HeightMask("", (GroundRule("flow", 1e4, edge=2.0),)), None, LEVEL, None, {"flow": flow})
    assert (found[flow <= 1e3] == 0).all() and (found[flow >= 1e5] == 1).all()
    exact = np.array([[1e3, 1e4, 1e5, 5500.0]], np.float32)
    level = Level(0, 1, 4, 1.0, 1.0)
    found = compute_mask(HeightMask("", (GroundRule("flow", 1e4, edge=2.0),)), None, level, None, {"flow": exact})
    assert found[0] == pytest.approx([0.0, 0.5, 1.0, 0.25**2 * 2.5], abs=1e-6)
    found = compute_mask(HeightMask("", (GroundRule("flow", high=1e4),)), None, level, None, {"flow": exact})
    assert found[0] == pytest.approx([1.0, 1.0, 0.0, 1.0], abs=1e-6)


def test_water_leaves_at_holes():
    heights, missing = bumpy(331, 201, 3), np.zeros(LEVEL.shape, bool)
    missing[100:130, 80:100] = True
    flow, whole = (read(heights, "flow", missing=m)["flow"] for m in (missing, None))
    assert flow[~missing].min() > 0 and not np.allclose(flow, whole)


def test_the_sky_of_a_trench_is_that_between_its_walls():
    """The middle of a trench sees the sine of half the angle between its edges, and a rule about it adds a hill to the
    floor alone, in the preview too."""
    heights = np.full(LEVEL.shape, 200.0, np.float32)
    heights[:, 86:115] = 0.0
    sky = read(heights, "sky", threads=3)["sky"]
    assert sky[165, 100] == pytest.approx(150.0 / np.hypot(150.0, 200.0), abs=0.01) and sky[165, 20] == 1.0
    assert sky.tobytes() == read(heights, "sky")["sky"].tobytes()
    land = from_array(heights[:150], LEVEL.step_x, LEVEL.step_y)
    hill = Entry("hill", {"radius": 1e6}, mask=HeightMask("", (GroundRule("sky", high=0.7, edge=0.02),)))
    added = shape(land, Stack((hill,)), whole_land(land.lattice)).change
    assert (added[70:80, 95:106] > 99.0).all() and not added[:, :80].any()
    assert abs(preview(land, Stack((hill,))).field.heights() - land.heights() - added).max() < 1e-3


def test_a_mask_reads_the_scree_of_earlier_entries():
    """The hill is added where the entry before it left scree at the same level, in the preview too."""
    heights = bumpy(200, 300) * 4.0
    land = from_array(heights, 8.0, 11.0)
    hill = {"height": 50.0, "radius": 1e6, "east": 1500.0, "north": 1500.0}
    scree, rule = Entry("scree"), GroundRule("scree", low=1.0, edge=1.0)
    alone = shape(land, Stack((scree,)), whole_land(land.lattice))
    both = shape(land, Stack((scree, Entry("hill", hill, mask=HeightMask("", (rule,))))), whole_land(land.lattice))
    added, depth = both.change - alone.change, alone.layers["scree"]
    assert (depth > 1.5).mean() > 0.02 and (depth < 0.5).mean() > 0.5
    assert (added[depth < 0.49] == 0).all() and (added[depth > 1.51] > 49.0).all()
    small = from_array(heights[:130, :180], 8.0, 11.0)
    stack = Stack((scree, Entry("hill", hill, mask=HeightMask("", (rule,)))))
    whole, seen = shape(small, stack, whole_land(small.lattice)), preview(small, stack)
    assert abs(seen.field.heights() - small.heights() - whole.change).max() < 1e-3


def test_depths_of_the_source_count_with_those_of_the_stack():
    land = from_array(np.zeros((120, 150), np.float32), 10.0)
    land = land.with_raster(layers={"snow": np.tile(np.linspace(0, 2, 150, dtype=np.float32), (120, 1))})
    hill = Entry("hill", {"radius": 1e6}, mask=HeightMask("", (GroundRule("snow", low=1.0),)))
    added = shape(land, Stack((hill,)), whole_land(land.lattice)).change
    assert (added[:, :74] == 0).all() and (added[:, 76:] > 99.0).all()


@pytest.mark.parametrize("shaped", [False, True])
def test_a_mask_of_a_missing_by_product_is_refused(shaped):
    land = from_array(bumpy(60, 80), 10.0)
    mask = HeightMask("", (GroundRule("sediment", low=0.5),))
    stack = Stack((Entry("scree"), Entry("hill", mask=mask), Entry("rivers")))
    text = "The mask of entry 2 of the stack, hill, has a rule about sediment, which is not there; expected a layer of"
    with pytest.raises(TerrainError, match=text):
        check_by_products(stack, ()) if shaped else preview(land, stack)
    check_by_products(stack, ("sediment",))
    check_by_products(Stack((Entry("rivers"), *stack.entries)), ())
    with pytest.raises(TerrainError, match="which is not there"):
        check_by_products(Stack((Entry("rivers", on=False), *stack.entries)), ())


def test_rules_about_every_attribute_can_be_read_and_written():
    for name in MASK_ATTRIBUTES:
        content = {"version": 1, "entries": [{"effect": "hill", "mask": {"rules": [{"of": name, "low": 1}]}}]}
        stack = stack_from(content)
        assert stack_content(stack)["entries"][0]["mask"]["rules"] == [{"of": name, "low": 1.0}]
    assert all(effect.width == 1 for effect in MASK_ATTRIBUTES.values())
    found = read(bumpy(331, 201), *SHAPES)
    assert set(found) == set(SHAPES) and all(np.isfinite(values).all() for values in found.values())
    with pytest.raises(TerrainError, match="a rule about 'colour'; expected one of: height, slope, aspect, mean_curva"):
        stack_from({"version": 1, "entries": [{"effect": "hill", "mask": {"rules": [{"of": "colour"}]}}]})
