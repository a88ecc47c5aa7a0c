# SPDX-License-Identifier: GPL-3.0-or-later
"""What a sweep of scree costs beside plain numpy, and what a droplet costs."""

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.island import SIDE, island
from ...cbt_terrain.land_effects import droplets, thermal
from ...cbt_terrain.land_effects.land_effect import Ground
from ..rig import plain_scree
from ..rig.measure import Row, alternate, stopwatch

SAMPLES = 1025
PER_KM2 = 500.0


def scree_rows():
    """Of the built-in island, one thread."""
    heights, step = np.maximum(island(SAMPLES), np.float32(0.0)), SIDE / (SAMPLES - 1)
    ground = Ground(heights, step, step, whole=heights.shape)
    yield _scree(ground)
    yield _droplets(ground)


def _scree(ground: Ground) -> Row:
    """A sweep from bare rock twice as steep as the island, with beds, ours and numpy's of the same bytes."""
    room = np.full(ground.heights.shape, 30.0, np.float32)
    base = 2.0 * ground.heights - room
    made = {}

    def sweep(name: str) -> float:
        left, scree = room.copy(), np.zeros_like(room)
        slope = thermal.slope_of(ground, thermal.THERMAL.defaults(), base, left, scree)
        with stopwatch() as elapsed:
            if name == "numpy":
                plain_scree.sweep(slope, 0, base, left, scree)
            else:
                list(thermal.sweep(slope, 0, 1))
        made[name] = left.tobytes() + scree.tobytes()
        return elapsed[0]

    timed = alternate(lambda: {"total": sweep("ours")}, lambda: sweep("numpy"))
    if made["ours"] != made["numpy"]:
        raise TerrainError("A sweep of scree has other bytes than the same in numpy.")
    figures = {"ns_sample": timed.ms["total"] * 1e6 / base.size}
    return Row("land_scree", base.size, timed.ms["total"], "numpy", timed.baseline_ms, figures=figures)


def _droplets(ground: Ground) -> Row:
    values = droplets.DROPLETS.defaults() | {"droplets": PER_KM2}

    def run() -> dict[str, float]:
        with stopwatch() as elapsed:
            droplets.rain_on(ground, values)
        return {"total": elapsed[0]}

    ms = alternate(run).ms["total"]
    count = PER_KM2 * (SIDE / 1000.0) ** 2
    return Row("land_droplets", ground.heights.size, ms, figures={"us_droplet": ms * 1e3 / count})
