# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost curve: the cost of an error, and the error that a budget buys."""

import dataclasses
import itertools
import json
import math

import pytest
from adaptive_terrain.cbt_terrain.accuracy.cost_curve import CostCurve
from adaptive_terrain.cbt_terrain.errors import TerrainError
from hypothesis import given
from hypothesis import strategies as some

# Triangles grow with the error to the power -1, then -2; milliseconds are level at the coarse end.
KNOWN = CostCurve("px", (4.0, 2.0, 1.0), (1000.0, 2000.0, 8000.0), (3.0, 3.0, 12.0))
STEEP = dataclasses.replace(KNOWN, ms=KNOWN.triangles)

numbers = some.floats(1e-6, 1e9)


@some.composite
def curves(draw):
    count = draw(some.integers(2, 8))
    error = draw(some.lists(some.floats(1e-3, 1e3), min_size=count, max_size=count, unique_by=lambda e: round(e, 6)))
    costs = [draw(some.lists(numbers, min_size=count, max_size=count)) for _ in range(2)]
    return CostCurve.through("m", zip(error, *costs, strict=True))


def test_costs_are_interpolated_in_logarithms():
    assert [KNOWN.at(error) for error in KNOWN.error] == [(1000, 3), (2000, 3), (8000, 12)]
    assert KNOWN.at(math.sqrt(2)) == pytest.approx((4000, 6))
    assert KNOWN.at(math.sqrt(8)) == pytest.approx((1000 * math.sqrt(2), 3))


def test_beyond_the_points_the_end_slopes_go_on():
    assert KNOWN.at(0.5) == pytest.approx((32000, 48))
    assert KNOWN.at(8.0) == pytest.approx((500, 3))
    assert KNOWN.at(1e-300)[0] == math.inf


def test_a_budget_buys_the_finest_error_that_fits():
    assert STEEP.error_for_ms(8000) == 1.0
    assert STEEP.error_for_ms(4000) == 1.415  # sqrt(2), rounded up
    assert KNOWN.error_for_ms(3.0) == 2.0  # as dear as 4 px
    assert KNOWN.error_for_ms(48.0) == 0.5


def test_no_answer_is_far_beyond_the_measured_points():
    assert STEEP.error_for_ms(1e12) == KNOWN.error_for_ms(math.inf) == 0.25
    assert STEEP.error_for_ms(1e-9) == 64.0
    third = CostCurve("m", (1.0, 0.3125), (1.0, 2.0), (1.0, 2.0))
    assert third.error_for_ms(5.0) == 0.078125  # a quarter of the finest has more than four digits
    assert KNOWN.error_for_ms(2.9) == 64.0  # the coarse end is level, so no error is known to fit
    level = CostCurve("m", (2.0, 1.0), (5.0, 5.0), (1.0, 1.0))
    assert level.error_for_ms(1.0) == 0.25 and level.error_for_ms(0.99) == 32.0


@given(curves(), numbers, numbers)
def test_an_update_fits_its_budget_and_more_buys_no_worse(curve, less, more):
    less, more = sorted((less, more))
    error = curve.error_for_ms(less)
    assert curve.error[-1] / 4 <= curve.error_for_ms(more) <= error <= curve.error[0] * 16
    if error < curve.error[0] * 16:
        assert curve.at(error)[1] <= less * (1 + 1e-6)


@given(curves(), numbers)
def test_an_answer_is_tight_to_four_digits(curve, budget):
    error = curve.error_for_ms(budget)
    if curve.error[-1] / 4 < error < curve.error[0] * 16:
        assert curve.at(error * (1 - 1.01e-3))[1] > budget * (1 - 1e-6) or budget in curve.ms


@given(curves())
def test_measured_points_and_level_stretches_are_on_the_curve(curve):
    for error, triangles, ms in zip(curve.error, curve.triangles, curve.ms, strict=True):
        assert curve.at(error) == (triangles, ms)
    for (fine, less), (coarse, _) in itertools.pairwise(reversed(list(zip(curve.error, curve.ms, strict=True)))):
        if curve.at(coarse)[1] == less:
            assert curve.at(math.sqrt(fine * coarse))[1] == less


@given(curves())
def test_json_brings_back_the_same_curve(curve):
    assert CostCurve.from_json(curve.to_json()) == curve


@given(some.lists(some.tuples(some.floats(1e-3, 1e3), numbers, numbers), min_size=2, unique_by=lambda p: p[0]))
def test_costs_never_fall_whatever_the_order_of_measuring(points):
    curve = CostCurve.through("px", points)
    assert curve == CostCurve.through("px", reversed(points))
    assert all(a <= b for a, b in itertools.pairwise(curve.ms))
    assert curve.error == tuple(sorted((p[0] for p in points), reverse=True))


def test_noise_and_repeated_measurements_are_averaged():
    points = [(8, 100, 4.0), (4, 200, 1.0), (2, 400, 9.0), (1, 800, 10.0), (1, 800, 12.0), (1, 900, 11.0)]
    curve = CostCurve.through("px", points)
    assert curve.ms == pytest.approx((2.0, 2.0, 9.0, 11.0))
    assert curve.triangles == (100, 200, 400, 800)


GOOD = {"unit": "px", "error": [2, 1], "triangles": [10, 20], "ms": [1, 2]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"unit": "mm"}, "unit is 'mm'"),
        ({"error": [1, 2]}, "expected each smaller"),
        ({"error": [1]}, "1 errors, 2 triangle counts"),
        ({"error": [2], "triangles": [1], "ms": [1]}, "two or more"),
        ({"error": 2}, "error are 2"),
        ({"error": [2, True]}, "finite numbers above 0"),
        ({"ms": [2, 1]}, "ms fall"),
        ({"ms": [0, 1]}, "finite numbers above 0"),
        ({"ms": [1, float("nan")]}, "finite numbers above 0"),
        ({"ms": [1, float("inf")]}, "finite numbers above 0"),
        ({"ms": [1, 10**400]}, "finite numbers above 0"),
        ({"ms": ["1", "2"]}, "finite numbers above 0"),
        ({"triangles": None}, "finite numbers above 0"),
        ({"ms": [1e-308, 1e308]}, "from 1e-30 to 1e\\+30"),
        ({"error": [1e-323, 5e-324]}, "from 1e-30 to 1e\\+30"),
        ({"more": 1}, "expected unit, error, triangles, ms"),
    ],
)
def test_a_damaged_curve_is_one_sentence(change, message):
    assert CostCurve.from_json(json.dumps(GOOD)).at(1) == pytest.approx((20, 2))
    with pytest.raises(TerrainError, match=message):
        CostCurve.from_json(json.dumps(GOOD | change))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", None, "[" * 100_000, '{"unit": "px"}'])
def test_text_that_is_no_curve_is_one_sentence(text):
    with pytest.raises(TerrainError, match="damaged"):
        CostCurve.from_json(text)


def test_invalid_budgets_and_errors_are_refused():
    for bad in (0, -1, math.nan):
        with pytest.raises(TerrainError, match="expected more than 0"):
            KNOWN.error_for_ms(bad)
        with pytest.raises(TerrainError, match="above 0"):
            KNOWN.at(bad)
    with pytest.raises(TerrainError, match="0 errors"):
        CostCurve.through("px", [])
