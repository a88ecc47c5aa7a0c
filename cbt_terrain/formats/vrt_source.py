# SPDX-License-Identifier: GPL-3.0-or-later
"""Rewriting of GDAL's virtual rasters (.vrt) by an allow-list before GDAL reads them.

A VRT is XML that names other files. GDAL also lets it name network services, raw bytes of any file, pixel functions and
caches to write. So GDAL never gets the file, but a text with only the elements below, in which every source is the
absolute path of a regular file that was checked, or another rewritten VRT.
"""

import math
import re
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from ..errors import TerrainError, shown
from ..field.lattice import lattice_for
from ..run.named_file import read_start
from ..run.owned_files import real_path, without_dots

MAX_BYTES = 64 << 20  # of XML, in one file; 26,000 sources take 20 MB
MAX_ELEMENTS, MAX_DEPTH, MAX_TEXT = 1_000_000, 16, 1 << 16
MAX_NESTED = 3  # VRTs inside of VRTs
LARGEST_NUMBER = 2.0**31  # pixels, in a window
FLOAT32_MAX = (2.0 - 2.0**-23) * 2.0**127

_SOURCE = {"SourceFilename", "SourceBand", "SourceProperties", "SrcRect", "DstRect"}
_COMPLEX = _SOURCE | {"ScaleOffset", "ScaleRatio", "NODATA", "LUT", "UseMaskBand"}
_BAND = {"NoDataValue", "HideNoDataValue", "UnitType", "Offset", "Scale", "ColorInterp", "MaskBand"}
_POINT = ("Pixel", "Line", "X", "Y", "Z")
_RECTANGLE = {"xOff", "yOff", "xSize", "ySize"}
# By element: its attributes and its child elements.
ALLOWED = {
    "VRTDataset": ({"rasterXSize", "rasterYSize"}, {"SRS", "GeoTransform", "GCPList", "VRTRasterBand", "MaskBand"}),
    "GCPList": ({"Projection", "dataAxisToSRSAxisMapping"}, {"GCP"}),
    "GCP": ({"Id", "Info", "Pixel", "Line", "X", "Y", "Z"}, set()),
    "SRS": ({"dataAxisToSRSAxisMapping", "coordinateEpoch"}, set()),
    "VRTRasterBand": (
        {"dataType", "band", "blockXSize", "blockYSize"},
        _BAND | {"SimpleSource", "ComplexSource", "AveragedSource"},
    ),
    "MaskBand": (set(), {"VRTRasterBand"}),
    "SimpleSource": ({"resampling", "name"}, _SOURCE),
    "AveragedSource": ({"resampling", "name"}, _SOURCE | {"NODATA"}),
    "ComplexSource": ({"resampling", "name"}, _COMPLEX),
    "SourceFilename": ({"relativeToVRT", "shared"}, set()),
    "SourceProperties": ({"RasterXSize", "RasterYSize", "DataType", "BlockXSize", "BlockYSize"}, set()),
    "SrcRect": (_RECTANGLE, set()),
    "DstRect": (_RECTANGLE, set()),
}
# Elements without influence on heights, left out with all their children.
IGNORED = {"CategoryNames", "ColorTable", "Description", "Histograms", "Metadata"}
IGNORED |= {"Overview", "OverviewList"}
# Attributes that repeat the default.
PLAIN = {("subClass", "VRTSourcedRasterBand"), ("subClass", "VRTDataset")}
# By element or attribute: pattern of its text.
_NUMBER = r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?"
_COUNT, _NAME = r"\d{1,10}", r"[\w :/²°.-]{0,64}"
TEXTS = {
    **dict.fromkeys(("SRS", "Projection"), r"EPSG:\d{1,7}|[A-Z_]+\s*\[.*|"),
    "GeoTransform": rf"{_NUMBER}(\s*,\s*{_NUMBER}){{5}}",
    "LUT": rf"{_NUMBER}\s*:\s*{_NUMBER}(\s*,\s*{_NUMBER}\s*:\s*{_NUMBER})*",
    "UseMaskBand": "true|false",
    "SourceBand": r"\d{1,5}|mask|mask,\d{1,5}",
    "dataAxisToSRSAxisMapping": r"[-,\d]{1,16}",
    **dict.fromkeys(("Offset", "Scale", "ScaleOffset", "ScaleRatio", "coordinateEpoch", *_POINT, *_RECTANGLE), _NUMBER),
    **dict.fromkeys(("NoDataValue", "NODATA"), rf"(?i:{_NUMBER}|[-+]?nan|[-+]?inf)"),
    **dict.fromkeys(("HideNoDataValue", "relativeToVRT", "shared"), "[01]"),
    **dict.fromkeys(("ColorInterp", "name", "Id", "Info"), _NAME),
    "UnitType": r"[\w :/²°.'\"′″()-]{0,64}",
    **dict.fromkeys(("resampling", "dataType", "DataType"), r"\w{1,16}"),
    **dict.fromkeys(("rasterXSize", "rasterYSize", "RasterXSize", "RasterYSize", "band"), _COUNT),
    **dict.fromkeys(("blockXSize", "blockYSize", "BlockXSize", "BlockYSize"), _COUNT),
}
_PATTERNS = {name: re.compile(pattern, re.DOTALL) for name, pattern in TEXTS.items()}


@dataclass
class Mosaic:
    """A VRT with its nested VRTs.

    Attributes:
        folder: name of a folder in GDAL's memory.
        texts: XML for GDAL, the outermost last; text n becomes the file /vsimem/FOLDER/n.vrt.
        sources: all files that the VRTs name, in order and once.
        numbers: index of the text of each VRT, by its path.
    """

    folder: str = field(default_factory=lambda: uuid.uuid4().hex)
    texts: list[str] = field(default_factory=list)
    sources: dict[Path, None] = field(default_factory=dict)
    numbers: dict[Path, int] = field(default_factory=dict)


def read_mosaic(path: Path, suffixes: set[str]) -> Mosaic:
    """Read a VRT and all nested VRTs. Raises TerrainError for files, elements and values that are not allowed.

    suffixes: those that sources may have.
    """
    mosaic = Mosaic()
    _add_file(path.absolute(), suffixes, (), mosaic)
    return mosaic


def _add_file(path: Path, suffixes: set[str], outer: tuple[Path, ...], mosaic: Mosaic) -> int:
    """Read a VRT and its nested VRTs into `mosaic`, unless it has them, and return its index in `mosaic.texts`.

    suffixes: allowed suffixes of sources. outer: VRTs that contain it, by which a cycle is found. Raises TerrainError,
    also for an outermost VRT that is too large for a terrain.
    """
    real = real_path(path)
    if real in outer:
        raise TerrainError(f"{shown(path)} is a VRT that contains itself", expected="sources that hold samples")
    if len(outer) > MAX_NESTED:
        raise TerrainError(
            f"{shown(outer[0])} nests VRTs more than {MAX_NESTED} deep", fix="merge them into one file first"
        )
    if real not in mosaic.numbers:
        tree = _parse(path)
        width, height = (int(tree.get(side, 0)) for side in ("rasterXSize", "rasterYSize"))
        if not outer and min(width, height) > 1:  # raise for too large a raster before thousands of files are opened
            lattice_for(width, height, name=shown(path))
        for name in tree.iter("SourceFilename"):
            source = _source_path(path, name, suffixes)
            mosaic.sources[source] = None  # a set in the order of the files
            name.text = str(source)
            if source.suffix.lower() == ".vrt":
                name.text = f"/vsimem/{mosaic.folder}/{_add_file(source, suffixes, (*outer, real), mosaic)}.vrt"
            name.attrib["relativeToVRT"] = "0"
        for element in (*tree.iter("NoDataValue"), *tree.iter("NODATA")):
            element.text = _within_float32(element.text or "")
        mosaic.numbers[real] = len(mosaic.texts)
        mosaic.texts.append(ElementTree.tostring(tree, encoding="unicode"))
    return mosaic.numbers[real]


def _within_float32(text: str) -> str:
    """Return a no-data value, clamped to the largest float32 if rounding took it beyond, which GDAL would ignore."""
    value = float(text)
    return repr(math.copysign(FLOAT32_MAX, value)) if FLOAT32_MAX < abs(value) < 1.0001 * FLOAT32_MAX else text


def _source_path(path: Path, name: ElementTree.Element, suffixes: set[str]) -> Path:
    """Return the file that a SourceFilename in the VRT `path` names, an absolute path without `..` (without_dots).

    Raises TerrainError unless it is a regular file of this computer (`_is_local`) with one of the suffixes, and if it
    holds XML without being a .vrt, since GDAL would open it as a VRT.
    """
    text = (name.text or "").strip()
    source = path.parent / text if name.get("relativeToVRT") == "1" else Path(text)
    source = source if source.is_absolute() else path.parent / source
    what = f"{shown(path)} names the source {shown(text)!r}"
    try:
        is_regular = "\0" not in text and _is_local(source, path) and source.is_file()
    except (OSError, ValueError):
        is_regular = False
    if not is_regular or "<" in str(source) or str(source).startswith("/vsi"):
        raise TerrainError(f"{what}, which is no regular file here", expected="the file of a height map")
    if source.suffix.lower() not in suffixes:
        raise TerrainError(what, expected=f"one of {', '.join(sorted(suffixes))}")
    if source.suffix.lower() != ".vrt" and read_start(source, 4096).lstrip().startswith(b"<"):
        raise TerrainError(f"{what}, which holds XML", expected="samples by its suffix")
    return without_dots(source)


def _is_local(source: Path, path: Path) -> bool:
    r"""Return whether a path stays on the VRT's computer (on Windows, \\server\share is a drive)."""
    return not source.drive.startswith(("\\\\", "//")) or source.drive == path.drive


def _parse(path: Path) -> ElementTree.Element:
    """Return the elements of a VRT that are in ALLOWED, without those in IGNORED.

    Raises TerrainError for other elements and for damaged XML.
    """
    content = read_start(path, MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        what = f"{shown(path)} holds more than {MAX_BYTES >> 20} MB of XML"
        raise TerrainError(what, fix="cut it into several VRTs")
    reader = _Reader(path)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = reader.start, reader.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = reader.text, reader.doctype
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as reason:
        raise TerrainError(f"{shown(path)} is no well-formed XML ({reason})", fix="get the file again") from reason
    return reader.builder.close()


class _Reader:
    """Handlers for expat that build a tree of allowed elements, skip ignored ones and raise TerrainError at others."""

    def __init__(self, path: Path) -> None:
        self.path, self.builder = path, ElementTree.TreeBuilder()
        self.open: list[str] = []  # names of the open elements
        self.pieces: list[str] = []  # texts of the innermost
        self.count = self.ignored = self.length = 0  # elements; depth below an ignored one; characters of `pieces`

    def start(self, name: str, attributes: dict[str, str]) -> None:
        """Open an element, or skip it if it is ignored.

        Raises TerrainError for elements and attributes that are not listed: ALLOWED has the attributes and children of
        each element. PLAIN are attributes with their default values, which are left out. `open` has the names of the
        open elements, and `ignored` is the depth below an ignored one.
        """
        self.count += 1
        if self.count > MAX_ELEMENTS or len(self.open) + self.ignored >= MAX_DEPTH:
            self._refuse(f"more than {MAX_ELEMENTS:,} elements, or elements more than {MAX_DEPTH} deep")
        if self.ignored or name in IGNORED:
            self.ignored += 1
            return
        expected = ALLOWED.get(self.open[-1], ((), ()))[1] if self.open else {"VRTDataset"}
        if name not in expected:
            self._refuse(f"<{shown(name, 40)}> where none is expected")
        for key, value in attributes.items():
            if key not in ALLOWED.get(name, ((), ()))[0] and (key, value) not in PLAIN:
                self._refuse(f'{shown(key, 40)}="{shown(value, 40)}" in <{name}>')
            self._check_value(name, key, value)
        self.builder.start(name, {key: value for key, value in attributes.items() if (key, value) not in PLAIN})
        self.open.append(name)
        self.pieces, self.length = [], 0  # of the element's text

    def end(self, name: str) -> None:
        """Close an element and check its text. Raises TerrainError."""
        if self.ignored:
            self.ignored -= 1
            return
        text = "".join(self.pieces).strip()
        # Elements in ALLOWED hold other elements alone, except those in TEXTS and names, which `_source_path` checks.
        if name in ALLOWED and name not in TEXTS and name != "SourceFilename":
            if text:
                self._refuse(f"the text {shown(text, 40)!r} in <{name}>")
        elif name != "SourceFilename":
            self._check_value(name, name, text)
        self.builder.data(text)
        self.builder.end(name)
        self.open.pop()
        self.pieces, self.length = [], 0

    def text(self, data: str) -> None:
        """Collect the text of the open element. Raises TerrainError for more than MAX_TEXT characters."""
        if self.ignored:
            return
        self.length += len(data)
        if self.length > MAX_TEXT:
            self._refuse(f"a text of more than {MAX_TEXT:,} characters in <{self.open[-1]}>")
        self.pieces.append(data)

    def doctype(self, *_arguments: object) -> None:
        """Refuse a document type, which may define entities that grow without limit."""
        self._refuse("a document type, which may define entities")

    def _check_value(self, element: str, name: str, value: str) -> None:
        """Raise TerrainError for a value of an attribute or text that does not match the pattern of its name.

        Names without a pattern may have any value; numbers of rectangles are below LARGEST_NUMBER.
        """
        pattern = _PATTERNS.get(name)
        is_valid = pattern is None or pattern.fullmatch(value) is not None
        if is_valid and name in _RECTANGLE:
            is_valid = math.fabs(float(value)) < LARGEST_NUMBER
        if not is_valid:
            self._refuse(f"the value {shown(value, 40)!r} for {name} in <{element}>")

    def _refuse(self, what: str) -> None:
        """Raise TerrainError: the file holds `what`, and only plain mosaics are read."""
        raise TerrainError(
            f"{shown(self.path)} holds {what}",
            expected="a plain mosaic of files",
            fix="write it as a GeoTIFF (gdal_translate) if you trust it",
        )
