# SPDX-License-Identifier: GPL-3.0-or-later
"""Grounds for tests of rivers, and rivers over them."""

import numpy as np
from adaptive_terrain.cbt_terrain.height_operators.fluvial import Bed
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from adaptive_terrain.cbt_terrain.height_operators.rivers import RIVERS


def rough(rows, columns, seed=2):
    """Return hills of 200 m with pits between them, above 20 m, and a sea in one corner."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((rows, columns))
    h = 110 + 60 * np.sin(x / 17) * np.cos(y / 23) + 12 * rng.standard_normal((rows, columns))
    return np.where(np.hypot(y, x) < rows / 3, -3.0, np.maximum(h, 20.0)).astype(np.float32)


def bed_of(h, step_x, step_y, **other):
    n = h.size
    given = {"weight": np.ones(n, np.float32), "erodibility": np.ones(n, np.float32), "uplift": np.zeros(n, np.float32)}
    given |= {"fixed": np.zeros(n, bool), "sediment": np.zeros(n, np.float32), "cell_weight": np.ones(n)} | other
    return Bed(h.shape, step_x, step_y, h.reshape(-1).copy(), **given)


def aged(h, spacing, **given):
    ground = OperatorGround(
        h, spacing, spacing, **{k: given.pop(k) for k in ("mask", "missing", "seed", "threads") if k in given}
    )
    return apply_by_levels(RIVERS, ground, RIVERS.defaults() | given)


def grow(start, uplift, spacing, threads=1, **given):
    """Return the change of a range that grows out of `start` by uplift, metres a year, in 3 million years."""
    values = {"years": 3e6, "erodibility": 1e-5, "rise": float(uplift.max())} | given
    layers = {"uplift": (uplift / np.float32(values["rise"])).astype(np.float32)}
    ground = OperatorGround(start, spacing, spacing, layers=layers, threads=threads)
    return apply_by_levels(RIVERS, ground, RIVERS.defaults() | values)
