# SPDX-License-Identifier: GPL-3.0-or-later
"""Thermal erosion: cliffs break above the angle of their bed, and the scree lies below at its own.

A mask weighs how much rock may break; what broke off slides on where it must, also to where the mask is 0.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np
import warp as wp

from ...kernels.land import thermal as kernels
from ..effects.effect import Parameter
from ..run import launch
from ..run.buffers import flat
from .balance import balanced
from .land_effect import Change, Evaluate, Ground, LandEffect, LandLayer

# Sweeps of a level in which rock breaks, and then those in which scree comes to rest; the coarsest level takes so many
# times as many.
BREAKING, RESTING, AT_FIRST = 10, 20, 20
# No fan is a plane: the angle at which scree lies is other from place to place, in waves of so many metres and shorter.
LONGEST, OCTAVES = 500.0, 3
# A pair settles fully, but gives no more than a part of its scree at once: on steep rock all of it would hurry from
# every second sample to the next. Of what is too steep of bare rock, so much breaks.
SHARE, PART, WEATHER = 0.5, 0.25, 0.05
# Samples of halo around a tile for every sweep: with 1 the island's tiles have the bytes of the whole already, though
# one sweep could carry something 6 samples far.
HALO = 1.6


def apply(ground: Ground, values: Mapping[str, float], coarse: Change | None) -> Change:
    """See Apply in land_effect.py."""
    shape = ground.heights.shape
    room, loose = _room(ground, values), ground.layers.get("scree", np.zeros(shape, np.float32))
    left, scree = _brought(ground, coarse, room, loose)
    base = np.ascontiguousarray(ground.heights - loose - room)
    if ground.missing is not None:
        base[ground.missing] = np.nan
    times = AT_FIRST if coarse is None else 1
    scree = settle(base, room, left, scree, ground, values, times)
    worn, laid = room - left, scree - loose
    return Change(laid - worn, {"scree": laid, "wear": worn})


def _room(ground: Ground, values: Mapping[str, float]) -> np.ndarray:
    """float32 [rows, columns] m: how much rock may break off."""
    room = np.full(ground.heights.shape, values["depth"], np.float32)
    if ground.mask is not None:
        room *= ground.mask
    if ground.missing is not None:
        room[ground.missing] = 0.0
    return room


def _brought(
    ground: Ground, coarse: Change | None, room: np.ndarray, loose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What may still break off and what lies here when the coarser level is done, in metres.

    Between the samples of a coarser level nothing is lost; beyond its rim, and where this one has less room, there is:
    what was laid down makes up for it.
    """
    if coarse is None:
        return room.copy(), loose.copy()
    net = coarse.layers["scree"] - coarse.layers["wear"]
    worn, laid = np.clip(coarse.layers["wear"], 0.0, room), coarse.layers["scree"]
    if ground.missing is not None:
        laid = np.where(ground.missing, np.float32(0.0), laid)
    scree = np.maximum(loose + laid, 0.0)
    more = np.clip(laid, 0.0, scree)
    laid, worn = balanced(more, worn, room, scree - loose - worn, net, ground)
    scree += laid - more
    return np.ascontiguousarray(room - worn), np.ascontiguousarray(np.maximum(scree, 0.0))


def settle(
    base: np.ndarray,
    room: np.ndarray,
    left: np.ndarray,
    scree: np.ndarray,
    ground: Ground,
    values: Mapping[str, float],
    times: int,
) -> np.ndarray:
    """The scree after `times` the sweeps of one level; `left`, of `room`, is what may still break then. All float32
    [rows, columns] m, see kernels/land/thermal.py; `base` and `scree` are used up."""
    slope, rest = slope_of(ground, values, base, left, scree), np.zeros_like(scree)
    work = {"step": "thermal", "threads": ground.threads, "cost": 3.0 * slope.width}
    numbers = [LONGEST, OCTAVES, values["uneven"] * slope.repose]
    launch.spread(kernels.lie_unevenly, slope.height, [slope, *numbers], **work)
    breaking, sweeps, recorded = times * BREAKING, times * (BREAKING + RESTING), {}
    for number in range(sweeps):
        if number == breaking:
            even_out(left, room)
            slope.weather = 0.0
        for _half in sweep(slope, number, ground.threads, recorded):
            # What is still on its way is on rows of one parity after each half: the mean of four has no such comb.
            if number >= sweeps - 2:
                rest += np.float32(0.25) * scree
        ground.progress((number + 1) / sweeps)
    return rest


def sweep(slope: kernels.Slope, number: int, threads: int, recorded: dict | None = None) -> Iterator[None]:
    """Sweep `number`; yields after each half of it. `recorded`: as launch.py has it, for sweeps over the same slope.

    To and fro: with one order always, slabs of one parity would be worn more than those of the other.
    """
    work, odd = {"step": "thermal", "threads": threads, "recorded": recorded}, number & 1
    launch.spread(kernels.face_rows, slope.height, [slope], cost=0.1 * slope.width, **work)
    for along, parity in ((1, odd), (0, 1 - odd)):
        first = -((parity ^ slope.first_row) & 1)
        slabs, inputs = (slope.height - first + 1) // 2, [first, along, odd, slope]
        launch.spread(kernels.settle_slabs, slabs, inputs, cost=0.5 * slope.width, **work)
        yield


def even_out(left: np.ndarray, room: np.ndarray) -> None:
    """Take from what is worn the part that alternates from sample to sample: [1 2 1] / 4 along either side, in place.

    What one sample is worn less its neighbour is worn more, as far as there is room for it.
    """
    for a, b, of_a, of_b in (
        (left[:-1], left[1:], room[:-1], room[1:]),
        (left[:, :-1], left[:, 1:], room[:, :-1], room[:, 1:]),
    ):
        passed = np.float32(0.25) * np.clip((of_a - a) - (of_b - b), -a, b)
        before = a.copy()
        a += passed
        b -= a - before  # what has arrived: next to nothing is lost by rounding


def slope_of(
    ground: Ground, values: Mapping[str, float], base: np.ndarray, left: np.ndarray, scree: np.ndarray
) -> kernels.Slope:
    """What the kernels want: numbers, and arrays, whose memory is shared."""
    slope = kernels.Slope()
    slope.height, slope.width = ground.heights.shape
    slope.first_row, slope.first_column = ground.first
    slope.step_x, slope.step_y = ground.step_x, ground.step_y
    repose, soft, hard, dip = (
        math.tan(math.radians(values[name])) for name in ("scree_angle", "soft_angle", "hard_angle", "dip")
    )
    slope.repose, slope.soft, slope.hard, slope.thick = repose, soft, hard, values["bed"]
    towards = math.radians(values["dip_to"])
    slope.dip_x, slope.dip_y = dip * math.sin(towards) * ground.step_x, dip * math.cos(towards) * ground.step_y
    slope.part, slope.share, slope.weather, slope.seed = PART, SHARE, WEATHER, ground.seed & 0xFFFFFFFF
    slope.base, slope.left, slope.scree = (flat(array, wp.float32) for array in (base, left, scree))
    slope.facing = flat(np.empty_like(scree), wp.float32)
    return slope


def example(shape: Evaluate) -> None:
    """A cliff of 100 m in one bed of 60 degrees breaks, nothing is lost, and no rock of 30 degrees breaks at all."""
    x = np.tile(np.arange(65, dtype=np.float32), (33, 1))
    one_bed = {"soft_angle": 60.0, "hard_angle": 60.0, "depth": 20.0}
    change = shape("thermal", np.where(x < 32, np.float32(100.0), np.float32(0.0)), 10.0, **one_bed)
    worn, laid = (change.layers[name].astype(np.float64).sum() for name in ("wear", "scree"))
    assert worn > 33 * 10.0 and abs(laid - worn) < 1e-6 * worn
    assert change.heights[:, 31].max() < -10.0 and change.heights[:, 33].min() > 3.0
    change = shape("thermal", np.float32(10.0 * math.tan(math.radians(30.0))) * x, 10.0, uneven=0.0)
    assert not change.heights.any()


THERMAL = LandEffect(
    name="thermal",
    label="Scree",
    about="Cliffs break at the angle of their bed; the scree lies below at its own angle",
    apply=apply,
    example=example,
    parameters=(
        Parameter("depth", 30.0, 0.0, 500.0, "m", "The most rock that breaks off"),
        Parameter("scree_angle", 34.0, 20.0, 45.0, "degrees", "The angle at which scree lies"),
        Parameter("uneven", 0.07, 0.0, 1.0, "", "How much that angle differs from place to place, a part of it"),
        Parameter("soft_angle", 38.0, 20.0, 85.0, "degrees", "The angle at which the softest bed breaks"),
        Parameter("hard_angle", 70.0, 20.0, 85.0, "degrees", "The angle at which the hardest bed breaks"),
        Parameter("bed", 60.0, 1.0, 1000.0, "m", "How thick a bed is"),
        Parameter("dip", 2.5, 0.0, 45.0, "degrees", "How steeply the beds fall"),
        Parameter("dip_to", 60.0, 0.0, 360.0, "degrees", "Whereto the beds fall, clockwise from north"),
    ),
    layers=(
        LandLayer("scree", "m", "Scree on the rock"),
        LandLayer("wear", "m", "Rock that was removed"),
    ),
    reads=("scree",),
    halo=lambda _values, step: HALO * (BREAKING + RESTING) * step,
    masks=True,
    limit="None: a pair of neighbours settles at most fully",
    conserves="Rock and scree together, to 1e-7 of what moved",
    converges="257, 513 and 1,025 samples of the island, twice as steep: 0.94, then 0.48 m rms of 12 m; rests at 34°",
    cost_ns=350,
    source="Musgrave, Kolb and Mace 1989, section 3; here by pairs, one after the other",
    version=4,
)
