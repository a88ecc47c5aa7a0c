# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of a store: one array for each by-product of height operators, opened on first use."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from .store_arrays import all_finite, map_array


class LayerFiles(Mapping[str, np.ndarray]):
    """The layers of a store by name, each mapped and checked on first use.

    `units`: their units. `opened`: the mapped ones.
    """

    def __init__(self, folder: Path, units: Mapping[str, str], shape: tuple[int, int]) -> None:
        self.units, self._folder, self._shape = dict(units), folder, shape
        self.opened: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a layer, float32 [height, width].

        Raises KeyError, and TerrainError if its file is missing or damaged.
        """
        if name not in self.opened:
            unit = self.units[name]
            file = self._folder / f"{layer_name(name)}.npy"
            try:
                layer = map_array(file, self._shape, np.float32)
            except FileNotFoundError:
                what = f"{file} is missing, the layer {name!r} ({unit})"
                raise TerrainError(what, fix="shape the terrain again") from None
            if not all_finite(layer):
                what = f"{file} is damaged (a value is not a finite number)"
                raise TerrainError(what, fix="shape the terrain again")
            self.opened[name] = layer
        return self.opened[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.units)

    def __len__(self) -> int:
        return len(self.units)


def layer_name(name: str) -> str:
    """Return the name of the array that holds a layer."""
    return f"layer_{name}"
