# SPDX-License-Identifier: GPL-3.0-or-later
"""Units of length: their names in GDAL, EPSG and PROJ, and the units of a coordinate system."""

import re

from ..errors import shown
from .rasterio_types import CRS

METRES = {
    "metre": 1.0, "meter": 1.0, "m": 1.0, "mtr": 1.0,
    **dict.fromkeys(("germanlegalmetre", "germanlegalmeter", "metergermanlegal", "legalmetre"), 1.0000135965),
    "km": 1e3, "hm": 1e2, "dam": 10.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6,
    "micron": 1e-6, "nauticalmile": 1852.0, "nmi": 1852.0, "kmi": 1852.0, "'": 0.3048, "′": 0.3048, '"': 0.0254,
    "″": 0.0254, "''": 0.0254, "indianchain": 66 * 0.30479841,
}  # fmt: skip
PREFIXES = {"kilo": 1e3, "hecto": 1e2, "deca": 10.0, "deka": 10.0, "deci": 0.1, "centi": 0.01, "milli": 1e-3}
PREFIXES |= {"micro": 1e-6}
METRES |= {prefix + name: size for prefix, size in PREFIXES.items() for name in ("metre", "meter")}
# Metres in a foot, by the rest of a unit's name without its word in FEET.
FOOT = {
    **dict.fromkeys(("", "i", "int", "imperial", "statute"), 0.3048),
    **dict.fromkeys(("ussurvey", "us", "survey", "surveyus", "ussurv", "uss", "usstatute"), 1200.0 / 3937.0),
    **dict.fromkeys(("clarkes", "clarke", "cla"), 0.3047972654),
    **dict.fromkeys(("goldcoast", "gc"), 0.3047997101815088),
    "indian": 12.0 / 39.370142,
    **dict.fromkeys(("indian1937", "ind"), 0.30479841),  # PROJ's ind-ft is that of 1937
    "indian1962": 0.3047996,
    "indian1975": 0.3047995,
    "british1865": 0.9144025 / 3.0,
    "british1936": 0.3048007491,
    **dict.fromkeys(("britishsears1922", "britishsears"), 12.0 / 39.370147),
    "britishsears1922truncated": 0.914398 / 3.0,
    "britishbenoit1895a": 0.9143992 / 3.0,
    "britishbenoit1895b": 12.0 / 39.370113,
}
FOOT |= {name.removeprefix("british"): size for name, size in FOOT.items() if name.startswith("british")}
# Feet in a unit, by a word in its name.
FEET = {
    **dict.fromkeys(("foot", "feet", "ft"), 1.0),
    **dict.fromkeys(("yard", "yd"), 3.0),
    **dict.fromkeys(("chain", "ch"), 66.0),
    **dict.fromkeys(("link", "li", "lk"), 0.66),
    **dict.fromkeys(("inch", "inche", "in"), 1.0 / 12.0),
    **dict.fromkeys(("mile", "mi"), 5280.0),
    **dict.fromkeys(("fathom", "fath", "ftm"), 6.0),
}
SAME_UNIT = 1e-7  # largest relative difference of equal units (a US foot is 2e-6 longer than a foot)
MAX_SYMBOL = 3  # letters of a symbol in METRES
_NO_LENGTH = re.compile(r"[/%‰°*^·×÷|]|[\s_.,;-]s$")  # in names of rates, products, angles and shares
_AXIS = r'AXIS\["[^"]*",\s*(?:{})\s*(?:,\s*ORDER\[\d+\])?\s*,\s*LENGTHUNIT\["([^"]*)",\s*([-+\d.eE]+)'
_VERTICAL = re.compile(_AXIS.format("(up|down)"))
_PLANE = re.compile(_AXIS.format("(north|south|east|west|northEast|northWest|southEast|southWest|unspecified)"))


def metres_of(name: str) -> float | None:
    """Return the metres in a unit of length, None for an unknown name.

    In a name such as "US survey mile", a word of FEET gives the number of feet, and the rest of the name tells by FOOT
    which foot it is.
    """
    name = name.strip().casefold()
    if name in METRES:
        return METRES[name]
    if _NO_LENGTH.search(name):
        return None
    is_whole = not re.search(r"[^\W_][\W_]+[^\W_]", name)  # nothing but letters and digits between its ends
    name = re.sub(r"international|intl|[\W_]", "", name)
    for text in (name, name.removesuffix("s") if len(name) > 2 else name):  # as it is, and without a plural
        if text in METRES and (is_whole or len(text) > MAX_SYMBOL):  # "m m" is not mm
            return METRES[text]
        for word, feet in FEET.items():
            before, found, after = text.partition(word)
            if found and before + after in FOOT:
                return feet * FOOT[before + after]
    return None


def plane_metres(crs: CRS) -> float:
    """Return the metres in the unit of a coordinate system (a rasterio CRS) that is not in degrees."""
    return _plane_unit(crs)[1]


def _plane_unit(crs: CRS) -> tuple[str, float]:
    """Return the name and the metres of a system's horizontal unit; PROJ returns it for projected systems only."""
    if crs.is_projected:
        return crs.linear_units_factor
    match = _PLANE.search(_wkt(crs))
    return (match[2], float(match[3])) if match else ("metre", 1.0)


def vertical_unit(crs: CRS | None) -> tuple[str, float, bool] | None:
    """Return the name and the metres of the unit of a system's vertical axis, and whether the axis points down.

    Return None if there is none. crs: a rasterio CRS or None.
    """
    match = _VERTICAL.search(_wkt(crs)) if crs is not None else None
    return (match[2], float(match[3]), match[1] == "down") if match else None


def height_unit(band_unit: str, crs: CRS | None) -> tuple[float, list[str]]:
    """Return the metres in the unit of a band's values, and warnings about how it was found.

    Args:
        band_unit: the band's unit in the file, "" if none.
        crs: a rasterio CRS or None; its vertical axis defines the unit if the band has none or an unknown one.
    """
    vertical = vertical_unit(crs)
    known, warnings = metres_of(band_unit) if band_unit else None, []
    name, metres, is_depth = vertical or ("metre", 1.0, False)
    if known is not None:
        if vertical and abs(known / metres - 1.0) > SAME_UNIT:
            warnings.append(
                f"The heights are in {shown(band_unit)} by the band's unit and in {shown(name)} by the coordinate "
                f"system; {shown(band_unit)} was taken. If that is wrong, give a height scale of {metres / known:.10g} "
                "(--height-scale)."
            )
        metres, name = known, band_unit
    elif band_unit:
        warnings.append(
            f"The file gives its heights in {shown(band_unit)!r}, which is no known unit of length; they were read as "
            f"{shown(name)}. If they are not, give the metres in a unit as the height scale (--height-scale)."
        )
    elif vertical is None and crs is not None and not crs.is_geographic:
        plane, size = _plane_unit(crs)
        if abs(size - 1.0) > SAME_UNIT:
            warnings.append(
                f"The coordinate system is in {shown(plane)} and the file does not name the unit of its heights; they "
                f"were read as metres. If they are in {shown(plane)}, give a height scale of {size:.10g} "
                "(--height-scale)."
            )
    if abs(metres - 1.0) > SAME_UNIT:
        warnings.append(f"Heights are in {shown(name)} in the file; they were converted to metres.")
    if is_depth:
        warnings.append(
            "The coordinate system counts its vertical axis downwards, so the values are depths: give a height scale "
            "of -1 (--height-scale) to have the ground the right way up."
        )
    return metres, warnings


def _wkt(crs: CRS) -> str:
    """Return the WKT 2 of a rasterio CRS, which names each axis with its unit; "" if it has none."""
    from rasterio.errors import CRSError

    try:
        return crs.to_wkt(version="WKT2_2019")
    except CRSError:
        return ""
