# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports of imports, and the description of a store."""

import os
from pathlib import Path

import numpy as np

from ..field import codes, store
from ..field.georeference import to_crs
from ..field.heightfield import HeightField
from ..field.lands import LANDS
from ..rasters.rounding import rounding_warnings
from .covered import COVERED
from .finer_import import finer_entries
from .plausibility import ValueCheck, relief_warning
from .thinning import loaded_entries
from .tile_tasks import TileSource


def report_of(field: HeightField, source: TileSource, check: ValueCheck) -> dict:
    """Return an import's report: format, sizes, and the warnings of raster, georeference, rounding and values.

    check: statistics of all values of the source, which show implausible ones.
    """
    raster, place = source.raster, source.place
    warnings = [*raster.warnings, *place.warnings, *place.size_warnings]
    largest = max(abs(field.min_height), abs(field.max_height))
    warnings += rounding_warnings(raster.roundings, largest, field.source_max)
    against = ""  # with what the mesh's bounds are compared; "": the raster of the file itself
    if raster.projected_from:
        against = f"the raster as reprojected from {raster.projected_from} to {place.crs or 'a straight one'}, bilinear"
    report = {
        "format": raster.format,
        "raster": [raster.width, raster.height],
        **common_report_entries(field),
        "rotation_deg": place.rotation_deg,
        "bounds_against": against,
        **finer_entries(field),
        **raster.details,
        # Files have gaps between them ("gap_percent", by their headers) and no-data inside.
        **({"missing_percent": _missing_percent(field)} if "gap_percent" in raster.details else {}),
        **(loaded_entries(raster, field.provenance) if raster.full_size is not None else {}),  # replace bounds_against
        "warnings": warnings,
    }
    if source.settings.source not in LANDS:
        warnings += _value_warnings(source, report, check)  # extends the list in the report
    return report


def _missing_percent(field: HeightField) -> float:
    """Return the percentage of a raster's samples that no file has a height for."""
    return round(100.0 * field.filled / field.samples.size, 2)


def common_report_entries(field: HeightField) -> dict:
    """Return the report entries that imported and shaped terrains share. `squares` are root squares of the lattice.

    Missing samples count as `cut_out` if the field has holes, otherwise as `filled`. `source_step_m` is the largest
    error, metres, that rounding and resampling of the source make.
    """
    lattice = field.lattice
    return {
        "samples": [lattice.width, lattice.height],
        "squares": [lattice.columns, lattice.rows],
        "step_m": [lattice.step_x, lattice.step_y],
        "extent_m": [lattice.step_x * (lattice.width - 1), lattice.step_y * (lattice.height - 1)],
        "lowest_m": field.min_height,
        "highest_m": field.max_height,
        "filled": 0 if field.valid is not None else field.filled,
        "cut_out": field.filled if field.valid is not None else 0,
        "source_step_m": field.source_max,
        "crs": field.crs,
    }


def _value_warnings(source: TileSource, report: dict, check: ValueCheck) -> list[str]:
    """Return warnings about values that may be marks of missing samples; without any, about a relief that is too large.

    The second is left out where the extent is in doubt already. report: figures of the import. check: of all values.
    """
    raster, settings, place, _ = source
    if settings.no_data is not None and np.isnan(settings.no_data):  # every value is a height
        return []
    warnings = check.warnings()
    if warnings or place.size_warnings:  # possible causes of heights that are too large for the extent
        return warnings
    is_sized = settings.extent is not None or raster.is_sized
    return relief_warning(report["lowest_m"], report["highest_m"], report["extent_m"], is_sized)


def describe(path: str | os.PathLike) -> dict:
    """Return a store's report with further facts, a flat dict of numbers, texts and lists. Raises TerrainError."""
    content = store.read_json(Path(path))
    field = store.open_store(path)
    num_bytes = sum(array.nbytes for array in (field.samples, field.error, field.ranges))
    # Errors are stored as codes, by groups of depths of the bisection; `table` has the metres of each group's codes. A
    # parent's error is at least its children's, so the coarsest group, that of depth 1, holds the largest.
    group = field.lattice.group(depth=1)
    error_codes = field.error[codes.parts(field.lattice, len(field.error))[group]]
    return {
        "path": str(path),
        "source": content["provenance"].get("settings", {}).get("source", ""),
        **_border(field),
        **{name: value for name, value in content["report"].items() if name != COVERED},
        "origin": content["origin"],
        "largest_error_m": float(field.table[group][error_codes.max()]),
        "bytes_per_sample": round(num_bytes / field.samples.size, 2),
        "key": field.raster.digest,
    }


def _border(field: HeightField) -> dict:
    """Return the entry with the coordinates of the outermost samples, {} without a system or for a rotated raster."""
    place = field.raster.place  # (a, b, c, d, e, f): x = a u + b v + c and y = d u + e v + f; b and d by a rotation
    if place is None or not field.crs or place[1] or place[3]:
        return {}
    west, south, east, north = field.lattice.rectangle()
    corners = to_crs(place, np.array([[west, south], [east, north]]))
    return {"west_south_east_north": corners.ravel().tolist()}
