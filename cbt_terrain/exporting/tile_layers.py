# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of exported tiles: heights and masks, and how their values become a file's numbers."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..attributes.attribute import AttributeRequest
from ..attributes.catalogue import ATTRIBUTES
from ..attributes.splat import NAMES as SPLATS
from ..height_operators.export import MASK_FORMAT, RasterFormat

HOLES = "holes"
NO_FILE_NAME = frozenset('/\\:*?"<>|\0')
# Lowest and highest value of no values, which `TileLayer.widen` extends.
NO_RANGE = math.inf, -math.inf


@dataclass
class TileLayer:
    """One raster in tiles: its numbers in the file are (value - offset) / scale, and `max_error` is counted."""

    name: str  # "" for heights
    form: RasterFormat
    suffix: str
    source: AttributeRequest | None = None  # None for heights and for the mask of holes
    channel: int = 0  # which number of the source's attribute
    low: float = NO_RANGE[0]  # range of its values
    high: float = NO_RANGE[1]
    max_error: float = 0.0

    @property
    def has_range(self) -> bool:
        """Return whether the layer has any value: its lowest is then not above its highest."""
        return self.low <= self.high

    @property
    def offset(self) -> float:
        """Return the value that number 0 in the file stands for."""
        return self.low if self.form.is_integer else 0.0

    @property
    def scale(self) -> float:
        """Return the value of one step of the file's numbers."""
        if not self.form.is_integer:
            return 1.0
        return ((self.high - self.low) or 1.0) / np.iinfo(self.form.dtype).max

    def widen(self, values: np.ndarray) -> None:
        """Extend the layer's range of values to some more."""
        self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))

    def encode(self, values: np.ndarray) -> np.ndarray:
        """Return the file's numbers for finite float64 values; `max_error` keeps the largest error of the encoding."""
        if self.form.is_integer:
            steps = np.clip(np.rint((values - self.offset) / self.scale), 0, np.iinfo(self.form.dtype).max)
            numbers = steps.astype(self.form.dtype)
        else:
            numbers = values.astype(self.form.dtype)
        self.max_error = max(self.max_error, float(abs(self.offset + self.scale * numbers - values).max()))
        return numbers

    def to_json(self) -> dict:
        """Return the JSON entry of the layer: range, coding and largest error of the encoding."""
        numbers = {"low": self.low, "high": self.high, "scale": self.scale, "offset": self.offset}
        return numbers | {"type": self.form.dtype.name, "max_error": self.max_error}


def mask_layers(masks: Sequence[AttributeRequest]) -> list[TileLayer]:
    """Return a raster layer for each number of each attribute, without a range where it has no known span.

    Names are those of attributes, with a number for attributes of several numbers. A splat attribute holds the weights
    of up to `width` splat layers, and its raster layers have the names of these. A name that equals an earlier one but
    for upper and lower case, which a file system may confuse, gets a number: the splat layer Scree after the attribute
    scree is Scree_2.
    """
    layers, used = [], {HOLES}
    for request in masks:
        attribute = ATTRIBUTES[request.name]
        names = [request.name if attribute.width == 1 else f"{request.name}_{k + 1}" for k in range(attribute.width)]
        if request.name in SPLATS:
            first = attribute.width * SPLATS.index(request.name)
            splats = {**attribute.defaults(), **dict(request.parameters)}["layers"]
            assert isinstance(splats, tuple)
            names = [layer.name for layer in splats[first : first + attribute.width]]
        low, high = attribute.span or NO_RANGE
        for channel, name in enumerate(names):
            name = "".join("_" if letter in NO_FILE_NAME else letter for letter in name)
            numbered = (f"{name}_{k}" for k in itertools.count(2))
            name = next(n for n in itertools.chain([name], numbered) if n.casefold() not in used)
            used.add(name.casefold())
            layers.append(TileLayer(name, MASK_FORMAT, ".png", request, channel, low, high))
    return layers
