# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of a store: what effects on heights have left beside them, one array each, opened when it is asked for."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from .store_arrays import map_array


class LayerFiles(Mapping):
    """The layers of a store by name, each mapped and checked when it is first asked for. `units`: of each; `opened`:
    those that are mapped."""

    def __init__(self, folder: Path, units: Mapping[str, str], shape: tuple[int, int]):
        self.units, self._folder, self._shape, self.opened = dict(units), folder, shape, {}

    def __getitem__(self, name: str) -> np.ndarray:
        """float32 [height, width]. Raises KeyError, and TerrainError where the file is missing or damaged."""
        if name not in self.opened:
            unit = self.units[name]
            file = self._folder / f"{layer_name(name)}.npy"
            try:
                layer = map_array(file, self._shape, np.float32)
            except FileNotFoundError:
                raise TerrainError(
                    f"{file} is missing, the layer {name!r} ({unit}): shape the terrain again."
                ) from None
            if not all(np.isfinite(layer[row : row + 256]).all() for row in range(0, len(layer), 256)):
                raise TerrainError(f"{file} is damaged (a value is not a finite number): shape the terrain again.")
            self.opened[name] = layer
        return self.opened[name]

    def __iter__(self):
        return iter(self.units)

    def __len__(self) -> int:
        return len(self.units)


def layer_name(name: str) -> str:
    """Of the array that holds a layer."""
    return f"layer_{name}"
