# SPDX-License-Identifier: GPL-3.0-or-later
"""The source of a terrain's store, for the panel and for the object's custom properties."""

import dataclasses
import functools
import math
import os
from dataclasses import dataclass
from pathlib import Path, PurePath

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.georeference import LARGEST_EXTENT, Place, known_place
from ...cbt_terrain.field.lands import LANDS
from ...cbt_terrain.importing.covered import COVERED
from ...cbt_terrain.importing.source_list import absolute_source
from ...cbt_terrain.importing.thinning import loaded_m, refined_m
from ...cbt_terrain.rasters.raster import ImportSettings
from ..bridge.scene_origin import CRS_X, CRS_Y, SRID
from ..bridge.scene_paths import absolute_path
from ..text.gap_note import MIN_PERCENT, gap_percent
from ..text.numbers import length_text, plain
from ..text.translations import phrase

LONGEST_CRS = 10_000
LINES = ("From", "CRS", "Origin", "Raster", "Extent", "Spacing", "Heights")
MAX_WARNINGS, LONGEST_WARNING = 8, 500


@dataclass(frozen=True)
class Imported:
    """What a store records about its import. Pairs are along x (east) and y (north) unless they say otherwise."""

    settings: dict  # of the import, {} if unknown
    crs: str  # coordinate system, "" for none
    origin: tuple[float, float]  # coordinates of the raster's middle in the CRS's unit
    raster: tuple[int, int]  # samples
    extent_m: tuple[float, float]  # from the first to the last sample
    step_m: tuple[float, float]  # between samples
    heights_m: tuple[float, float]  # lowest and highest
    loaded_m: tuple[float, float] | None = None  # steps of an incomplete store: loaded, and of its source
    refined_m: tuple[float, int] | None = None  # step and number of tiles that an incomplete store has loaded
    warnings: tuple[str, ...] = ()
    place: Place | None = None  # affine map from metres about the middle to the CRS, None if unknown
    filled: int = 0  # samples without data whose heights were interpolated
    covered: str = ""  # where the files of a mosaic with large gaps are (cbt_terrain/importing/covered.py), unchecked
    ground_fraction: float = 1.0  # of the raster, without holes and wide gaps
    is_shaped: bool = False  # a stack of land effects has made the heights

    @property
    def ground_m2(self) -> float:
        """Return the area of the land without holes and wide gaps, square metres."""
        return math.prod(self.extent_m) * self.ground_fraction


def imported_of(settings) -> Imported | None:
    """Return the Imported of the store in a terrain's settings; None without a readable store."""
    if not settings.store:
        return None
    folder = Path(absolute_path(settings.store))
    try:
        return _read_store(str(folder), (folder / stores.JSON_NAME).stat().st_mtime_ns)
    except (OSError, ValueError):
        return None


@functools.lru_cache(maxsize=64)
def _read_store(folder: str, _changed_ns: int) -> Imported | None:
    """Read the Imported of a store, None if it is damaged. Its fields are described in the class.

    `_changed_ns`: last change of its JSON, part of the cache's key, so that another import is read anew.
    """
    try:
        content = stores.read_json(Path(folder))
    except TerrainError:
        return None
    lattice, report = stores.fit(**content["lattice"]), content["report"]  # the lattice of the samples
    # Size and extent of the raster by the import's report; where it has none, those of the store's samples.
    raster = _pair(report, "raster") or (lattice.width, lattice.height)
    size = lattice.step_x * lattice.cells_x, lattice.step_y * lattice.cells_y
    extent = _pair(report, "extent_m") or size
    return Imported(
        settings=content["provenance"].get("settings", {}),
        crs=content["crs"],
        origin=(content["origin"][0], content["origin"][1]),
        raster=raster,
        extent_m=extent,
        step_m=(lattice.step_x, lattice.step_y),
        heights_m=(content["min_height"], content["max_height"]),
        loaded_m=loaded_m(content["provenance"]),
        refined_m=refined_m(content["provenance"]),
        warnings=tuple(shown(text, LONGEST_WARNING) for text in report.get("warnings", [])[:MAX_WARNINGS]),
        place=known_place(tuple(content.get("place", ())) or None, content["crs"], content["origin"]),
        filled=_count(report, "filled"),
        covered=report.get(COVERED, ""),
        ground_fraction=_ground_fraction(report, math.prod(raster)),
        is_shaped="shaped" in content["provenance"],
    )


def _pair(report: dict, name: str) -> tuple | None:
    """Return the two counts or lengths `name` of an unchecked report; None unless both are positive and not huge."""
    value = report.get(name)
    is_pair = isinstance(value, list) and len(value) == 2
    return tuple(value) if is_pair and all(type(v) in (int, float) and 0 < v < LARGEST_EXTENT for v in value) else None


def _count(report: dict, name: str) -> int:
    """Return the count `name` of an unchecked report; 0 unless it is a positive int below 2**63."""
    value = report.get(name)
    return value if type(value) is int and 0 < value < 2**63 else 0


def _ground_fraction(report: dict, samples: float) -> float:
    """Return the fraction of the raster that has ground, by an unchecked report; 1 unless it is above 0 and below 1."""
    percent, cut_out = report.get("ground_percent"), _count(report, "cut_out")
    fraction = 1.0 - cut_out / samples if cut_out else percent / 100.0 if type(percent) is float else 1.0
    return fraction if 0.0 < fraction < 1.0 else 1.0


def filled_note(imported: Imported) -> str:
    """Return the number of samples that the import has filled, and how to leave holes instead; "" without any."""
    if not imported.filled:
        return ""
    text = f"{imported.filled:,} samples without data"
    percent = 100.0 * imported.filled / math.prod(imported.raster)
    if percent >= MIN_PERCENT:
        text = f"{gap_percent(percent)} of the rectangle, which has no data"
    return f"Filled: {text}. To leave holes, tick Cut Out No-Data and import again."


def info_lines(imported: Imported | None) -> list[tuple[str, str]]:
    """Return (name, value) rows about an import for the panel, always the same number: nothing below them moves."""
    if imported is None:
        return [(name, "-") for name in LINES]
    source, more = imported.settings.get("source", ""), imported.settings.get("more_sources")
    others = f" + {len(more):,}" if isinstance(more, list) and more else ""
    figures = (
        LANDS[source].label if source in LANDS else (shown(Path(source).name) or phrase("unknown")) + others,
        _crs_name(imported.crs),
        ", ".join(map(_coordinate, imported.origin)) if imported.crs else phrase("none"),
        f"{imported.raster[0]:,} x {imported.raster[1]:,}",
        _join_lengths([length_text(length) for length in imported.extent_m]),
        _join_lengths([length_text(length) for length in imported.step_m]),
        phrase("{} to {} m", *(plain(height, 4) for height in imported.heights_m)),
    )
    return list(zip(LINES, figures, strict=True))


def loaded_text(settings) -> str:
    """Return the detail of a terrain whose store is incomplete, as `Loaded to 640 m of 10 m`; "" for all others.

    With tiles in more detail it is as `Loaded to 80 m, else 640 m`.
    """
    imported = imported_of(settings)
    if imported is None or imported.loaded_m is None:
        return ""
    if imported.refined_m is not None:
        return phrase("Loaded to {}, else {}", length_text(imported.refined_m[0]), length_text(imported.loaded_m[0]))
    return phrase("Loaded to {} of {}", *map(length_text, imported.loaded_m))


def _crs_name(crs: str) -> str:
    """Return the name in a coordinate system's definition (WKT), or the whole text of another one, as `EPSG:4326`."""
    if not crs:
        return phrase("none")
    return shown(crs.split('"')[1] if '["' in crs else crs)


def _coordinate(value: float) -> str:
    """Return a coordinate with digits down to about a metre; up to 360 it may be in degrees."""
    return f"{value:.0f}" if abs(value) > 360.0 else f"{value:.5f}"


def _join_lengths(texts: list[str]) -> str:
    """Return two lengths as `31.9 x 29.9 km`, with the unit once if it is the same."""
    (first, first_unit), (second, second_unit) = (text.rsplit(" ", 1) for text in texts)
    return f"{first} x {second} {first_unit}" if first_unit == second_unit else " x ".join(texts)


def changed_settings(settings: ImportSettings, imported: Imported | None) -> list[str]:
    """Return the names of the import settings that differ from those of the imported store; [] if those are unknown.

    The panel then offers to import again.
    """
    if imported is None or not imported.settings:
        return []
    defaults = {item.name: item.default for item in dataclasses.fields(settings)}
    changed = []
    for name, value in dataclasses.asdict(settings).items():
        if name in ("quick", "loaded_tiles", "loaded_finer"):  # they differ between the steps of one import
            continue
        before = imported.settings.get(name, defaults[name])
        if name == "source":
            same = _same_file(value, before)
        elif name == "more_sources":
            before = before if isinstance(before, list | tuple) else ()
            same = len(value) == len(before) and all(map(_same_file, value, before))
        elif name == "height_scale":  # None and 1 differ for an image only, for which older stores recorded 1
            same = (1.0 if value is None else value) == (1.0 if before is None else before)
        elif name == "no_data":  # kept as a text, which NaN is too
            same = str(value) == str(before)
        else:
            same = (list(value) if isinstance(value, tuple) else value) == before
        if not same:
            changed.append(name)
    return changed


def _same_file(path: str, before: object) -> bool:
    """Return whether a source is the one before: the same path or built-in land, or a file that may have moved.

    A file that is missing at its old path may have moved with its .blend file, so its name has to be equal only. Older
    versions recorded relative paths, of which the end has to be equal.
    """
    if path == before or not isinstance(before, str):
        return path == before
    if path in LANDS or before in LANDS:
        return False
    if not PurePath(before).is_absolute():
        end = [part for part in PurePath(before).parts if part != ".."]
        return list(PurePath(path).parts[-len(end) :] if end else ()) == end
    if absolute_source(path) == absolute_source(before):
        return True
    return Path(path).name == Path(before).name and not os.path.exists(before)


def tag_object(obj) -> None:
    """Set the coordinate system and the origin of the store as custom properties of the object, or remove them.

    BlenderGIS reads the same properties.
    """
    imported = imported_of(obj.adaptive_terrain)
    for name in (SRID, CRS_X, CRS_Y):
        if name in obj:
            del obj[name]
    if imported is not None and imported.crs:
        obj[SRID], (obj[CRS_X], obj[CRS_Y]) = shown(imported.crs, LONGEST_CRS), imported.origin
