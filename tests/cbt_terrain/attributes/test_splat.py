# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers: every rule against numpy in float64, and weights that add up to exactly 1."""

import itertools
import math
import os
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import splat
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest, SamplePoints
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.splat_rules import (
    DEFAULT,
    Layer,
    Painted,
    Rule,
    attributes_of_rules,
    check_layers,
    cover_rule,
    covers_nothing,
    image_rule,
)
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from rasters import hills

COUNT = 20_000
TIMES = 500 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 10


def places_of(field, level=0.0, scale=1.0, offset=0.0, count=COUNT, seed=1, threads=1):
    west, south, east, north = field.lattice.rectangle()
    rng = np.random.default_rng(seed)
    at = np.column_stack([rng.uniform(west, east, count), rng.uniform(south, north, count), np.zeros(count)])
    return SamplePoints(field, at.astype(np.float32), np.full(count, level, np.float32), scale, offset, threads)


def random_values(count=COUNT, seed=2):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, count)
    values = {
        "height": rng.uniform(0, 1000, count),
        "slope": rng.uniform(0, 1.5, count),
        "aspect": np.column_stack([np.sin(angle), np.cos(angle)]),
        "mean_curvature": 0.1 * rng.standard_normal(count),
        "flow": 10 ** rng.uniform(1, 8, count),
        "wetness": rng.uniform(2, 20, count),
    }
    return {name: value.astype(np.float32) for name, value in values.items()}


def weights(places, layers, read, names=splat.NAMES):
    made = splat.make(places, {name: {"layers": tuple(layers)} for name in names}, read)
    return np.hstack([made[name] for name in names])


FIELD = from_array(hills(100, 70), 10.0)


def ramp(x):
    t = np.clip(x, 0, 1)
    return t * t * (3 - 2 * t)


def band(q, low, high, edge):
    edge = max(edge, 1e-30)
    return ramp((q - low) / edge + 0.5) * ramp((high - q) / edge + 0.5)


def share_on_top(layer, places, read):
    """Return the share that a layer has of the ground when it covers another."""
    return weights(places, [Layer("ground"), layer], read, ("splat_1",))[:, 1].astype(np.float64)


@pytest.mark.parametrize(
    "rule, of",
    [
        (Rule("height", 200.0, 700.0, 80.0), lambda v: v["height"]),
        (Rule("height", 200.0, math.inf, 0.0), lambda v: v["height"]),
        (Rule("slope", 0.4, 1.1, 0.2), lambda v: v["slope"]),
        (Rule("curvature", -0.05, 0.1, 0.02), lambda v: v["mean_curvature"]),
        (Rule("wetness", 6.0, 12.0, 3.0), lambda v: v["wetness"]),
    ],
)
def test_a_rule_is_a_band_with_soft_edges(rule, of):
    read = random_values()
    q = of({name: value.astype(np.float64) for name, value in read.items()})
    found = share_on_top(Layer("x", (rule,), on_top=True), places_of(FIELD), read)
    assert np.allclose(found, band(q, rule.low, rule.high, rule.edge), atol=2e-6) and 0 < found.mean() < 1


def test_flow_is_compared_by_its_logarithm():
    read = random_values()
    found = share_on_top(Layer("x", (Rule("flow", 1e4, 1e6, 1.0),), on_top=True), places_of(FIELD), read)
    assert np.allclose(found, band(np.log10(read["flow"].astype(np.float64)), 4, 6, 1), atol=5e-6)


@pytest.mark.parametrize(
    ("rule", "nothing"),
    [
        (Rule("slope", 0.8, 0.7, 0.1 - 1e-3), True),
        (Rule("slope", 0.8, 0.7, 0.1 + 1e-2), False),
        (Rule("slope", 0.7, 0.7, 0.0), False),
        (Rule("slope", 0.7, 0.8, 0.0), False),
        (Rule("flow", 1e5, 1e4, 0.99), True),
        (Rule("flow", 1e5, 1e4, 1.2), False),
        (Rule("flow", 1e5, 0.0, 9.0), True),
    ],
)
def test_reversed_limits_cover_nothing(rule, nothing):
    count = 20_001
    places = replace(places_of(FIELD), positions=np.zeros((count, 3), np.float32), level=np.zeros(count, np.float32))
    read = {"slope": np.linspace(0.5, 1.0, count, dtype=np.float32), "flow": np.geomspace(1e3, 1e6, count, dtype="f4")}
    read["slope"][0] = np.float32(rule.low)
    found = share_on_top(Layer("x", (rule,), on_top=True), places, read)
    assert covers_nothing(rule) == nothing == (not found.any())


def test_aspect_rules_compare_a_direction():
    read, direction = random_values(), math.radians(200)
    rule = Rule("aspect", low=math.cos(math.radians(50)), edge=0.3, direction=direction)
    found = share_on_top(Layer("x", (rule,), on_top=True), places_of(FIELD), read)
    aspect = read["aspect"].astype(np.float64)
    q = np.cos(np.arctan2(aspect[:, 0], aspect[:, 1]) - direction)
    assert np.allclose(found, band(q, rule.low, math.inf, 0.3), atol=3e-6)
    assert (
        share_on_top(Layer("x", (rule,), on_top=True), places_of(FIELD), read | {"aspect": 0 * read["aspect"]})
    ).max() == 0


@pytest.mark.parametrize("scale, offset", [(1.0, 0.0), (2.5, -300.0), (-1.0, 50.0)])
def test_relief_is_a_part_of_the_terrain_as_displaced(scale, offset):
    read = random_values()
    places = places_of(FIELD, scale=scale, offset=offset)
    low, high = sorted(end * scale + offset for end in (FIELD.min_height, FIELD.max_height))
    read["height"] = (low + (high - low) * read["height"].astype(np.float64) / 1000).astype(np.float32)
    found = share_on_top(Layer("x", (Rule("relief", 0.3, 0.8, 0.1),), on_top=True), places, read)
    assert np.allclose(found, band((read["height"] - low) / (high - low), 0.3, 0.8, 0.1), atol=1e-5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("height", [0.0, -3.0, 1e5])
def test_level_ground_is_all_at_its_lowest_place(height):
    """Its relief is no number: nothing is above two thirds of it, all is below one."""
    field = from_array(np.full((9, 9), height, np.float32), 10.0)
    places = places_of(field, count=50)
    read = random_values(50) | {"height": np.full(50, height, np.float32), "slope": np.zeros(50, np.float32)}
    low, high = Layer("Low", (Rule("relief", high=0.5, edge=0.1),)), Layer("High", (Rule("relief", low=0.5, edge=0.1),))
    assert (weights(places, (low, high), read)[:, :2] == (1, 0)).all()
    assert (weights(places, DEFAULT, read)[:, :4] == (1, 0, 0, 0)).all(), "no snow on a plain"


def test_a_painted_image_is_read_over_the_rasters_extent():
    pixels = np.random.default_rng(0).uniform(size=(7, 13)).astype(np.float32)
    found = share_on_top(Layer("x", (image_rule(pixels),), on_top=True), places := places_of(FIELD), {})
    west, south, east, north = FIELD.lattice.rectangle()
    x = np.clip((places.positions[:, 0].astype(np.float64) - west) / (east - west) * 13 - 0.5, 0, 12)
    y = np.clip((places.positions[:, 1].astype(np.float64) - south) / (north - south) * 7 - 0.5, 0, 6)
    i, j = x.astype(int), y.astype(int)
    k, m, u, v = np.minimum(i + 1, 12), np.minimum(j + 1, 6), x - i, y - j
    low, high = pixels[j, i] * (1 - u) + pixels[j, k] * u, pixels[m, i] * (1 - u) + pixels[m, k] * u
    assert np.allclose(found, low * (1 - v) + high * v, atol=1e-6)
    corner = SamplePoints(FIELD, np.array([[west, south, 0]], np.float32), np.zeros(1, np.float32))
    assert share_on_top(Layer("x", (image_rule(pixels),), on_top=True), corner, {}) == pytest.approx(
        pixels[0, 0], abs=1e-7
    )


def test_images_of_several_sizes_lie_beside_each_other():
    dark, light = np.full((3, 5), 0.25, np.float32), np.full((8, 2), 0.75, np.float32)
    layers = [Layer("a"), Layer("b", (image_rule(dark),), on_top=True), Layer("c", (image_rule(light),), on_top=True)]
    found = weights(places_of(FIELD), layers, {})
    assert np.allclose(found[:, :3], (0.75 * 0.25, 0.25 * 0.25, 0.75), atol=1e-7)
    assert Painted(dark) == Painted(dark.copy()) != Painted(light) and hash(Painted(dark)) == hash(Painted(dark.copy()))


def test_layers_share_cover_and_mask():
    read = random_values()
    slope = band(read["slope"].astype(np.float64), 0.5, np.inf, 0.4)
    high = band(read["height"].astype(np.float64), 500, np.inf, 100)
    rock = Layer("rock", (Rule("slope", 0.5, edge=0.4),), strength=2.0)
    moss = Layer("moss", (cover_rule(1), Rule("height", high=800.0, edge=50.0)), strength=0.5)
    snow = Layer("snow", (Rule("height", 500.0, edge=100.0),), on_top=True)
    found = weights(places_of(FIELD), [Layer("ground"), rock, moss, snow], read)
    cover = 2 * slope
    on_rock = 0.5 * np.clip(cover, 0, 1) * band(read["height"].astype(np.float64), -np.inf, 800, 50)
    total = 1 + cover + on_rock
    expected = np.column_stack([1 / total, cover / total, on_rock / total, 0 * total]) * (1 - high)[:, None]
    expected[:, 3] = high
    assert np.allclose(found[:, :4], expected, atol=2e-6)


def test_bare_ground_is_the_first_layers():
    never = Rule("slope", 9.0)
    half = image_rule(np.full((1, 1), 0.5))
    layers = [Layer("a", (never,)), Layer("b", (never,)), Layer("c", (half,), on_top=True), Layer("d", (never,))]
    assert (weights(places_of(FIELD), layers, random_values())[:, :4] == (0.5, 0.0, 0.5, 0.0)).all()
    assert (weights(places_of(FIELD), layers[:2], random_values())[:, :2] == (1.0, 0.0)).all()


def test_noise_makes_ragged_edges_and_fades_with_distance():
    patches = Layer("x", (Rule("noise", 0.0),), on_top=True, noise_size=80.0, seed=3)
    found = share_on_top(patches, places_of(FIELD), {})
    assert 0.3 < found.mean() < 0.7 and set(np.unique(found)) <= {0.0, 0.5, 1.0}
    assert not np.array_equal(found, share_on_top(Layer(**(vars(patches) | {"seed": 4})), places_of(FIELD), {}))
    x = np.arange(-300, 300, 0.5)
    line = np.column_stack([x, 0 * x, 0 * x]).astype(np.float32)
    soft = Layer("x", (Rule("noise", -1.0, edge=4.0),), on_top=True, noise_size=80.0)
    steps = [
        share_on_top(soft, SamplePoints(FIELD, line, np.full(len(line), level, np.float32)), {})
        for level in (0.0, 2.0, 9.0)
    ]
    assert abs(np.diff(steps[0])).max() < 0.1, "noise is continuous"
    assert abs(np.diff(steps[1])).max() < abs(np.diff(steps[0])).max(), "at 40 m a sample waves of 20 m are gone"
    assert np.ptp(steps[0]) > 0.2 and np.ptp(steps[2]) == 0.0
    read = random_values()
    ragged = Layer("x", (Rule("height", 500.0, edge=100.0),), on_top=True, noise_size=80.0, ragged=1.0)
    found = share_on_top(ragged, places_of(FIELD), read)
    off = abs(read["height"].astype(np.float64) - 500.0)
    assert set(np.unique(found[off > 151])) == {0.0, 1.0} and (found[(off > 60) & (off < 100)] % 1.0 > 0).any()


def random_layers(rng):
    kinds = ["height", "slope", "curvature", "flow", "wetness", "noise", "relief", "aspect"]
    scale = {
        "height": 1000,
        "slope": 1.5,
        "curvature": 0.1,
        "flow": 1e5,
        "wetness": 15,
        "noise": 1,
        "relief": 1,
        "aspect": 1,
    }
    layers = []
    for number in range(rng.integers(1, 13)):
        rules = [
            Rule(
                str(kind), *np.sort(rng.uniform(-0.5, 1.5, 2) * scale[kind]), rng.uniform(0, 1) * min(scale[kind], 1000)
            )
            for kind in rng.choice(kinds, rng.integers(0, 4))
        ]
        if number and rng.uniform() < 0.3:
            rules.append(cover_rule(int(rng.integers(number))))
        numbers = float(10 ** rng.uniform(-3, 2)), bool(rng.integers(2)), float(rng.choice([0.0, 30.0])), rng.uniform()
        layers.append(Layer(f"{number}", tuple(rules), *numbers, seed=number))
    return tuple(layers)


def test_weights_add_up_to_one_in_any_order():
    """`ADAPTIVE_TERRAIN_FUZZ=10000` makes ten million."""
    rng = np.random.default_rng(5)
    orders = [list(range(12)), list(range(11, -1, -1)), *(rng.permutation(12).tolist() for _ in range(4))]
    for seed in range(TIMES):
        layers = random_layers(rng)
        w = weights(places_of(FIELD, level=seed % 5 / 2, seed=seed), layers, random_values(seed=seed))
        assert w.dtype == np.float32 and (w >= 0).all() and (w[:, len(layers) :] == 0).all()
        for order in orders:
            total = np.zeros(COUNT, np.float32)
            for k in order:
                total += w[:, k]
            assert (total == 1).all()


def test_weights_do_not_depend_on_other_requests():
    layers = random_layers(np.random.default_rng(8))
    read, places = random_values(), places_of(FIELD, 0.375)
    together = weights(places, layers, read)
    for k, name in enumerate(splat.NAMES):
        assert np.array_equal(weights(places, layers, read, (name,)), together[:, 4 * k : 4 * k + 4])
    part = np.arange(5, COUNT, 3)
    taken = {name: values[part] for name, values in read.items()}
    assert np.array_equal(weights(places.only(part), layers, taken), together[part])
    assert np.array_equal(weights(places_of(FIELD, 0.375, threads=3), layers, read), together)


def test_only_attributes_of_rules_are_read():
    ground = Layer("ground")
    flow = Layer("river", (Rule("flow", 1e6),), on_top=True)
    assert attributes_of_rules((ground,)) == () and attributes_of_rules((ground, flow)) == ("flow",)

    def steps(*layers):
        return [
            step.name
            for step in plan([AttributeRequest("splat_2", ("material",), parameters=(("layers", layers),))]).steps
        ]

    assert steps(ground) == ["splat_2"] and steps(ground, flow) == ["flow", "splat_2"]
    default = [step.name for step in plan([AttributeRequest("splat_1", ("material",))]).steps]
    assert sorted(default) == ["height", "slope", "splat_1"] and default[-1] == "splat_1"
    assert set(attributes_of_rules(DEFAULT)) < set(ATTRIBUTES["splat_1"].reads)


def test_two_lists_of_layers_do_not_mix():
    a, b = (Layer("a"),), (Layer("a"), Layer("b", strength=3.0))
    made = splat.make(places_of(FIELD), {"splat_1": {"layers": a}, "splat_2": {"layers": b}}, {})
    assert (made["splat_1"] == (1, 0, 0, 0)).all() and (made["splat_2"] == 0).all()


@pytest.mark.parametrize(
    "layers, said",
    [
        ((), "There are 0 splat layers; expected 1 to 12"),
        ((Layer("a"),) * 13, "There are 13 splat layers"),
        ((Layer("a", strength=-1.0),), "'a' has"),
        ((Layer("a", noise_size=math.nan),), "expected 0 to"),
        ((Layer("a", (Rule("steepness"),)),), "a rule about 'steepness'; expected one of"),
        ((Layer("a", (Rule("slope", math.nan),)),), "from nan"),
        ((Layer("a", (Rule("slope", edge=-1.0),)),), "edge of -1"),
        ((Layer("a", (cover_rule(0),)),), "a rule about layer 0; expected an earlier layer: move"),
        ((Layer("a", (Rule("image"),)),), "painted rule without an image"),
    ],
)
def test_invalid_layers_are_refused(layers, said):
    with pytest.raises(TerrainError, match=said):
        check_layers(layers)
    with pytest.raises(TerrainError):
        weights(places_of(FIELD), layers, random_values())


@pytest.mark.parametrize("image", [np.zeros(4), np.zeros((0, 4)), np.full((2, 2), np.nan)])
def test_invalid_images_are_refused(image):
    with pytest.raises(TerrainError, match="painted image"):
        image_rule(image)


def test_hostile_numbers_leave_finite_weights():
    extremes = [-math.inf, -3e38, 0.0, 1e-40, 3e38, math.inf]
    read = random_values(200)
    read["height"][:3], read["slope"][:3] = (3.4e38, -3.4e38, 0.0), (0.0, 1.5707964, 1e-40)
    places = places_of(FIELD, level=1e9, count=200)
    for low, high in itertools.product(extremes, extremes):
        rules = Rule("height", low, high, 1e-38), Rule("slope", low, high, 1e30), Rule("flow", low, high, 1.0)
        w = weights(places, [Layer("a"), Layer("b", rules, 1e6, noise_size=1e-6, ragged=1e6)], read)
        assert np.isfinite(w).all() and (w.sum(axis=1) == 1).all()
