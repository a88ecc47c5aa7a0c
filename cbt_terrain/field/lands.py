# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in terrains, which need no file and have any resolution."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..run import launch
from ..run.buffers import flat
from . import island

if TYPE_CHECKING:
    import warp as wp


@dataclass(frozen=True, eq=False)
class BuiltInTerrain:
    """A built-in terrain.

    Attributes:
        name: its name as a source to import.
        label, about: its texts in menus.
        side: metres of its square.
        launched: launched(size, first_row, seed) returns the kernel that computes its rows, and the kernel's arguments
            but the first, offset, and the last, samples. It imports the kernel.
        preset: name of the stack of effects that suits it, "" for none.
        cost: cost of a sample, in lookups.
    """

    name: str
    label: str
    about: str
    side: float
    launched: "Callable[[int, int, int], tuple[wp.Kernel, list]]"
    preset: str = ""
    cost: float = 30.0

    def rows(self, size: int, first_row: int, rows: np.ndarray, seed: int, threads: int | None = None) -> None:
        """Fill `rows` (float32 [n, size], metres) with rows first_row .. first_row + n of `size`, row 0 south.

        Heights depend only on the seed and the position, so resolutions agree where their samples coincide.
        """
        from ...kernels import wp

        kernel, inputs = self.launched(size, first_row, seed & 0xFFFFFFFF)
        inputs.append(flat(rows, wp.float32))
        launch.spread(kernel, len(rows), inputs, step=self.name, threads=threads, cost=self.cost * size)

    def heights(self, size: int, seed: int = island.DEFAULT_SEED) -> np.ndarray:
        """Return the terrain's heights, float32 [size, size] metres, row 0 south."""
        samples = np.empty((size, size), np.float32)
        self.rows(size, first_row=0, rows=samples, seed=seed)
        return samples

    def load(self) -> None:
        """Load its kernel, for a process that gives up its rights before it computes rows."""
        kernel, _ = self.launched(1, 0, 0)
        launch.slices(kernel, [], step="load")  # launches nothing


def _island_kernel(size: int, row: int, seed: int) -> "tuple[wp.Kernel, list]":
    """Return the kernel that computes rows of the island from number `row` on, and its arguments.

    The first argument, offset, and the last, samples, are left out (see `BuiltInTerrain.launched`). size: samples a
    side.
    """
    from ...kernels import wp
    from ...kernels.field.island import raise_island

    return raise_island, [size, row, wp.uint32(seed)]


_DUNES = 8192.0


def _dunes_kernel(size: int, row: int, seed: int) -> "tuple[wp.Kernel, list]":
    """Return the kernel that computes rows of the dunes from number `row` on, and its arguments.

    The first argument, offset, and the last, samples, are left out (see `BuiltInTerrain.launched`). size: samples a
    side.
    """
    from ...kernels import wp
    from ...kernels.land.sand import raise_dunes

    return raise_dunes, [size, row, wp.float64(0.5 * _DUNES), wp.uint32(seed)]


def _mountain_terrain(name: str, label: str, about: str, side: float, shape: str, preset: str) -> BuiltInTerrain:
    """Return a built-in terrain of mountain ranges, which `raise_land` computes.

    name: as a source to import. label, about: texts in menus. shape: name of its shape's number in
    kernels/land/ranges.py. side: metres of its square. preset: name of the stack that shapes it.
    """

    def launched(size: int, row: int, seed: int) -> "tuple[wp.Kernel, list]":
        """Return the kernel that computes rows from number `row` on, and its arguments but the first and the last."""
        from ...kernels import wp
        from ...kernels.land import ranges

        return ranges.raise_land, [getattr(ranges, shape), size, row, wp.float64(0.5 * side), wp.uint32(seed)]

    return BuiltInTerrain(name, label, about, side, launched, preset)


LANDS: dict[str, BuiltInTerrain] = {
    land.name: land
    for land in (
        BuiltInTerrain(
            "island",
            "Built-in Island",
            "A volcano, ridges and beaches",
            island.SIDE,
            _island_kernel,
            "volcanic_island",
        ),
        _mountain_terrain(
            "mountains", "Mountains", "A mountain range with foothills", 24_576.0, "MOUNTAINS", "great_range"
        ),
        BuiltInTerrain(
            "dunes",
            "Dunes",
            "Long crests of sand, steep on their east side",
            _DUNES,
            _dunes_kernel,
        ),
        _mountain_terrain("canyon", "Canyon", "A plateau of rock layers, cut by a river", 16_384.0, "CANYON", "desert"),
        _mountain_terrain(
            "archipelago",
            "Archipelago",
            "Islands and volcanoes in a shallow sea",
            32_768.0,
            "ARCHIPELAGO",
            "volcanic_island",
        ),
    )
}
