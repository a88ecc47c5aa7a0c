# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding of a mosaic's samples, from its sources and the scale that the VRT applies to each."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..rasters.rounding import SourceRounding
from .vrt_source import Mosaic

# Returns the rounding of a band of a file, None if it is unknown.
RoundingOf = Callable[[Path, int], SourceRounding | None]
SOURCES = ("SimpleSource", "ComplexSource", "AveragedSource")


def mosaic_roundings(mosaic: Mosaic, band: int, stored: str, rounding_of: RoundingOf) -> tuple[SourceRounding, ...]:
    """Return the different roundings of the sources of one band of a mosaic, without unknown ones.

    stored: name of the type of the band's values. rounding_of: returns the rounding of a file's band, None if unknown.
    """
    roundings = _roundings(mosaic, len(mosaic.texts) - 1, band, rounding_of)  # the outermost VRT is the last text
    # A value that the VRT's type holds unchanged has its file's rounding alone.
    is_exact = [np.can_cast(rounding.stored, stored) and rounding.scale == 1.0 for rounding in roundings]
    return tuple(
        rounding if exact else SourceRounding(stored, before=rounding, lossy=rounding.lossy)
        for rounding, exact in zip(roundings, is_exact, strict=True)
    )


def _roundings(mosaic: Mosaic, number: int, band: int, rounding_of: RoundingOf) -> dict[SourceRounding, None]:
    """Return the roundings of a band's sources, each once, in order, as keys of a dictionary.

    number: which of the VRT's texts in `mosaic`. rounding_of: returns the rounding of a file's band, None if unknown.
    """
    roundings: dict[SourceRounding, None] = {}
    for source, source_band, scaling in sources_of(mosaic, number, band):
        if isinstance(source, int):
            inner: Iterable[SourceRounding | None] = _roundings(mosaic, source, source_band, rounding_of)
        else:
            inner = [rounding_of(source, source_band)]
        roundings |= dict.fromkeys(rounding.scaled(*scaling) for rounding in inner if rounding is not None)
    return roundings


def band_element(mosaic: Mosaic, number: int, band: int) -> ElementTree.Element | None:
    """Return the XML element of a band, None if there is none. number: which of the VRT's texts in `mosaic`."""
    bands = ElementTree.fromstring(mosaic.texts[number]).findall("VRTRasterBand")
    return next((e for n, e in enumerate(bands, 1) if int(e.get("band", n)) == band), None)


def sources_of(mosaic: Mosaic, number: int, band: int) -> Iterator[tuple[Path | int, int, tuple[float, float]]]:
    """Yield the sources of band `band` of the VRT with the index `number` in `mosaic.texts`, in order and once.

    Each is a file or the index of a nested VRT, its band, and the scale and offset that the VRT applies to its values.
    Masks, and sources of other kinds than SOURCES, are left out.
    """
    element = band_element(mosaic, number, band)
    numbers = {f"/vsimem/{mosaic.folder}/{n}.vrt": n for n in range(len(mosaic.texts))}
    seen = set()
    for source in element if element is not None else ():
        if source.tag not in SOURCES:
            continue
        name, source_band = source.findtext("SourceFilename", ""), source.findtext("SourceBand", "1")
        scaling = _scaling(source)
        if not source_band.isdigit() or (name, source_band, scaling) in seen:
            continue
        seen.add((name, source_band, scaling))
        yield numbers.get(name, Path(name)), int(source_band), scaling


def _scaling(source: ElementTree.Element) -> tuple[float, float]:
    """Return the scale and the offset that a VRT applies to a source's values.

    A lookup table (pairs of a value and its replacement) has neither. Its scale is the steepest slope, by which it may
    enlarge a rounding error. `SourceRounding.half_step` estimates stored values by (height + offset) / scale, so its
    offset is one with which these are at least the table's largest.
    """
    pairs = [tuple(map(float, pair.split(":"))) for pair in source.findtext("LUT", "").split(",") if pair.strip()]
    if not pairs:
        return float(source.findtext("ScaleRatio", "1")), float(source.findtext("ScaleOffset", "0"))
    slopes = [abs((y2 - y1) / (x2 - x1)) for (x1, y1), (x2, y2) in zip(pairs, pairs[1:], strict=False) if x2 != x1]
    slope = max(slopes, default=0.0)
    return slope, slope * max(abs(x) for x, _ in pairs)
