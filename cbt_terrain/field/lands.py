# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in terrains, which need no file and have any resolution."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.island import raise_island
from ...kernels.land.ranges import ARCHIPELAGO, CANYON, MOUNTAINS, raise_land
from ...kernels.land.sand import raise_dunes
from ..run import launch
from ..run.buffers import flat
from . import island


@dataclass(frozen=True, eq=False)
class BuiltInTerrain:
    """A built-in terrain.

    Attributes:
        name: its name as a source to import.
        label, about: its texts in menus.
        side: metres of its square.
        kernel: computes its rows.
        inputs: inputs(size, first_row, seed) returns the kernel's arguments between offset and samples.
        preset: name of the stack of effects that suits it, "" for none.
        cost: cost of a sample, in lookups.
    """

    name: str
    label: str
    about: str
    side: float
    kernel: wp.Kernel
    inputs: Callable[[int, int, wp.uint32], list]
    preset: str = ""
    cost: float = 30.0

    def rows(self, size: int, first_row: int, rows: np.ndarray, seed: int, threads: int | None = None) -> None:
        """Fill `rows` (float32 [n, size], metres) with rows first_row .. first_row + n of `size`, row 0 south.

        Heights depend only on the seed and the position, so resolutions agree where their samples coincide.
        """
        inputs = [*self.inputs(size, first_row, wp.uint32(seed & 0xFFFFFFFF)), flat(rows, wp.float32)]
        launch.spread(self.kernel, len(rows), inputs, step=self.name, threads=threads, cost=self.cost * size)

    def heights(self, size: int, seed: int = island.DEFAULT_SEED) -> np.ndarray:
        """Return the terrain's heights, float32 [size, size] metres, row 0 south."""
        samples = np.empty((size, size), np.float32)
        self.rows(size, 0, samples, seed)
        return samples


def _mountain_terrain(name: str, label: str, about: str, side: float, number: int, preset: str) -> BuiltInTerrain:
    """Return a built-in terrain of mountain ranges, which `raise_land` computes.

    number: its shape's number in the kernel. side: metres of its square. preset: name of the stack that shapes it.
    """
    half = wp.float64(0.5 * side)
    return BuiltInTerrain(
        name, label, about, side, raise_land, lambda size, row, seed: [number, size, row, half, seed], preset
    )


_DUNES = 8192.0
LANDS: dict[str, BuiltInTerrain] = {
    land.name: land
    for land in (
        BuiltInTerrain(
            "island",
            "Built-in Island",
            "A volcano, ridges and beaches",
            island.SIDE,
            raise_island,
            lambda size, row, seed: [size, row, seed],
            "volcanic_island",
        ),
        _mountain_terrain(
            "mountains", "Mountains", "A mountain range with foothills", 24_576.0, MOUNTAINS, "great_range"
        ),
        BuiltInTerrain(
            "dunes",
            "Dunes",
            "Long crests of sand, steep on their east side",
            _DUNES,
            raise_dunes,
            lambda size, row, seed: [size, row, wp.float64(0.5 * _DUNES), seed],
        ),
        _mountain_terrain("canyon", "Canyon", "A plateau of rock layers, cut by a river", 16_384.0, CANYON, "desert"),
        _mountain_terrain(
            "archipelago",
            "Archipelago",
            "Islands and volcanoes in a shallow sea",
            32_768.0,
            ARCHIPELAGO,
            "volcanic_island",
        ),
    )
}
