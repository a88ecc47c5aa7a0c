# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of the declarations' examples on small rasters with known values."""

from typing import Any

import numpy as np

from ..field.build import from_array
from .attribute import AttributeRequest
from .evaluate import on_samples


def evaluate_on(name: str, heights: np.ndarray, step: float, level: float = 0.0, **parameters: Any) -> np.ndarray:
    """Return an attribute at the samples of a raster, without the two outermost on each side.

    Those lack neighbours. The result is float32 [rows - 4, columns - 4], or [rows - 4, columns - 4, width] for an
    attribute of several values. name: the attribute's. heights: [rows, columns] metres. step: metres between samples.
    level: level of the height pyramid, 0 for the raster's own samples. parameters: of the attribute.
    """
    field = from_array(np.asarray(heights, np.float32), step)
    requests = [AttributeRequest(name, (), parameters=tuple(parameters.items()))]
    return np.concatenate([values[name] for _, values in on_samples(field, requests, level=level)])[2:-2, 2:-2]
