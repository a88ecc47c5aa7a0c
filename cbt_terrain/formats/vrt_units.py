# SPDX-License-Identifier: GPL-3.0-or-later
"""Warning about units, scales and offsets of a mosaic's files that the VRT lacks, because GDAL ignores them."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from ..errors import shown
from ..rasters.rasterio_types import CRS, DatasetReader
from ..rasters.units import SAME_UNIT, metres_of, vertical_unit
from .vrt_rounding import band_element, sources_of
from .vrt_source import Mosaic

_DEFAULTS = (("UnitType", ""), ("Scale", "1"), ("Offset", "0"))


class HeightScale(NamedTuple):
    """Conversion of a band's values to heights.

    Attributes:
        unit: name of the unit of value * scale + offset; "" if none.
        metres: metres in that unit; None for an unknown unit.
        scale: see unit.
        offset: see unit.
    """

    unit: str = ""
    metres: float | None = 1.0
    scale: float = 1.0
    offset: float = 0.0

    def over(self, inner: "HeightScale") -> "HeightScale":
        """Return this conversion, with the unit or the scale of a source (`inner`) where this one has none."""
        unit = self if self.unit else inner
        scale = self if self.is_scaled else inner
        return HeightScale(unit.unit, unit.metres, scale.scale, scale.offset)

    @property
    def is_scaled(self) -> bool:
        """Return whether values have to be scaled or shifted."""
        return (self.scale, self.offset) != (1.0, 0.0)

    @property
    def text(self) -> str:
        """Return unit, scale and offset as part of a sentence: "in ft with a scale of 2 and an offset of 0"."""
        scaled = f"with a scale of {self.scale:.10g} and an offset of {self.offset:.10g}" if self.is_scaled else ""
        return " ".join(filter(None, [f"in {shown(self.unit)}" if self.unit else "", scaled])) or "as metres"


# Returns the conversion of a band of a file, None if it is unknown.
ScaleOf = Callable[[Path, int], HeightScale | None]


def height_scale(band_unit: str, crs: CRS | None, scale: float, offset: float) -> HeightScale:
    """Return the conversion of a band's values to heights.

    Args:
        band_unit: the band's unit in the file, "" if none.
        crs: a rasterio CRS or None; its vertical axis defines the unit if the band has none or an unknown one.
        scale, offset: the band's; a height is value * scale + offset in its unit.
    """
    vertical = vertical_unit(crs)  # name, metres, and whether it counts depths; None without a vertical axis
    known = metres_of(band_unit)
    if known is None and vertical:
        return HeightScale(*vertical[:2], scale, offset)
    return HeightScale(band_unit, known if band_unit else 1.0, scale, offset)


def dataset_scales(dataset: DatasetReader) -> list[HeightScale]:
    """Return the conversion to heights of each band of a rasterio dataset."""
    crs = dataset.crs or dataset.gcps[1]
    return [
        height_scale((unit or "").strip(), crs, scale, offset)
        for unit, scale, offset in zip(dataset.units, dataset.scales, dataset.offsets, strict=True)
    ]


def mosaic_notes(mosaic: Mosaic, band: int, scale_of: ScaleOf) -> list[str]:
    """Return a warning, if any, about conversions of one band's files that the VRT lacks.

    scale_of: returns the conversion of a file's band, None if unknown.
    """
    number = len(mosaic.texts) - 1  # the outermost VRT
    vrt_scale = _vrt_scale(mosaic, number, band)
    # Equal units may have different names, so compare metres.
    different = {
        (s.metres and f"{s.metres:.7g}", s.scale, s.offset): s for s in _scales(mosaic, number, band, scale_of)
    }
    if len(different) > 1:
        texts = ", ".join(scale.text for scale in list(different.values())[:3])
        return [
            f"The files of the mosaic give their heights in different ways ({texts}), and the VRT takes their values "
            "as they are: convert them to metres first, each file by itself."
        ]
    for scale in different.values():
        lacks_unit = not vrt_scale.unit and (scale.metres is None or abs(scale.metres - 1.0) > SAME_UNIT)
        lacks_scale = scale.is_scaled and not vrt_scale.is_scaled
        if lacks_unit or lacks_scale:
            return [_note(scale, lacks_unit, lacks_scale)]
    return []


def _note(scale: HeightScale, lacks_unit: bool, lacks_scale: bool) -> str:
    """Return the warning that a VRT lacks a unit, or a scale and an offset, and how to give them.

    There are two ways: write elements into the VRT's XML, or state factors on the command line.
    scale: unit, metres in a unit (None if unknown), scale and offset of the mosaic's files. lacks_unit, lacks_scale:
    which of them the VRT lacks.
    """
    missing = HeightScale(
        scale.unit if lacks_unit else "",
        scale.metres,
        scale.scale if lacks_scale else 1.0,
        scale.offset if lacks_scale else 0.0,
    )
    elements = ["<UnitType>"] * lacks_unit + ["<Scale>", "<Offset>"] * lacks_scale
    # A unit alone is short enough to show what to write; `missing.text` has the numbers of the others.
    xml = f"<UnitType>{shown(scale.unit)}</UnitType>" if not lacks_scale else " and ".join(elements)
    start = f"The files of the mosaic give their heights {missing.text}, and the VRT does not: write {xml} into it, or"
    if scale.metres is None:
        return f"{start} give the number of metres in one of its units (--height-scale)."
    factor = (scale.metres if lacks_unit else 1.0) * missing.scale
    # The height offset is in metres and applies last; the scale applies to values in the VRT's unit, if it has one.
    offset = f" --height-offset {scale.metres * missing.offset:.10g}" if missing.offset else ""
    return f"{start} give --height-scale {factor:.10g}{offset}."


def _vrt_scale(mosaic: Mosaic, number: int, band: int) -> HeightScale:
    """Return the conversion to heights that VRT `number` of a mosaic (`Mosaic.texts`) defines for a band.

    The unit is the band's, or that of the coordinate system's vertical axis. Without such a band it is metres.
    """
    element = band_element(mosaic, number, band)
    if element is None:
        return HeightScale()
    unit, scale, offset = (element.findtext(name, default) for name, default in _DEFAULTS)
    return height_scale(unit.strip(), _crs(mosaic.texts[number]), float(scale), float(offset))


def _crs(text: str) -> CRS | None:
    """Return the coordinate system that a VRT's text names, None without one that PROJ knows."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return CRS.from_user_input(ElementTree.fromstring(text).findtext("SRS", "").strip() or None)
    except (CRSError, TypeError):
        return None


def _scales(mosaic: Mosaic, number: int, band: int, scale_of: ScaleOf) -> set[HeightScale]:
    """Return the conversions to heights of the sources of a band.

    number: index of the VRT in the mosaic's texts, as VRTs may nest. A unit or a scale that a VRT has replaces that of
    its sources. Sources that the VRT scales are left out, because it may have converted them, and so are unknown ones.
    scale_of: returns the conversion of a file's band, None if it is unknown.
    """
    vrt_scale, scales = _vrt_scale(mosaic, number, band), set()
    for source, source_band, scaling in sources_of(mosaic, number, band):
        if scaling == (1.0, 0.0):
            if isinstance(source, int):
                inner: Iterable[HeightScale | None] = _scales(mosaic, source, source_band, scale_of)
            else:
                inner = [scale_of(source, source_band)]
            scales |= {vrt_scale.over(scale) for scale in inner if scale is not None}
    return scales
