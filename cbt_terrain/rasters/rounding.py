# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding of stored samples: the largest difference between a file's number and the number before rounding."""

import math
from dataclasses import dataclass, replace

import numpy as np

from .rasterio_types import DatasetReader

# Significant bits of GDAL's float32, by the bits that a TIFF stores.
HALF_BITS, FLOAT32_BITS = 11, 24
TIFF_FLOAT_BITS = {"16": HALF_BITS, "24": 17}
LOSSY = ("JPEG", "YCbCr JPEG", "JXL", "WEBP", "JPEG2000")


@dataclass(frozen=True)
class SourceRounding:
    """Rounding of the values of one file.

    Attributes:
        stored: name of their type.
        bits: significant bits of a float; 0 for all of its type.
        error: largest error of a lossy compression, in the values' unit.
        scale: a height is value * scale + offset.
        offset: see scale.
        before: rounding of the values from which these were computed.
        is_cut: whether digits may have been truncated instead of rounded, so that an error may be a whole step.
        lossy: method of compression, if its error is not known.
    """

    stored: str
    bits: int = 0
    error: float = 0.0
    scale: float = 1.0
    offset: float = 0.0
    before: "SourceRounding | None" = None
    is_cut: bool = False
    lossy: str = ""

    @property
    def significant(self) -> int:
        """Return the significant bits of a float; 0 for whole numbers."""
        kind = np.dtype(self.stored)
        return 0 if kind.kind != "f" else self.bits or np.finfo(kind).nmant + 1

    def half_step(self, largest: float) -> float:
        """Return the largest rounding error of heights up to `largest`, in their unit.

        It is half the step between stored values of that size. It is the whole step if digits of floats were cut off
        (`is_cut`; whole numbers are never cut). The error of a compression and those of the values from which these
        were computed (`before`) are added.
        """
        kind, scale = np.dtype(self.stored), abs(self.scale)
        if scale == 0.0:
            return 0.0
        value = (largest + abs(self.offset)) / scale
        error = self.error + (self.before.half_step(value) if self.before else 0.0)
        if kind.kind != "f":
            return scale * (0.5 + error)
        # Floats below 2^exponent, from half of it on, have steps of 2^(exponent - significant bits).
        limits = np.finfo(kind)
        value = min(value, float(limits.max))
        lowest = int(limits.minexp) + 1  # smaller floats have the same spacing
        exponent = max(math.frexp(value)[1], lowest) if value else lowest
        return scale * (math.ldexp(1.0 if self.is_cut else 0.5, exponent - self.significant) + error)

    def scaled(self, scale: float, offset: float) -> "SourceRounding":
        """Return the rounding of the heights, which are values times `scale` plus `offset`."""
        return replace(self, scale=self.scale * scale, offset=self.offset * scale + offset)


def half_step(roundings: tuple[SourceRounding, ...], largest: float) -> float:
    """Return the largest rounding error of several files' heights up to `largest`."""
    return max(rounding.half_step(largest) for rounding in roundings)


def band_rounding(dataset: DatasetReader, band: int) -> SourceRounding:
    """Return how far the samples of a file's band may be from those before they were stored or compressed.

    dataset: of rasterio, for one file.
    """
    of_file, of_band = dataset.tags(ns="IMAGE_STRUCTURE"), dataset.tags(band, ns="IMAGE_STRUCTURE")
    stored = dataset.dtypes[band - 1]
    bits = TIFF_FLOAT_BITS.get(of_band.get("NBITS", ""), 0) if stored == "float32" else 0
    try:
        error = float(of_file.get("MAX_Z_ERROR", 0.0))
    except ValueError:
        error = 0.0
    method = of_file.get("COMPRESSION") or of_band.get("COMPRESSION") or dataset.driver
    is_lossy = method in LOSSY and not of_file.get("COMPRESSION_REVERSIBILITY", "LOSSY").startswith("LOSSLESS")
    error = error if error > 0.0 and math.isfinite(error) else 0.0
    # GDAL cuts off the bits that a shorter float lacks.
    return SourceRounding(stored, bits, error, is_cut=bits > 0, lossy=method if is_lossy else "")


def rounding_warnings(roundings: tuple[SourceRounding, ...], largest: float, half: float) -> list[str]:
    """Return warnings about samples of less than 32 bits and about unknown errors.

    largest: the largest height in metres. half: metres by which it may be off: a step of short floats if their digits
    are cut off, half of one if they are rounded.
    """
    short = [rounding for rounding in roundings if 0 < rounding.significant < FLOAT32_BITS]
    warnings = []
    if short:
        coarsest = min(short, key=lambda rounding: rounding.significant)
        size = 16 if coarsest.significant == HALF_BITS else 24
        step = half if coarsest.is_cut else 2.0 * half
        warnings.append(f"The file stores {size}-bit floats: heights near {largest:.6g} m have steps of {step:.6g} m.")
    return warnings + [
        f"The file's samples were compressed with loss ({method}), by an error that the file does not hold: bounds are "
        "against the samples as they are now. Take a lossless file if there is one."
        for method in dict.fromkeys(rounding.lossy for rounding in roundings if rounding.lossy)
    ]
