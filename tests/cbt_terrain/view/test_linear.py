# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums and small products have the same bits in every Python; tests/test_sums.py forbids other functions."""

import hashlib
from fractions import Fraction

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.view import linear
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.local_view import localise
from adaptive_terrain.cbt_terrain.view.spans import PlanUnits, spans_of
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View


def draw_numbers(count: int) -> np.ndarray:
    """Return float64 numbers in -1 .. 1 by integers alone, so that no library chooses them."""
    state, found = 12345, []
    for _ in range(count):
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        found.append((state >> 11) / 2**52 - 1.0)
    return np.array(found)


def test_numbers_are_added_from_left_to_right():
    # From Python 3.12 on the builtin sum gives 1, 2 and 1.
    assert linear.add_up([1e16, 1.0, -1e16]) == 0.0
    assert linear.add_up([1.0, 1e100, 1.0, -1e100]) == 0.0
    assert linear.add_up([0.1] * 10) == 1.0 - 2.0**-53
    assert linear.add_up([]) == 0.0
    assert linear.add_up(np.eye(2)).tolist() == [1.0, 1.0]


def test_a_length_is_right_to_the_last_bits():
    for x, y, z in draw_numbers(300).reshape(-1, 3).tolist():
        squares = Fraction(x) ** 2 + Fraction(y) ** 2 + Fraction(z) ** 2
        assert abs(Fraction(linear.length((x, y, z))) ** 2 / squares - 1) < Fraction(1, 10**15)


def test_products_have_the_same_bits_in_every_python():
    numbers, found = draw_numbers(9 * 500).reshape(-1, 3, 3), hashlib.blake2b(digest_size=8)
    for matrix in numbers:
        found.update(np.array([linear.length(matrix), linear.min_stretch(matrix), linear.determinant(matrix)]))
        for values in (linear.lengths(matrix), linear.product(matrix, matrix), linear.inverse(matrix)):
            found.update(values.tobytes())
    assert found.hexdigest() == "ab6349a3a020ef82"


VIEW_DIGESTS = {
    PERSPECTIVE: "92ef41f8963fc0a7",
    ORTHOGRAPHIC: "d37bf47b4812e326",
    PANORAMIC: "bafb3204f92f76be",
}


@pytest.mark.parametrize(("kind", "stored"), VIEW_DIGESTS.items())
def test_views_have_the_same_bits_in_every_python(kind, stored):
    numbers, found = draw_numbers(30 * 18).reshape(-1, 18), hashlib.blake2b(digest_size=8)
    criterion, box = Criterion(edge_px=9.7), np.array([[-500.0, -500.0, -100.0], [500.0, 500.0, 300.0]])
    for row in numbers:
        placement = np.eye(4)
        placement[:3, :3] += 0.3 * row[:9].reshape(3, 3)
        view = View.look(row[9:12] * 900, row[12:15] * 90, kind=kind, fov_deg=47.3, ortho_width=51.3, roll_deg=row[15])
        spans = spans_of(criterion, [view], placement, PlanUnits((10.1, 9.7), 9, 21, (1e-3, 2e-3, 3e-3)))
        found.update(view.key() + repr((spans.wholes, spans.scales, spans.edge, spans.lengths, spans.off)).encode())
        local = localise(view, placement, box, Criterion(shading_floor=0.0), spans.scales[0])
        found.update(b"".join(np.array(part).tobytes() for part in (local.planes, local.slant_x, local.slant_y)))
    assert found.hexdigest() == stored
