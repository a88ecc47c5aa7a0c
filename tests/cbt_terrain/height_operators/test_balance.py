# SPDX-License-Identifier: GPL-3.0-or-later
"""Conservation of mass from a coarser level to a finer one."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.balance import balance_mass
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import finer


def moved(rows, columns, seed=0):
    """Return the interpolated change of a coarser level, whose sum is 0, and other erosion and deposits, float32."""
    rng = np.random.default_rng(seed)
    coarse = rng.normal(size=(rows // 2 + 1, columns // 2 + 1))
    coarse = np.float32(np.round(coarse - coarse.mean(), 3))
    coarse[0, 0] -= np.float32(math.fsum(coarse.ravel().tolist()))
    net = finer(coarse, (rows, columns))
    return net, np.maximum(-net, 0) * np.float32(rng.uniform(0.6, 1.2, net.shape)), np.maximum(net, 0)


def balanced(net, taken, displaced):
    """Return the balanced deposits and erosion of a whole raster, where all erosion is the most that may be."""
    ground = OperatorGround(net, 5.0, 9.0, whole=net.shape)
    return balance_mass(displaced, taken, taken, displaced - taken, net, ground)


@pytest.mark.parametrize("shape", [(301, 420), (300, 421), (33, 31), (16, 64), (3, 300)])
def test_the_sum_of_a_whole_raster_is_kept(shape):
    net, taken, displaced = moved(*shape)
    made, took = balanced(net, taken, displaced)
    assert (took == taken).all()
    total = math.fsum((made - taken).ravel().tolist())
    assert abs(total) < 1e-7 * taken.sum() < 1e-3 * abs(math.fsum((displaced - taken).ravel().tolist()))
    assert (made[displaced == 0] == 0).all() and made.min() >= 0 and made.max() <= 2 * displaced.max()


def test_a_loss_is_made_up_for_nearby():
    """A slope loses a quarter less, so its deposits shrink by as much, and distant ones do not change."""
    net = np.zeros((200, 260), np.float32)
    net[90:120, 98:104], net[90:120, 104:110], net[100, 30], net[100, 170] = -4.0, 4.0, 2.0, -2.0
    taken, displaced = np.maximum(-net, 0), np.maximum(net, 0)
    taken[90:120, 98:104] = 3.0
    made, took = balance_mass(
        displaced, taken, 2 * taken, displaced - taken, net, OperatorGround(net, 5.0, 5.0, whole=net.shape)
    )
    assert (took == taken).all()
    assert made[90:120, 104:110].mean() == pytest.approx(3.0, abs=1e-4) and made[100, 30] == pytest.approx(2.0)
    assert 2.0 < made[90:120, 104:110].min() < made[90:120, 104:110].max() < 3.5


@pytest.mark.parametrize("first", [(0, 96), (52, 77), (101, 121)])
def test_a_tile_has_the_deposits_of_the_whole(first):
    """32 samples inside the cut they agree but for rounding, at the border of the whole too."""
    net, taken, displaced = moved(301, 420)
    whole, _ = balanced(net, taken, displaced)
    window = tuple(slice(f, f + n) for f, n in zip(first, (150, 180), strict=True))
    ground = OperatorGround(net[window], 5.0, 9.0, first=first, whole=net.shape)
    some = displaced[window], taken[window]
    part, _ = balance_mass(*some, some[1], some[0] - some[1], net[window], ground)
    south = 0 if first[0] == 0 else 32
    off = abs(part - whole[window])[south:-32, 32:-32]
    assert off.max() < 1e-3 < 0.05 < abs(whole - displaced).max()


@pytest.mark.parametrize("width", [420, 421])
def test_erosion_at_a_border_balances_distant_deposits(width):
    """3 m slid from the eastern border, where coarse samples have finer ones on one side only, over 300 samples. The
    deposits do not change, in the whole and in a tile without them; the erosion at the border does."""
    coarse = np.zeros((150, width // 2 + 1), np.float32)
    coarse[:, -20:], coarse[:, 20:40] = -3.0, 3.0
    shape = 298, width
    net = finer(coarse, shape)
    displaced, taken = np.maximum(net, 0), np.maximum(-net, 0)
    room = np.where(taken > 0, taken + np.float32(1.0), taken)
    laid_there, took = balance_mass(
        displaced, taken, room, displaced - taken, net, OperatorGround(net, 5.0, 9.0, whole=shape)
    )
    assert abs(laid_there - displaced)[50:-50].max() < 1e-4 and 0.01 < abs(took - taken).max() < 1.0
    assert (took <= room).all() and took.min() >= 0
    total = math.fsum((laid_there - took).ravel().tolist())
    assert abs(total) < 1e-6 * taken.sum() < 1e-3 * abs(math.fsum((displaced - taken).ravel().tolist()))
    cut = np.s_[:, 200:]
    ground = OperatorGround(net[cut], 5.0, 9.0, first=(0, 200), whole=shape)
    _, its = balance_mass(displaced[cut], taken[cut], room[cut], (displaced - taken)[cut], net[cut], ground)
    assert abs(its - took[cut]).max() < 1e-6
