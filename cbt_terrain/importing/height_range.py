# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of images whose values have no unit: the lowest and the highest value become two heights in metres."""

import dataclasses
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field.lands import LANDS
from ..rasters.raster import ImportSettings, Raster
from ..rasters.source_formats import FORMATS

IMAGES, IMAGE_TYPES = ("PNG", "GeoTIFF", "RAW"), ("uint8", "uint16")
RELIEF = 0.25  # of the width: the range of an image's heights by default


def is_image(source: str, raster: Raster) -> bool:
    """Return whether values are grey levels: an 8 or 16-bit image that names no place, no scale and no unit.

    A raster that was resampled (`original`) had a place.
    """
    form = FORMATS.get(Path(source).suffix.lower())
    if source in LANDS or form is None or form.title not in IMAGES or raster.stored not in IMAGE_TYPES:
        return False
    return not (raster.is_sized or raster.has_unit or raster.original is not None) and raster.scale == 1.0


def fit_heights(settings: ImportSettings, raster: Raster, width_m: float) -> tuple[ImportSettings, list[str]]:
    """Return settings whose scale and offset give a raster its lowest and highest height, and warnings about a guess.

    These heights are those of the settings. If only one is given, or none for an image (`is_image`), the lowest is 0
    and the highest RELIEF times `width_m`, metres from west to east, above it. Settings without these heights are
    returned unchanged for any other raster, or with a scale or an offset. So are all settings if no sample is finite.
    All samples are read to find the range. Raises TerrainError for heights in the wrong order and infinite samples.
    """
    low, high = settings.lowest, settings.highest
    is_chosen = low is not None or high is not None
    is_scaled = settings.height_scale is not None or settings.height_offset != 0.0
    if not is_chosen and (is_scaled or not is_image(settings.source, raster)):
        return settings, []
    low = low if low is not None else 0.0
    high = high if high is not None else low + RELIEF * width_m
    if not low < high:
        raise TerrainError(f"The lowest height, {low:g} m, is not below {high:g} m", fix="give both heights")
    ranges = [(np.nanmin(rows), np.nanmax(rows)) for _, rows in raster.blocks() if np.isfinite(rows).any()]
    if not ranges:
        return settings, []  # the import reports that there is no height
    lows, highs = zip(*ranges, strict=True)
    min_value, max_value = float(min(lows)), float(max(highs))
    if not np.isfinite([min_value, max_value]).all():
        raise TerrainError(
            f"{settings.source} holds infinite values, so it has no lowest and highest",
            fix="give the metres in a unit of its values instead",
        )
    if raster.scale == 0.0:  # the file's own scale: all its heights are its offset, whatever the values are
        offset = low - raster.offset
        return dataclasses.replace(settings, height_scale=1.0, height_offset=offset, lowest=None, highest=None), []
    # values of the lowest and the highest height
    bottom, top = (min_value, max_value) if raster.scale > 0.0 else (max_value, min_value)
    scale = (high - low) / (top - bottom) if top != bottom else raster.scale
    # A height is scale * (value - bottom) + low. The import computes it as (value * raster.scale + raster.offset) *
    # height_scale + height_offset.
    offset = low - scale * (bottom + raster.offset / raster.scale)
    fitted = dataclasses.replace(
        settings, height_scale=scale / raster.scale, height_offset=offset, lowest=None, highest=None
    )
    if is_chosen:
        return fitted, []
    name = Path(settings.source).name
    if top == bottom:
        return fitted, [
            f"All values of {name} are {min_value:g} and have no unit: the terrain is flat, at {low:.6g} m."
        ]
    return fitted, [
        f"The values of {name}, {min_value:g} to {max_value:g}, have no unit: they became {low:.6g} to "
        f"{high:.6g} m, a quarter of the width. Give the lowest and the highest height in metres (--lowest, "
        "--highest), or the metres in one of its values as the height scale (--height-scale)."
    ]
